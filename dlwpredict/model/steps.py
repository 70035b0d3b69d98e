"""The paper's steps, each with one physical idea: slice, expose, threshold, cross-link, shrink; and what a pixel is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dlwpredict.heightmap import HeightMap
from dlwpredict.model.states import Crosslinked, Dose, Exposed, Focus, Numerics


@dataclass(frozen=True)
class Slicing:
    """Round the target to whole slices: h → slice · round(h / slice); 0 leaves it as it is."""

    slicing_um: float
    stage: ClassVar[str] = "target"

    def __call__(self, target: HeightMap) -> HeightMap:
        """Return the sliced target."""
        if self.slicing_um == 0:
            return target
        return target.with_heights(np.round(target.heights_um / self.slicing_um) * self.slicing_um)


@dataclass(frozen=True)
class Exposure:
    """Expose the solid under the target with a Gaussian focus (Eq. 1).

    m_exp = solid ⊛ G. The solid continues below z = 0, since writing starts inside the glass: inside a large block
    m_exp = 1 at the substrate. (With an empty half-space below, P > 0.5 would lift the part off the glass.)
    """

    fwhm_xy_um: float
    fwhm_z_um: float
    numerics: Numerics
    square_px: float = 0.0
    stage: ClassVar[str] = "dose"

    def __call__(self, target: HeightMap) -> Dose:
        """Return the nominal dose."""
        focus = Focus(1.0, self.fwhm_xy_um, self.fwhm_xy_um, self.fwhm_z_um, square_px=self.square_px)
        return Dose(target, (focus,), self.numerics)


@dataclass(frozen=True)
class Threshold:
    """Polymerise where the exposure reaches a fraction of the full dose; only resin at z ≥ 0 can."""

    fraction: float
    reference: str = "full_dose"
    stage: ClassVar[str] = "exposed"

    def __call__(self, dose: Dose) -> Exposed:
        """Return the exposed resin."""
        return dose.numerics.exposed(dose, self.fraction, self.reference)


@dataclass(frozen=True)
class CrossLinking:
    """Spread radicals from the exposed resin with a second Gaussian (Eq. 2): m_cl = exposed ⊛ G."""

    fwhm_xy_um: float
    fwhm_z_um: float
    stage: ClassVar[str] = "crosslink"

    def __call__(self, exposed: Exposed) -> Crosslinked:
        """Return the cross-linked state."""
        return Crosslinked(exposed, self.fwhm_xy_um, self.fwhm_z_um)


@dataclass(frozen=True)
class Shrinkage:
    """Shrink each exposed column by its mean factor (Eqs. 3 and 4).

    κ = κ_min + (κ_max − κ_min)·u, with u = m_cl / max(m_cl); printed height = ⟨κ⟩_z · exposed height, the mean taken
    over the exposed points of the column only. Eq. 3 as printed does not subtract min(m_cl); with the empty
    resin that surrounds every part that minimum is 0, and u runs from 0 to 1.
    """

    minimum: float
    maximum: float
    reference: str = "structure_maximum"
    stage: ClassVar[str] = "height"

    def __call__(self, crosslinked: Crosslinked) -> HeightMap:
        """Return the printed height map."""
        exposed = crosslinked.exposed
        mean = exposed.dose.numerics.column_mean(crosslinked, self.reference)
        factor = self.minimum + (self.maximum - self.minimum) * mean
        return exposed.surface.with_heights(factor * exposed.surface.heights_um)


WALL = 4.0
"""Change of slope between pixels that is a wall's: steeper ones than this are none of a relief's."""


@dataclass(frozen=True)
class PixelMean:
    """Average over pixels: t → t + share·(p²/24)·∇²t; the whole share is the mean over a square of side p, third order.

    Where a slope changes by more than `WALL` from pixel to pixel, no more is taken: where in a pixel
    a wall stands is not known.
    """

    share: float = 1.0
    stage: ClassVar[str] = "recording"

    def __call__(self, printed: HeightMap) -> HeightMap:
        """Return the mean of the surface over every pixel."""
        heights = printed.heights_um
        bends = (
            pitch * np.clip(np.diff(np.pad(heights / pitch, ends, mode="edge"), 2, axis), -WALL, WALL)
            for axis, pitch, ends in ((0, printed.dy_um, ((1, 1), (0, 0))), (1, printed.dx_um, ((0, 0), (1, 1))))
        )
        return printed.with_heights(heights + self.share * sum(bends) / 24)

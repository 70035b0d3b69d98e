"""The states a print passes through: what each stage of the chain hands to the next.

``target → dose → exposed → crosslink → height → surface → recording``

The target, height, surface and recording stages are height maps. The dose and cross-linking stages are stacks over
z; a step describes its change one level at a time (values and z in, values out) and so serves the
few smooth levels of the fast method as well as the many slices of the voxels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import reduce
from typing import Protocol

import numpy as np

from dlwpredict.heightmap import HeightMap
from dlwpredict.numerics.smoothing import FWHM_PER_SIGMA, REACH_SIGMAS, blur, blur_turned
from dlwpredict.numerics.trailing import LAG_REACH, lag

STAGES = ("target", "dose", "exposed", "crosslink", "height", "surface", "recording")

PlaneAt = Callable[[HeightMap, float | np.ndarray], float | np.ndarray]
"""A function of the written heights and of z in µm, which is one height or several of shape (n, 1, 1).

It returns what it says at these heights on the plane: (rows, cols) or (n, rows, cols), and by its shape what it does
not depend on: (rows, cols) for several heights where z does not matter, (n, 1, 1) where the place does not.
"""


SQUARE_PX = 1 / np.sqrt(12)
"""Standard deviation of a square of one pixel along each axis, pixels."""

DEPTH_UM = 10.0
"""Height at which what grows with the depth is as declared, whatever its power."""


def depth_um(z_um: float | np.ndarray, power: float) -> float | np.ndarray:
    """Return z · (|z| / 10 µm)^(power − 1): the depth that an aberration counts by, µm."""
    distance = np.abs(z_um) if isinstance(z_um, np.ndarray) else abs(z_um)
    return z_um * (distance / DEPTH_UM) ** (power - 1)


@dataclass(frozen=True)
class Focus:
    """One Gaussian part of the focus.

    Parameters
    ----------
    weight : float
        Share of the whole focus; the weights of a focus sum to 1.
    fwhm_x_um, fwhm_y_um : float
        Lateral FWHMs along the principal axes, µm.
    fwhm_z_um : float
        Axial FWHM at the substrate, µm.
    angle_deg : float
        Turn of the principal axes, counter-clockwise.
    broadening_per_um : float
        Relative growth of the axial FWHM per µm of height.
    depth_power : float
        Of the height that it grows with; the growth at 10 µm does not hang on it.
    lag_y_um : float
        Mean length of the one-sided exponential that trails the focus, µm; positive towards +y.
    square_px : float
        Standard deviation of what a pixel of the target is written as, pixels: 0 for a point, `SQUARE_PX` for a square.
    """

    weight: float
    fwhm_x_um: float
    fwhm_y_um: float
    fwhm_z_um: float
    angle_deg: float = 0.0
    broadening_per_um: float = 0.0
    depth_power: float = 1.0
    lag_y_um: float = 0.0
    square_px: float = 0.0

    @property
    def reach_um(self) -> float:
        """Lateral distance beyond which this part of the focus adds nothing, µm."""
        widest = max(self.fwhm_x_um, self.fwhm_y_um) / FWHM_PER_SIGMA
        return REACH_SIGMAS * widest + LAG_REACH * abs(self.lag_y_um)

    def sigma_z_um(self, z_um: float) -> float:
        """Axial standard deviation at height z, µm."""
        longer = 1 + self.broadening_per_um * depth_um(z_um, self.depth_power)
        return self.fwhm_z_um / FWHM_PER_SIGMA * max(longer, 0.05)

    def spread(self, plane: np.ndarray, dx_um: float, dy_um: float) -> np.ndarray:
        """Convolve a plane with the lateral shape of this part of the focus."""
        plane = self._gaussian(plane, dx_um, dy_um)
        # rows run downwards, y upwards
        return lag(plane, -self.lag_y_um / dy_um, axis=-2) if self.lag_y_um else plane

    def _gaussian(self, plane: np.ndarray, dx_um: float, dy_um: float) -> np.ndarray:
        sx, sy = self.fwhm_x_um / FWHM_PER_SIGMA / dx_um, self.fwhm_y_um / FWHM_PER_SIGMA / dy_um
        if self.angle_deg % 180 == 0:
            return blur(plane, np.hypot(sy, self.square_px), np.hypot(sx, self.square_px))
        turn = np.deg2rad(self.angle_deg)
        axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        widths = np.diag([self.fwhm_x_um**2, self.fwhm_y_um**2]) / FWHM_PER_SIGMA**2
        per_pixel = np.diag([1 / dx_um, 1 / dy_um])
        return blur_turned(plane, per_pixel @ axes @ widths @ axes.T @ per_pixel + self.square_px**2 * np.eye(2))


@dataclass(frozen=True)
class Dose:
    """What the writer exposes: the written target, the focus, and how the local dose differs from nominal.

    Parameters
    ----------
    written : HeightMap
        Heights told to the writer, already with room around the part.
    focus : tuple of Focus
    numerics : Numerics
    intensity : tuple of functions (written, z) → plane
        Relative focus intensities D(x, y, z) while the layer z is written, 1 = nominal; they multiply, and the dose
        follows Dᴺ. They act under the convolution with the focus.
    background : tuple of functions (written, z) → plane
        Relative intensities that reach the resin at z itself, wherever the focus is; they multiply, and act on the
        exposure of the point, outside of the convolution.
    threshold_factor : tuple of functions (written, z) → plane
        Factors on the threshold of the resin at z; they multiply.
    conversion : float
        η, 0–1: how much of the dose's change reaches the degree of cross-linking.
    photon_order : float
        N, the order of absorption.
    """

    written: HeightMap
    focus: tuple[Focus, ...]
    numerics: Numerics
    intensity: tuple[PlaneAt, ...] = ()
    background: tuple[PlaneAt, ...] = ()
    threshold_factor: tuple[PlaneAt, ...] = ()
    conversion: float = 0.0
    photon_order: float = 2.0

    def relative_dose(self, z_um: float | np.ndarray) -> np.ndarray:
        """Dᴺ of the focus, 1 = nominal; z and the shape as those of a `PlaneAt`."""
        return self._product(self.intensity, z_um) ** self.photon_order

    def relative_background(self, z_um: float | np.ndarray) -> np.ndarray:
        """Dᴺ of what reaches the resin itself, 1 = nominal; z and the shape as those of a `PlaneAt`."""
        return self._product(self.background, z_um) ** self.photon_order

    def relative_threshold(self, z_um: float | np.ndarray) -> np.ndarray:
        """Return the factor on the threshold, which background lowers; z and the shape as those of a `PlaneAt`."""
        return self._product(self.threshold_factor, z_um) / self.relative_background(z_um)

    def _product(self, factors: tuple[PlaneAt, ...], z_um: float | np.ndarray) -> np.ndarray:
        planes = (np.maximum(at(self.written, z_um), 0) for at in factors)
        return reduce(np.multiply, planes) if factors else np.ones(())


@dataclass(frozen=True)
class Exposed:
    """Resin above the threshold.

    Parameters
    ----------
    surface : HeightMap
        Exposed height per column, µm.
    dose : Dose
    solid : numpy.ndarray, optional
        Packed voxels (voxel method only).
    """

    surface: HeightMap
    dose: Dose
    solid: np.ndarray | None = None


@dataclass(frozen=True)
class Crosslinked:
    """Cross-linking of the exposed resin, and how shrinkage answers to it.

    Parameters
    ----------
    exposed : Exposed
    fwhm_xy_um, fwhm_z_um : float
        FWHMs of the cross-linking Gaussian, µm.
    curves : tuple of functions u → u'
        Applied in turn to the normalised cross-linking u (0–1) before it is mapped to κ.
    """

    exposed: Exposed
    fwhm_xy_um: float
    fwhm_z_um: float
    curves: tuple[Callable[[np.ndarray], np.ndarray], ...] = ()

    def with_curve(self, curve: Callable[[np.ndarray], np.ndarray]) -> Crosslinked:
        """Return the same state with one more curve."""
        return replace(self, curves=(*self.curves, curve))

    @property
    def converts(self) -> bool:
        """Whether the local dose changes how much cross-linking the exposed resin starts."""
        dose = self.exposed.dose
        return bool(dose.conversion and (dose.intensity or dose.background))

    def source_weight(self, z_um: float | np.ndarray) -> np.ndarray:
        """1 + η(Dᴺ − 1): cross-linking started per exposed volume, 1 = nominal; z and the shape as of a `PlaneAt`.

        Here the exposed resin stands for what is written, so that D is defined up to its surface.
        """
        dose = replace(self.exposed.dose, written=self.exposed.surface)
        return 1 + dose.conversion * (dose.relative_dose(z_um) * dose.relative_background(z_um) - 1)


class Numerics(Protocol):
    """A way of computing: solves the threshold, and averages cross-linking over the exposed columns."""

    def exposed(self, dose: Dose, threshold: float, reference: str) -> Exposed:
        """Find the resin with exposure ≥ threshold."""
        ...

    def column_mean(self, crosslinked: Crosslinked, reference: str) -> np.ndarray:
        """Return the mean of the (curved) normalised cross-linking over each exposed column, shape (rows, cols)."""
        ...

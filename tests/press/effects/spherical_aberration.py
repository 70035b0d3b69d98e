"""Spherical aberration by index mismatch, growing with depth z.

The axial FWHM is (1 + broadening z) times nominal, D = 1 - loss z, and the focus lies at z (1 + focus_shift).
literal:  the width is taken at the point that is exposed.
at-focus: the width is that of each focus position, all of whose light is then spread.
pupil:    one wavefront error a (6 s^2 - 6 s + 1) over the pupil, s = radius squared, a proportional to depth. On the
          axis I(u) = |int exp(i (u s + a (6 s^2 - 6 s + 1))) ds|^2; the dose goes with the integral of I^2 over u, the
          width with that integral over the maximum of I^2. Both grow with the square of the depth, and belong together:
          a is such that the stated loss (or, without one, the stated broadening) is right at 10 um.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from tests.press.effect import PrintEffect, effect

REFERENCE_UM = 10.0
LARGEST_RAD = 5.0
"""Wavefront error up to which the table reaches; beyond, the focus falls apart."""


@effect("spherical-aberration")
@dataclass(frozen=True)
class SphericalAberration(PrintEffect):
    """Broadening and loss per um, focus shift without unit."""

    models = ("literal", "at-focus", "pupil")
    broadening_per_um: float = 0.0
    loss_per_um: float = 0.0
    focus_shift: float = 0.0
    conversion: float | None = None
    model: str = "literal"

    @property
    def at_focus(self):
        """Whether the loss is that of the focus position."""
        return self.model != "literal"

    @property
    def aberrated(self):
        """Whether anything but the focus shift is on."""
        return bool(self.loss_per_um or self.broadening_per_um)

    def target(self, heights, support, grid):
        return heights * (1 + self.focus_shift), support

    def lobes(self, lobes):
        return [replace(lobe, stretch=self.stretch, stretched_at_focus=self.at_focus) for lobe in lobes]

    def stretch(self, depth):
        """Return the factor on the axial width at a depth in um."""
        if self.model == "pupil" and self.aberrated:
            return np.interp(self.wavefront_rad(depth), *(through_focus()[key] for key in ("rad", "width")))
        return 1 + self.broadening_per_um * depth

    def dose(self, scene):
        if self.model == "pupil" and self.aberrated:
            return np.interp(self.wavefront_rad(scene.grid.depth), *(through_focus()[key] for key in ("rad", "dose")))
        return np.maximum(1 - self.loss_per_um * scene.grid.depth, 0.05) if self.loss_per_um else None

    def wavefront_rad(self, depth):
        """Return the wavefront error at a depth in um."""
        table = through_focus()
        if self.loss_per_um:
            there = np.interp(self.loss_per_um * REFERENCE_UM, 1 - table["dose"], table["rad"])
        else:
            there = np.interp(1 + self.broadening_per_um * REFERENCE_UM, table["width"], table["rad"])
        return there * depth / REFERENCE_UM


@cache
def through_focus(count=101):
    """Return relative dose (square root of the two-photon integral) and axial width against the wavefront error."""
    s = (np.arange(400) + 0.5) / 400
    u = np.linspace(-60, 60, 1201)
    lens = np.exp(1j * u[:, None] * s)
    rad = np.linspace(0, LARGEST_RAD, count)
    squared = np.array([np.abs(lens @ np.exp(1j * a * (6 * s**2 - 6 * s + 1)) / len(s)) ** 4 for a in rad])
    total = squared.sum(axis=1)
    width = total / squared.max(axis=1)
    growing = np.maximum.accumulate(width / width[0])
    return {"rad": rad, "dose": np.minimum.accumulate(np.sqrt(total / total[0])), "width": growing}

"""Spherical aberration by index mismatch, growing with depth z.

The axial FWHM is (1 + broadening z) times nominal, D = 1 - loss z, and the focus lies at z (1 + focus_shift).
literal:  the width is taken at the point that is exposed.
at-focus: the width is that of each focus position, all of whose light is then spread.
"""

from dataclasses import dataclass, replace

import numpy as np

from tests.press.effect import PrintEffect, effect


@effect("spherical-aberration")
@dataclass(frozen=True)
class SphericalAberration(PrintEffect):
    """Broadening and loss per um, focus shift without unit."""

    models = ("literal", "at-focus")
    broadening_per_um: float = 0.0
    loss_per_um: float = 0.0
    focus_shift: float = 0.0
    conversion: float | None = None
    model: str = "literal"

    @property
    def at_focus(self):
        """Whether the loss is that of the focus position."""
        return self.model == "at-focus"

    def target(self, heights, support, grid):
        return heights * (1 + self.focus_shift), support

    def lobes(self, lobes):
        at_focus = self.model == "at-focus"
        return [replace(lobe, broadening_per_um=self.broadening_per_um, broadened_at_focus=at_focus) for lobe in lobes]

    def dose(self, scene):
        return np.maximum(1 - self.loss_per_um * scene.grid.depth, 0.05) if self.loss_per_um else None

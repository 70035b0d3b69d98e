"""A thermal lens: heat left in what stands below weakens (or sharpens) the focus above dense areas.

D = 1 - strength (G_fwhm * volume written below z, per area) / 10 um.
"""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect
from tests.press.gauss import SIGMA_PER_FWHM, lateral


@effect("thermal-lens", "outside")
@dataclass(frozen=True)
class ThermalLens(PrintEffect):
    """Strength without unit per 10 um of solid, FWHM in um."""

    strength: float = 0.0
    fwhm_um: float = 15.0
    conversion: float | None = None

    def dose(self, scene):
        if self.strength == 0:
            return None
        s = self.fwhm_um * SIGMA_PER_FWHM
        below = np.cumsum(scene.written, axis=0, dtype=np.float32) * np.float32(scene.grid.dz / 10)
        return np.maximum(1 - self.strength * lateral(below, s, s, scene.grid), 0.05)

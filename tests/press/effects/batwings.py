"""Overshoot at edges: t -> t + sign gain (t - G_fwhm * t) where the slope exceeds 1."""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import MeasureEffect, effect
from tests.press.gauss import SIGMA_PER_FWHM, on_map
from tests.press.slopes import slope


@effect("batwings")
@dataclass(frozen=True)
class Batwings(MeasureEffect):
    """Gain without unit, FWHM in um; the sign goes with height / wavelength and is set."""

    stage = 20
    gain: float = 0.0
    fwhm_um: float = 1.5
    sign: int = 1

    def record(self, heights, grid):
        if self.gain == 0:
            return heights
        detail = heights - self._smooth(heights, grid)
        return heights + np.where(slope(heights, grid) > 1, self.sign * self.gain * detail, 0)

    def _smooth(self, heights, grid):
        return on_map(heights, self.fwhm_um * SIGMA_PER_FWHM, grid)

"""Linearity deviation of the height axis.

t + quadratic ((t - mean)/Z)^2 + periodic sin(2 pi t / period + phase), Z half the range of the recording.
"""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import MeasureEffect, effect


@effect("z-linearity")
@dataclass(frozen=True)
class ZLinearity(MeasureEffect):
    """Quadratic and periodic amplitudes and the period in um, phase in rad."""

    stage = 40
    quadratic_um: float = 0.0
    periodic_um: float = 0.0
    period_um: float = 5.0
    phase_rad: float = 0.0

    def record(self, heights, grid):
        half_range = (np.nanmax(heights) - np.nanmin(heights)) / 2
        out = heights
        if self.quadratic_um and half_range > 0:
            out = out + self.quadratic_um * ((heights - np.nanmean(heights)) / half_range) ** 2
        if self.periodic_um:
            out = out + self.periodic_um * np.sin(2 * np.pi * heights / self.period_um + self.phase_rad)
        return out

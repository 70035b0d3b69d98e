"""Slope-dependent bias, slopes capped; no value above `max_angle_deg`.

t + bias |grad t|^2 + signed (dt/dx, dt/dy) - bias_abs (|dt/dx|, |dt/dy|)
"""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import MeasureEffect, effect
from tests.press.slopes import gradient

STEEPEST = 2.0  # slopes count up to this


@effect("slope-error")
@dataclass(frozen=True)
class SlopeError(MeasureEffect):
    """Bias and signed terms in um per unit of slope (squared), angle in degrees."""

    stage = 30
    bias_um: float = 0.0
    signed_x_um: float = 0.0
    signed_y_um: float = 0.0
    bias_abs_x_um: float = 0.0
    bias_abs_y_um: float = 0.0
    max_angle_deg: float = 90.0

    def record(self, heights, grid):
        across, up = gradient(heights, grid)
        steepness = np.hypot(across, up)
        capped = np.minimum(steepness, STEEPEST) ** 2
        odd = self.signed_x_um * np.clip(across, -STEEPEST, STEEPEST) + self.signed_y_um * np.clip(
            up, -STEEPEST, STEEPEST
        )
        out = heights + self.bias_um * capped + odd - self._lost(across, up)
        if self.max_angle_deg < 90:
            out = np.where(steepness > np.tan(np.radians(self.max_angle_deg)), np.nan, out)
        return out

    def _lost(self, across, up):
        """Return what is lost on slopes of either sign, axis by axis."""
        return sum(
            length * np.minimum(np.abs(slope), STEEPEST)
            for length, slope in ((self.bias_abs_x_um, across), (self.bias_abs_y_um, up))
        )

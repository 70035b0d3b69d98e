"""Slope error: heights read from a slope are biased, and steep slopes are lost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.effects.base import MapEffect
from dlwpredict.effects.plane import slopes
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import declare

LARGEST_SLOPE = np.sqrt(3.0)
"""Slopes count up to 60°: beyond, hardly any light returns, and a wall of a height map has no slope of its own."""


def slope_bias(
    slope_x: np.ndarray,
    slope_y: np.ndarray,
    bias: float,
    signed: tuple[float, float],
    absolute: tuple[float, float] = (0.0, 0.0),
) -> np.ndarray:
    """Return bias · |∇t|² + signed · ∇t − absolute · (|∂t/∂x|, |∂t/∂y|), µm, all capped at 60°.

    The even part comes from the loss of aperture on slopes, the odd part from a tilted pupil; a scanning tip reads low
    by the size of the slope along a line where its feedback lags, or where the lower of trace and retrace is kept.
    """
    steep = np.hypot(slope_x, slope_y)
    cap = np.minimum(1, LARGEST_SLOPE / np.maximum(steep, 1e-12))
    even = absolute[0] * np.abs(slope_x) + absolute[1] * np.abs(slope_y)
    return bias * (steep * cap) ** 2 + (signed[0] * slope_x + signed[1] * slope_y - even) * cap


@dataclass(frozen=True)
class SlopeError(MapEffect):
    """t + bias · |∇t|² + signed · ∇t − bias_abs · (|∂t/∂x|, |∂t/∂y|); NaN above the limiting angle.

    The last term has one length for each axis of the instrument: equal for both, or one of them 0.
    """

    name = "slope-error"
    meaning = "the microscope misreads heights on slopes, and loses the steepest"
    side = "measurement"
    frame = "instrument"
    stage = "recording"
    source = "aperture limit asin(NA); Opt. Express 20(18), 19936; |slope|: sixteen AFM fields; form is ours"
    confused_with = ("galvo-lag", "instrument-blur", "line-length-error")
    separated_by = (
        "the sample turned by 90° under the microscope (its even part), marks beside the print (its odd part)"
    )

    bias_um: float = declare(0.0, "µm", -0.5, 0.5, "bias at slope 1, whatever its direction", typical=0.05)
    signed_x_um: float = declare(0.0, "µm", -0.5, 0.5, "bias at slope 1 along +x", typical=0.05)
    signed_y_um: float = declare(0.0, "µm", -0.5, 0.5, "bias at slope 1 along +y", typical=0.05)
    bias_abs_x_um: float = declare(0.0, "µm", -0.3, 0.3, "height lost at slope ±1 along x", typical=0.05)
    bias_abs_y_um: float = declare(0.0, "µm", -0.3, 0.3, "height lost at slope ±1 along y", typical=0.05)
    max_angle_deg: float = declare(
        90.0, "°", 10, 90, "steepest surface that is measured; 90 = all", fitted=False, typical=60.0
    )

    def heights(self, state: HeightMap) -> np.ndarray:
        """Return the biased recording with its gaps."""
        slope = slopes(state)
        signed, absolute = (self.signed_x_um, self.signed_y_um), (self.bias_abs_x_um, self.bias_abs_y_um)
        read = state.heights_um + slope_bias(*slope, self.bias_um, signed, absolute)
        if self.max_angle_deg < 90:
            read = np.where(np.hypot(*slope) > np.tan(np.deg2rad(self.max_angle_deg)), np.nan, read)
        return read

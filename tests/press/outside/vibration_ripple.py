"""Vibration of the stage during writing: an oblique ripple of the written heights."""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect


@effect("vibration-ripple", "outside")
@dataclass(frozen=True)
class VibrationRipple(PrintEffect):
    """Amplitude and period in um, direction of the wave vector in degrees from x, phase in rad."""

    amplitude_um: float = 0.0
    period_um: float = 7.0
    angle_deg: float = 30.0
    phase_rad: float = 0.0

    def target(self, heights, support, grid):
        turn = np.radians(self.angle_deg)
        along = grid.x[None, :] * np.cos(turn) + grid.y[:, None] * np.sin(turn)
        wave = self.amplitude_um * np.sin(2 * np.pi * along / self.period_um + self.phase_rad)
        moved = np.maximum(heights + wave, 0) * (heights > 0)
        return moved, support * (moved > 0)

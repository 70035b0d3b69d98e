"""Vibration of the instrument while it scans: a wave of the recorded heights along the rows."""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import MeasureEffect, effect


@effect("scan-wobble", "outside")
@dataclass(frozen=True)
class ScanWobble(MeasureEffect):
    """Amplitude and period in um along the recording's y, phase in rad."""

    stage = 70
    amplitude_um: float = 0.0
    period_um: float = 6.0
    phase_rad: float = 0.0

    def record(self, heights, grid):
        return heights + self.amplitude_um * np.sin(2 * np.pi * grid.y[:, None] / self.period_um + self.phase_rad)

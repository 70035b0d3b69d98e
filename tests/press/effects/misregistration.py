"""Lateral mapping error: a point q is recorded at shift + R(rotation) diag(scale) [[1, shear], [0, 1]] q."""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import MeasureEffect, effect


@effect("misregistration")
@dataclass(frozen=True)
class Misregistration(MeasureEffect):
    """Shifts in um, rotation in degrees counter-clockwise, scales off at 1, shear in mrad."""

    shift_x_um: float = 0.0
    shift_y_um: float = 0.0
    rotation_deg: float = 0.0
    scale_x: float = 1.0
    scale_y: float = 1.0
    shear_mrad: float = 0.0

    def place(self, x, y):
        turn = np.radians(self.rotation_deg)
        x, y = x - self.shift_x_um, y - self.shift_y_um
        along = (x * np.cos(turn) + y * np.sin(turn)) / self.scale_x
        across = (y * np.cos(turn) - x * np.sin(turn)) / self.scale_y
        return along - 1e-3 * self.shear_mrad * across, across

"""Wedge under the print: h -> max(h - tilt (x, y), 0) where something is written."""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect


@effect("substrate-tilt")
@dataclass(frozen=True)
class SubstrateTilt(PrintEffect):
    """Tilts in mrad about the field centre."""

    tilt_x_mrad: float = 0.0
    tilt_y_mrad: float = 0.0

    def target(self, heights, support, grid):
        plane = 1e-3 * (self.tilt_x_mrad * grid.x[None, :] + self.tilt_y_mrad * grid.y[:, None])
        moved = np.maximum(heights - plane, 0) * (heights > 0)
        return moved, support * (moved > 0)

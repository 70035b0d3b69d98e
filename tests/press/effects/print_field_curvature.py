"""Focal surface of the writer bent or tilted: h -> max(h + sag rho^2 + tilt (x, y), 0) where something is written."""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect


@effect("print-field-curvature")
@dataclass(frozen=True)
class PrintFieldCurvature(PrintEffect):
    """Sag in um at 50 um radius, tilt in mrad, centre in um."""

    sag_um: float = 0.0
    tilt_x_mrad: float = 0.0
    tilt_y_mrad: float = 0.0
    centre_x_um: float = 0.0
    centre_y_um: float = 0.0

    def target(self, heights, support, grid):
        bend = self.sag_um * grid.radius(self.centre_x_um, self.centre_y_um) ** 2
        plane = 1e-3 * (self.tilt_x_mrad * grid.x[None, :] + self.tilt_y_mrad * grid.y[:, None])
        moved = np.maximum(heights + bend + plane, 0) * (heights > 0)
        return moved, support * (moved > 0)

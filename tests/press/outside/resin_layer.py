"""A second resin: above a slanted boundary another threshold holds."""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect


@effect("resin-layer", "outside")
@dataclass(frozen=True)
class ResinLayer(PrintEffect):
    """Height and blur of the boundary in um, its slants in mrad, relative change of the threshold above it."""

    boundary_um: float = 5.0
    slant_x_mrad: float = 0.0
    slant_y_mrad: float = 0.0
    blur_um: float = 0.3
    change: float = 0.0

    def threshold(self, scene):
        if self.change == 0:
            return None
        grid = scene.grid
        plane = 1e-3 * (self.slant_x_mrad * grid.x[None, :] + self.slant_y_mrad * grid.y[:, None])
        share = 0.5 + 0.5 * np.tanh((grid.z[:, None, None] - self.boundary_um - plane[None]) / self.blur_um)
        return 1 + self.change * share

"""A micro-explosion: a bubble has torn a crater with a rim into the part."""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect


@effect("micro-explosion", "outside")
@dataclass(frozen=True)
class MicroExplosion(PrintEffect):
    """Place, radius and depth in um; the rim is a quarter of the depth high."""

    x_um: float = 0.0
    y_um: float = 0.0
    radius_um: float = 2.0
    depth_um: float = 0.0

    def geometry(self, heights, grid):
        distance = np.hypot(grid.x[None, :] - self.x_um, grid.y[:, None] - self.y_um) / self.radius_um
        crater = np.exp(-(distance**2)) - 0.25 * np.exp(-(((distance - 1.6) / 0.4) ** 2))
        return np.where(heights > 0, np.maximum(heights - self.depth_um * crater, 0), heights)

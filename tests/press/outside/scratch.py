"""A scratch: a groove of Gaussian section along a straight piece."""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect


@effect("scratch", "outside")
@dataclass(frozen=True)
class Scratch(PrintEffect):
    """Middle, length, depth and width (standard deviation of the section) in um; angle from x in degrees."""

    x_um: float = 0.0
    y_um: float = 0.0
    angle_deg: float = 20.0
    length_um: float = 30.0
    width_um: float = 0.6
    depth_um: float = 0.0

    def geometry(self, heights, grid):
        turn = np.radians(self.angle_deg)
        x, y = grid.x[None, :] - self.x_um, grid.y[:, None] - self.y_um
        along, across = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
        beyond = np.maximum(np.abs(along) - self.length_um / 2, 0)
        groove = self.depth_um * np.exp(-(across**2 + beyond**2) / (2 * self.width_um**2))
        return np.maximum(heights - groove, 0)

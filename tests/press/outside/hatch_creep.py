"""Creep of the hatch angle: every layer is written turned a little further than the one below."""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect
from tests.press.sampling import Surface, covered


@effect("hatch-creep", "outside")
@dataclass(frozen=True)
class HatchCreep(PrintEffect):
    """Creep in mrad per um of height, counter-clockwise, about the field centre."""

    creep_mrad_per_um: float = 0.0

    def target(self, heights, support, grid):
        if self.creep_mrad_per_um == 0 or not heights.any():
            return heights, support
        x, y = np.meshgrid(grid.x, grid.y)

        def came_from(z):
            turn = 1e-3 * self.creep_mrad_per_um * z
            return x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)

        turned = covered(Surface(heights, grid), came_from, heights.max())
        return turned, (turned > 0).astype(float)

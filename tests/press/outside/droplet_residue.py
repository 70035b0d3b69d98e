"""Developer residue wicked into corners: a share of what a rolling disc cannot reach is filled, softly."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import grey_closing

from tests.press.effect import PrintEffect, effect
from tests.press.gauss import on_map


@effect("droplet-residue", "outside")
@dataclass(frozen=True)
class DropletResidue(PrintEffect):
    """Radius of the disc in um; share filled, without unit; at most `thickest_um` thick."""

    radius_um: float = 2.0
    share: float = 0.0
    thickest_um: float = 1.0

    def geometry(self, heights, grid):
        if self.share == 0:
            return heights
        reach_x, reach_y = (max(1, round(self.radius_um / pitch)) for pitch in (grid.dx, grid.dy))
        x, y = np.meshgrid(np.arange(-reach_x, reach_x + 1) * grid.dx, np.arange(-reach_y, reach_y + 1) * grid.dy)
        disc = np.hypot(x, y) <= self.radius_um * 1.001
        wet = np.minimum(grey_closing(heights, footprint=disc) - heights, self.thickest_um)
        return heights + self.share * on_map(wet, self.radius_um / 4, grid)

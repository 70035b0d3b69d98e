"""Curl: the part bends by its own stress, edges up. h + rise (r/R)^2, R half the footprint, about its centroid."""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect
from tests.press.footprint import centroid, half_size, stands


@effect("curl")
@dataclass(frozen=True)
class Curl(PrintEffect):
    """Rise in um at the middle of an edge."""

    rise_um: float = 0.0

    def geometry(self, heights, grid):
        standing = stands(heights)
        if self.rise_um == 0 or not standing.any():
            return heights
        cx, cy = centroid(standing, grid)
        radius = np.hypot(grid.x[None, :] - cx, grid.y[:, None] - cy) / half_size(standing, grid)
        return np.where(standing, np.maximum(heights + self.rise_um * radius**2, 0), heights)

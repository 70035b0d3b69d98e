"""Capillary deformation on drying: h - depth exp(-d/L), d the lateral distance to the nearest free edge."""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect
from tests.press.footprint import edge_distance, stands


@effect("edge-drying")
@dataclass(frozen=True)
class EdgeDrying(PrintEffect):
    """Depth and length in um; nothing happens where nothing stands."""

    depth_um: float = 0.0
    length_um: float = 3.0

    def geometry(self, heights, grid):
        standing = stands(heights)
        sunk = heights - self.depth_um * np.exp(-edge_distance(standing, grid) / self.length_um)
        return np.where(standing, np.maximum(sunk, 0), heights)

"""Curl: stress bends the part, its rim comes up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.effects.base import MapEffect
from dlwpredict.effects.plane import centroid_um, half_width_um, standing, where_written
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import declare


def warp(surface: HeightMap, rise_um: float) -> np.ndarray:
    """Return δh = rise · (r/R)², r from the centroid of the footprint, R half its width, µm, shape (rows, cols).

    A plate under a uniform bending moment takes a constant curvature.
    """
    footprint = standing(surface)
    if not footprint.any():
        return np.zeros(surface.shape)
    x, y = centroid_um(footprint, surface)
    r_squared = (surface.x_um - x) ** 2 + (surface.y_um[:, None] - y) ** 2
    return rise_um * r_squared / half_width_um(footprint, surface) ** 2


@dataclass(frozen=True)
class Curl(MapEffect):
    """The part is bent in proportion to its footprint; nothing changes where nothing stands."""

    name = "curl"
    meaning = "shrinkage stress bends the part: its rim comes up (or down) in proportion to the footprint"
    frame = "sample"
    stage = "surface"
    source = "bending of plates under differential shrinkage, general knowledge"
    confused_with = ("field-curvature", "vignetting", "print-field-curvature")
    separated_by = "footprints of 10, 25, 50 and 100 µm, or the part printed away from the field's centre"

    rise_um: float = declare(0.0, "µm", -2, 2, "rise in the middle of the footprint's edge", typical=0.2)

    def heights(self, state: HeightMap) -> np.ndarray:
        """Return the bent surface."""
        return where_written(state, state.heights_um + warp(state, self.rise_um))

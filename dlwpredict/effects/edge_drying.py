"""Edge drying: the drying meniscus pulls the free edges down."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.effects.base import MapEffect
from dlwpredict.effects.plane import edge_distance_um, standing, where_written
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import declare


def edge_sag(distance_um: np.ndarray, depth_um: float, length_um: float) -> np.ndarray:
    """Return δh = −depth · e^(−d/L), d the lateral distance to the nearest free edge, µm.

    Lang et al. 2022 and Sun et al. 2012 call drying the largest part of shrinkage; the law is ours.
    """
    return -depth_um * np.exp(-distance_um / length_um)


@dataclass(frozen=True)
class EdgeDrying(MapEffect):
    """All edges come out low and rounded; nothing changes where nothing stands."""

    name = "edge-drying"
    meaning = "capillary forces of drying pull free edges down and round them"
    frame = "sample"
    stage = "surface"
    source = "Lang 2022 and Sun et al. 2012 (drying as the largest part of shrinkage); law is ours"
    confused_with = ("edge-inhibition", "dose-proximity", "line-end-pileup")
    separated_by = "a twin dried supercritically, or walls of several thicknesses"

    depth_um: float = declare(0.0, "µm", 0.0, 2.0, "loss of height at the very edge", typical=0.2)
    length_um: float = declare(3.0, "µm", 0.2, 20, "distance over which it decays")

    def heights(self, state: HeightMap) -> np.ndarray:
        """Return the dried surface."""
        distance = edge_distance_um(standing(state), state)
        return where_written(state, state.heights_um + edge_sag(distance, self.depth_um, self.length_um))

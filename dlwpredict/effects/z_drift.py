"""Z drift: the axial stage of the printer drifts, or its scale is wrong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.effects.base import MapEffect
from dlwpredict.effects.plane import where_written
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import declare


@dataclass(frozen=True)
class ZDrift(MapEffect):
    """h → h · (1 + scale + quadratic · h/10 µm)."""

    name = "z-drift"
    meaning = "the printer's z stage drifts or has a wrong scale: heights are written stretched"
    frame = "printer"
    stage = "target"
    source = "general knowledge"
    confused_with = ("z-linearity", "power-drift", "z-amplification", "shrinkage-nonlinearity")
    separated_by = "a certified step height, which settles the instrument's part"

    scale: float = declare(
        0.0, "1", -0.1, 0.1, "relative error of the z scale (not separable from kappa)", typical=0.01
    )
    quadratic_per_10um: float = declare(0.0, "1", -0.1, 0.1, "additional relative error at 10 µm height", typical=0.02)

    def heights(self, state: HeightMap) -> np.ndarray:
        """Return the heights as written."""
        h = state.heights_um
        return where_written(state, h * (1 + self.scale + self.quadratic_per_10um * h / 10))

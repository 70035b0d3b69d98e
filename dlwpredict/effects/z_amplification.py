"""Z amplification: the microscope's height scale is wrong by a factor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.effects.base import MapEffect
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import declare


@dataclass(frozen=True)
class ZAmplification(MapEffect):
    """t → (1 + gain) · t: the amplification coefficient α_z of ISO 25178-600."""

    name = "z-amplification"
    meaning = "the microscope's height scale is wrong by a factor (cannot be told from shrinkage)"
    side = "measurement"
    frame = "instrument"
    stage = "recording"
    source = "ISO 25178-600, amplification coefficient alpha_z"
    confused_with = ("z-drift", "spherical-aberration")
    separated_by = "a certified step height, and nothing else"

    gain: float = declare(0.0, "1", -0.2, 0.2, "relative error of the height scale", typical=0.03)

    def heights(self, state: HeightMap) -> np.ndarray:
        """Return the stretched recording."""
        return (1 + self.gain) * state.heights_um

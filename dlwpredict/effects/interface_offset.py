"""Interface offset: the printer starts below or above the surface of the glass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.effects.base import MapEffect
from dlwpredict.effects.plane import where_written
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import declare


@dataclass(frozen=True)
class InterfaceOffset(MapEffect):
    """h → max(h − offset, 0) where h > 0."""

    name = "interface-offset"
    meaning = "the printer found the glass too high or too low: the whole part is shifted in z before exposure"
    frame = "printer"
    stage = "target"
    source = "NanoWrite command FindInterfaceAt (an offset in µm)"
    confused_with = ("power-drift", "spherical-aberration")
    separated_by = "the substrate in view, heights levelled on it"

    offset_um: float = declare(0.0, "µm", -2, 2, "height lost in the glass (negative: gained)", typical=0.5)

    def heights(self, state: HeightMap) -> np.ndarray:
        """Return the heights written above the glass."""
        return where_written(state, state.heights_um - self.offset_um)

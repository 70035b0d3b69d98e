"""Dose piles up where lines start and stop, in each written segment of each layer.

literal: D = 1 + gain (exp(-d-/L) + end_ratio exp(-d+/L)), d-, d+ the distances to the segment's start and end along y;
         D is the intensity of the line that is being written (under the convolution).
point:   the same D, but multiplying the exposure of each point; just above a top, where nothing is written, D = 1.
speed:   the mirror starts and stops with constant acceleration over L; D^2 = v0/v with v^2 linear in the distance and
         D = 1 + gain at the very end.
"""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect
from tests.press.lines import carried_up, from_end, from_start


@effect("line-end-pileup")
@dataclass(frozen=True)
class LineEndPileup(PrintEffect):
    """Gain without unit, length in um, end_ratio 0-1; direction +1 writes towards +y."""

    models = ("literal", "point", "speed")
    gain: float = 0.0
    length_um: float = 2.0
    end_ratio: float = 1.0
    direction: int = 1
    conversion: float | None = None
    model: str = "literal"

    @property
    def at_focus(self):
        """Whether D belongs to the line being written."""
        return self.model != "point"

    def dose(self, scene):
        if self.gain == 0:
            return None
        written = scene.reached
        start, end = from_start(written, scene.grid.dy), from_end(written, scene.grid.dy)
        if self.direction < 0:
            start, end = end, start
        law = self._slowed if self.model == "speed" else self._law
        dose = 1 + self.gain * (law(start) + self.end_ratio * law(end))
        return carried_up(dose, written) if self.at_focus else dose

    def _law(self, distance):
        return np.exp(-distance / self.length_um)

    def _slowed(self, distance):
        slowest = (1 + self.gain) ** -4.0
        share = slowest + (1 - slowest) * np.clip(distance / self.length_um, 0, 1)
        return (share**-0.25 - 1) / self.gain

"""Galvo lag: the mirror trails its command, along y only.

literal: heights (and where is written) are convolved with exp(-s/lag)/lag, s > 0 towards the writing direction.
time:    every line of every layer is smeared so before the focus acts: the dose trails, not the height.
"""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect
from tests.press.lines import trailed


@effect("galvo-lag")
@dataclass(frozen=True)
class GalvoLag(PrintEffect):
    """Lag in um (speed times delay); direction +1 writes towards +y."""

    models = ("literal", "time")
    lag_um: float = 0.0
    direction: int = 1
    model: str = "literal"

    def target(self, heights, support, grid):
        if self.lag_um <= 0 or self.model == "time":
            return heights, support
        both = trailed(np.stack([heights, support]), self.lag_um, grid.dy, self.direction)
        return both[0], np.clip(both[1], 0, 1)

    def source(self, fill, grid):
        if self.lag_um <= 0 or self.model != "time":
            return fill
        return trailed(fill, self.lag_um, grid.dy, self.direction).astype(np.float32)

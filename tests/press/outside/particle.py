"""A particle: on the part it stands out, under the part it lifts a wider dome."""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect


@effect("particle", "outside")
@dataclass(frozen=True)
class Particle(PrintEffect):
    """Place, diameter and height in um; `spread_um` widens the dome of a particle under the part."""

    x_um: float = 0.0
    y_um: float = 0.0
    diameter_um: float = 3.0
    height_um: float = 0.0
    under: bool = False
    spread_um: float = 6.0

    def geometry(self, heights, grid):
        distance = np.hypot(grid.x[None, :] - self.x_um, grid.y[:, None] - self.y_um)
        if self.under:
            return heights + self.height_um * np.exp(-((distance / (self.diameter_um + self.spread_um)) ** 2)) * (
                heights > 0
            )
        cap = np.sqrt(np.maximum(1 - (2 * distance / self.diameter_um) ** 2, 0))
        return heights + self.height_um * cap

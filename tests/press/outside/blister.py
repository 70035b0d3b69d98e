"""A blister: the part has come off the glass in a disc and bulges, rise (1 - (r/R)^2)^2."""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect


@effect("blister", "outside")
@dataclass(frozen=True)
class Blister(PrintEffect):
    """Place, radius and rise in um."""

    x_um: float = 0.0
    y_um: float = 0.0
    radius_um: float = 8.0
    rise_um: float = 0.0

    def geometry(self, heights, grid):
        square = ((grid.x[None, :] - self.x_um) ** 2 + (grid.y[:, None] - self.y_um) ** 2) / self.radius_um**2
        return heights + self.rise_um * np.maximum(1 - square, 0) ** 2 * (heights > 0)

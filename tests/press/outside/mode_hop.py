"""A mode hop of the laser: the dose steps at a layer and perhaps back at another. D = 1 + step in between."""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect


@effect("mode-hop", "outside")
@dataclass(frozen=True)
class ModeHop(PrintEffect):
    """Range of z in um, step without unit."""

    at_focus = True
    from_z_um: float = 5.0
    to_z_um: float = 1e3
    step: float = 0.0
    conversion: float | None = None

    def dose(self, scene):
        if self.step == 0:
            return None
        depth = scene.grid.depth
        return 1 + self.step * np.logical_and(depth >= self.from_z_um, depth < self.to_z_um)

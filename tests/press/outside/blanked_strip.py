"""A shutter dropout: in a range of layers the lines of a strip get less light, or none."""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect


@effect("blanked-strip", "outside")
@dataclass(frozen=True)
class BlankedStrip(PrintEffect):
    """Strip along y at `x_um`, its width and the range of z in um; `loss` is the share of the dose that is missing."""

    x_um: float = 0.0
    width_um: float = 2.0
    from_z_um: float = 0.0
    to_z_um: float = 1e3
    loss: float = 0.0

    def source(self, fill, grid):
        cover = np.clip((self.width_um / 2 + grid.dx / 2 - np.abs(grid.x - self.x_um)) / grid.dx, 0, 1)
        layers = (grid.z > 0) & (grid.z >= self.from_z_um) & (grid.z < self.to_z_um)
        return (fill * (1 - self.loss * cover * layers[:, None, None])).astype(np.float32)

"""Axial stage drift or scale: h -> h (1 + scale + quadratic h / 10 um)."""

from dataclasses import dataclass

from tests.press.effect import PrintEffect, effect


@effect("z-drift")
@dataclass(frozen=True)
class ZDrift(PrintEffect):
    """Scale and quadratic term without unit."""

    scale: float = 0.0
    quadratic_per_10um: float = 0.0

    def target(self, heights, support, grid):
        return heights * (1 + self.scale + self.quadratic_per_10um * heights / 10), support

"""Laser power drifts while the layers are written one after the other: D = 1 + drift z / h_max."""

from dataclasses import dataclass

from tests.press.effect import PrintEffect, effect


@effect("power-drift")
@dataclass(frozen=True)
class PowerDrift(PrintEffect):
    """Drift without unit over the full height. A layer is written with the power of its own time."""

    at_focus = True
    drift: float = 0.0
    conversion: float | None = None

    def dose(self, scene):
        return 1 + self.drift * scene.grid.depth / scene.heights.max() if self.drift else None

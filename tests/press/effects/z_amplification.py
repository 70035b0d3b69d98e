"""Amplification of the height axis: t -> (1 + gain) t."""

from dataclasses import dataclass

from tests.press.effect import MeasureEffect, effect


@effect("z-amplification")
@dataclass(frozen=True)
class ZAmplification(MeasureEffect):
    """Gain without unit."""

    stage = 50
    gain: float = 0.0

    def record(self, heights, grid):
        return heights * (1 + self.gain)

"""Wings of the focus: (1 - weight) G(s) + weight G(ratio s), laterally and axially."""

from dataclasses import dataclass

from tests.press.effect import PrintEffect, effect


@effect("psf-wings")
@dataclass(frozen=True)
class PsfWings(PrintEffect):
    """Weight and width ratio without unit."""

    weight: float = 0.0
    width_ratio: float = 3.0

    def lobes(self, lobes):
        if self.weight == 0:
            return lobes
        core = [lobe.scaled(1 - self.weight, 1.0) for lobe in lobes]
        return core + [lobe.scaled(self.weight, self.width_ratio) for lobe in lobes]

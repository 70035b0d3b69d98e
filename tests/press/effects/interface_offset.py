"""Error of the interface finder: h -> max(h - offset, 0) where something is written."""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect


@effect("interface-offset")
@dataclass(frozen=True)
class InterfaceOffset(PrintEffect):
    """Offset in um, positive = lost height."""

    offset_um: float = 0.0

    def target(self, heights, support, grid):
        moved = np.maximum(heights - self.offset_um, 0) * (heights > 0)
        return moved, support * (moved > 0)

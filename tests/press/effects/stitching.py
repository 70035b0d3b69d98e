"""Joints between fields, at seams of known place.

Every field beyond a seam (towards +x, or +y for `seam_y_um`) is higher by the step and moved by the shift, adding up
from seam to seam; within a strip of `width_um` around the seam D = 1 + overlap.
"""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect
from tests.press.sampling import Surface


@effect("stitching")
@dataclass(frozen=True)
class Stitching(PrintEffect):
    """Step, shifts, width and seam positions in um, overlap without unit."""

    at_focus = True
    step_um: float = 0.0
    shift_x_um: float = 0.0
    shift_y_um: float = 0.0
    overlap: float = 0.0
    width_um: float = 1.0
    seam_x_um: tuple = (0.0,)
    seam_y_um: tuple = ()
    conversion: float | None = None

    def target(self, heights, support, grid):
        passed = self._passed(grid)
        if self.shift_x_um or self.shift_y_um:
            x, y = np.meshgrid(grid.x, grid.y)
            places = x - passed * self.shift_x_um, y - passed * self.shift_y_um
            heights = np.where(passed > 0, Surface(heights, grid).at(*places), heights)
            support = np.where(passed > 0, Surface(support, grid).at(*places) > 0.5, support).astype(float)
            heights = heights * (support > 0)
        moved = np.maximum(heights + passed * self.step_um, 0) * (heights > 0)
        return moved, support * (moved > 0)

    def _passed(self, grid):
        """Return how many seams lie behind each pixel; one that a seam cuts counts with the part behind it."""
        along = sum(_beyond(grid.x[None, :] - seam, grid.dx) for seam in self.seam_x_um) if self.seam_x_um else 0.0
        across = sum(_beyond(grid.y[:, None] - seam, grid.dy) for seam in self.seam_y_um) if self.seam_y_um else 0.0
        return along + across + np.zeros((len(grid.y), len(grid.x)))

    def dose(self, scene):
        if self.overlap == 0:
            return None
        grid = scene.grid
        strip = np.zeros((len(grid.y), len(grid.x)))
        for seam in self.seam_x_um:
            strip += _share(grid.x - seam, self.width_um, grid.dx)[None, :]
        for seam in self.seam_y_um:
            strip += _share(grid.y - seam, self.width_um, grid.dy)[:, None]
        return 1 + self.overlap * strip[None]


def _beyond(offset, pitch):
    """Return how much of each pixel lies beyond a line."""
    return np.clip(offset / pitch + 0.5, 0, 1)


def _share(offset, width_um, pitch):
    """Return how much of each pixel the strip covers."""
    return np.clip((width_um / 2 + pitch / 2 - np.abs(offset)) / pitch, 0, min(1.0, width_um / pitch))

"""Jitter of the galvo: every written line lands a little too far up or down along y."""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect
from tests.press.gauss import line_kernel
from tests.press.sampling import Surface


@effect("line-jitter", "outside")
@dataclass(frozen=True)
class LineJitter(PrintEffect):
    """Standard deviation and correlation along x in um; the lines' errors come from `seed`."""

    sigma_um: float = 0.0
    correlation_um: float = 1.0
    seed: int = 0

    def target(self, heights, support, grid):
        if self.sigma_um == 0:
            return heights, support
        white = np.random.default_rng(self.seed).standard_normal(len(grid.x))
        smooth = np.convolve(white, line_kernel(self.correlation_um / grid.dx), mode="same")
        error = self.sigma_um * smooth / max(smooth.std(), 1e-12)
        x, y = np.meshgrid(grid.x, grid.y)
        moved = Surface(heights, grid).at(x, y - error[None, :])
        standing = Surface(support, grid).at(x, y - error[None, :])
        return np.maximum(moved, 0) * (standing > 0.5), (standing > 0.5).astype(float)

"""A blunt tip: a cone with a ball at its end touches beside the place that it stands over.

literal: t + R (sqrt(1 + |grad t|^2) - 1) for the ball, then the cone as the largest of t(x - u) - u / tan(angle), u on
         whole pixels.
contact: the surface is read between its pixels, and for each recorded point the place where the whole tip touches first
         is searched for on circles around it.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter

from tests.press.effect import MeasureEffect, effect
from tests.press.sampling import Surface
from tests.press.slopes import slope

DIRECTIONS, IN_BALL = 32, 12
STEEPEST = 1.0  # of a surface whose ball is found from its slope


@effect("tip-convolution")
@dataclass(frozen=True)
class TipConvolution(MeasureEffect):
    """Radius of the end in um, angle of the flank against the axis in degrees."""

    models = ("literal", "contact")
    stage = 5
    radius_um: float = 0.0
    half_angle_deg: float = 0.0
    model: str = "literal"

    def record(self, heights, grid):
        if self.radius_um == 0 and self.half_angle_deg == 0:
            return heights
        known = np.where(np.isnan(heights), np.nanmin(heights), heights)
        ground = known.min()
        look = self._contact if self.model == "contact" else self._formula
        return np.where(np.isnan(heights), np.nan, look(known - ground, grid) + ground)

    def _formula(self, heights, grid):
        steep = np.minimum(slope(heights, grid), STEEPEST)
        ball = heights + self.radius_um * (np.hypot(1, steep) - 1)
        ball = np.minimum(ball, np.maximum(heights, maximum_filter(heights, 3)))
        out, reach = ball, self._reach(heights)
        rows, columns = (int(reach / pitch) for pitch in (grid.dy, grid.dx))
        wide = np.pad(ball, [(rows,) * 2, (columns,) * 2], constant_values=-np.inf)
        for row in range(-rows, rows + 1):
            for column in range(-columns, columns + 1):
                away = np.hypot(row * grid.dy, column * grid.dx)
                if 0 < away <= reach:
                    there = wide[rows + row :, columns + column :][: ball.shape[0], : ball.shape[1]]
                    out = np.maximum(out, there - away / self._tangent)
        return out

    def _contact(self, heights, grid):
        x, y = np.meshgrid(grid.x, grid.y)
        surface, out = Surface(heights, grid), heights.copy()
        inside = np.linspace(0, self.radius_um, IN_BALL + 1)[1:]
        step = min(grid.dx, grid.dy) / 3
        for away in np.concatenate([inside, np.arange(self.radius_um + step, self._reach(heights) + step, step)]):
            size = [2 * int(np.ceil(away / pitch)) + 3 for pitch in (grid.dy, grid.dx)]
            near = maximum_filter(heights, size) + 0.2 - self.tip(away) > out
            for angle in np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS:
                seen = surface.at(x[near] + away * np.cos(angle), y[near] + away * np.sin(angle))
                out[near] = np.maximum(out[near], seen - self.tip(away))
        return out

    def tip(self, away):
        """Return how high the tip's surface is above its lowest point, at a distance from its axis."""
        angle = np.radians(self.half_angle_deg)
        if away <= self.radius_um * np.cos(angle):
            return self.radius_um - np.sqrt(max(self.radius_um**2 - away**2, 0))
        beyond = away - self.radius_um * np.cos(angle)
        flank = beyond / self._tangent if self._tangent else np.inf * beyond
        return self.radius_um * (1 - np.sin(angle)) + (flank if beyond > 0 else 0)

    @property
    def _tangent(self):
        return np.tan(np.radians(self.half_angle_deg))

    def _reach(self, heights):
        """Return how far from the axis the flank may touch."""
        return float(np.ptp(heights)) * self._tangent + self.radius_um * (self._tangent > 0)

"""Lateral shrinkage of a part that its base holds.

literal:   x' = xc + (x - xc) (1 - strain (1 - exp(-z/pin))), xc the centroid of the footprint, read as a height map:
           the highest z at which the shrunk cross-section still covers the point.
shear-lag: an elastic layer at height z gives way near free edges only, u - l^2 lap u = forces at the edges with
           l = `lag_ratio` z; wide parts hardly move in their middle. Same strain at a free top far above the pin.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import LinearOperator, cg

from tests.press.effect import PrintEffect, effect
from tests.press.footprint import centroid, stands
from tests.press.sampling import Surface, covered


@effect("lateral-shrinkage")
@dataclass(frozen=True)
class LateralShrinkage(PrintEffect):
    """Strain without unit, pin height in um."""

    models = ("literal", "shear-lag")
    strain: float = 0.0
    pin_height_um: float = 5.0
    model: str = "literal"
    lag_ratio: float = 1.5

    def geometry(self, heights, grid):
        if self.strain == 0 or not heights.any():
            return heights
        sections = self._elastic(heights, grid) if self.model == "shear-lag" else self._scaled(heights, grid)
        return covered(Surface(heights, grid), sections, heights.max())

    def _scaled(self, heights, grid):
        """Return a function of z: where the material now at (x, y) came from."""
        x, y = np.meshgrid(grid.x, grid.y)
        cx, cy = centroid(stands(heights), grid)

        def came_from(z):
            ratio = 1 - self.strain * -np.expm1(-z / self.pin_height_um)
            return cx + (x - cx) / ratio, cy + (y - cy) / ratio

        return came_from

    def _elastic(self, heights, grid):
        """Return the same function for elastic layers, from the cross-section half way up to each."""
        x, y = np.meshgrid(grid.x, grid.y)
        nodes = np.linspace(0, heights.max(), 5)
        moves = [_edge_pull(heights > 0.5 * z, self.lag_ratio * z, grid) for z in nodes]

        def came_from(z):
            upper = int(np.clip(np.searchsorted(nodes, z), 1, len(nodes) - 1))
            share = (z - nodes[upper - 1]) / (nodes[upper] - nodes[upper - 1])
            ux, uy = ((1 - share) * moves[upper - 1][k] + share * moves[upper][k] for k in (0, 1))
            strength = self.strain * -np.expm1(-z / self.pin_height_um)
            return x - strength * ux, y - strength * uy

        return came_from


def _edge_pull(standing, length_um, grid):
    """Return the displacement (ux, uy) per unit strain of a layer held by shear over a length l.

    u = l^2 lap u inside, du/dn = -1 at free edges: a strip of half width R gives u = -l sinh(x/l) / cosh(R/l).
    """
    if length_um <= 0:
        return np.zeros(standing.shape), np.zeros(standing.shape)
    solid = standing.astype(float)
    joints = [np.minimum(solid[1:], solid[:-1]), np.minimum(solid[:, 1:], solid[:, :-1])]
    stiff = (length_um / grid.dy) ** 2, (length_um / grid.dx) ** 2

    def apply(flat):
        u = flat.reshape(solid.shape)
        out = u.copy()
        for axis, (joint, weight) in enumerate(zip(joints, stiff, strict=True)):
            flow = weight * joint * np.diff(u, axis=axis)
            low, high = [slice(None)] * 2, [slice(None)] * 2
            low[axis], high[axis] = slice(None, -1), slice(1, None)
            out[tuple(low)] -= flow
            out[tuple(high)] += flow
        return out.ravel()

    system = LinearOperator((solid.size, solid.size), matvec=apply, dtype=float)
    out = []
    for axis, pitch in ((1, grid.dx), (0, grid.dy)):
        step = np.diff(np.pad(solid, 1), axis=axis)
        inner = (slice(None), slice(1, -1)) if axis == 0 else (slice(1, -1), slice(None))
        step = step[inner]
        ahead = step[1:, :] if axis == 0 else step[:, 1:]
        behind = step[:-1, :] if axis == 0 else step[:, :-1]
        force = length_um**2 / pitch * (np.minimum(ahead, 0) + np.maximum(behind, 0)) * solid
        solved, _ = cg(system, force.ravel(), rtol=1e-4, maxiter=400)
        out.append(solved.reshape(solid.shape) * solid)
    return tuple(out)

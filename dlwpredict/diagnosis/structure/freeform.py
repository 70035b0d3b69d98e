"""Free forms: what any smooth physics could do to a recording, without a name.

Columns in the coordinates that physics acts in (radius, height, distance to an edge and its side, x, y, slope,
curvature) and local tiles for what sits in one place. They judge the names: a name that explains less than
nearly all of what they explain is not the physics.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.interpolate import BSpline

from dlwpredict.heightmap import HeightMap

TILES = 7
"""Local tiles along each side of a map."""

EDGE_UM = 8.0
"""Edges are followed this far into the part."""


def splines(values: np.ndarray, count: int, low: float, high: float) -> list[np.ndarray]:
    """Return cubic B-splines of a coordinate, constant outside low … high, each of the shape of `values`.

    Examples
    --------
    >>> round(float(sum(splines(np.array([0.3]), 5, 0.0, 1.0))[0]), 12)
    1.0
    """
    knots = np.concatenate([[low] * 3, np.linspace(low, high, count - 2), [high] * 3])
    clipped = np.clip(values, low, high - 1e-9 * (high - low))
    flat = BSpline.design_matrix(clipped.ravel(), knots, 3).toarray()
    return [np.round(column, 12).reshape(np.shape(values)) for column in flat.T]


def edge_distances(target: HeightMap) -> dict[str, np.ndarray]:
    """Return the distance into the part from its left, right, lower and upper edges, µm; infinite off the part.

    Along each row or column the distance counts from the last unwritten pixel, gaps included.
    """
    part = target.heights_um > 0

    def run(mask: np.ndarray, pitch: float) -> np.ndarray:
        index = np.arange(1, mask.shape[1] + 1)
        last = np.maximum.accumulate(np.where(mask, 0, index), axis=1)
        return np.where(mask, (index - last - 0.5) * pitch, np.inf)

    return {
        "left": run(part, target.dx_um),
        "right": run(part[:, ::-1], target.dx_um)[:, ::-1],
        "upper": run(part.T, target.dy_um).T,
        "lower": run(part[::-1].T, target.dy_um).T[::-1],
    }


def smooth_forms(target: HeightMap) -> np.ndarray:
    """Return few, wide forms: what model error looks like when nothing is known of it, (columns, rows, cols)."""
    x, y = np.meshgrid(target.x_um / target.size_um[0], target.y_um / target.size_um[1])
    part = (target.heights_um > 0).astype(float)
    heights = target.heights_um
    waves = [np.cos(np.pi * i * (x + 0.5)) * np.cos(np.pi * j * (y + 0.5)) for i in range(4) for j in range(4)]
    forms = [*waves, *(part * w for w in waves[:4])]
    if np.ptp(heights[part > 0]) > 1e-6:
        forms += [s * part for s in splines(heights, 5, heights[part > 0].min(), heights.max())]
    for distance in edge_distances(target).values():
        forms += [part * np.exp(-np.where(np.isfinite(distance), distance, 0) / length) for length in (1.0, 3.0)]
    return np.stack(forms)


def free_forms(target: HeightMap, predicted_um: np.ndarray) -> dict[str, np.ndarray]:
    """Return the families of free forms of one recording: family to columns (columns, rows, cols)."""
    part = target.heights_um > 0
    on = part.astype(float)
    x, y = np.meshgrid(target.x_um, target.y_um)
    low, high = np.quantile(predicted_um[part], [0.0, 1.0])
    radius = np.hypot(x, y)
    along_y, along_x = np.gradient(predicted_um, target.dy_um, target.dx_um)
    slope = np.where(part, np.minimum(np.hypot(along_x, along_y), 3), 0)
    bend = np.where(part, ndimage.gaussian_laplace(predicted_um, 1.5), 0)
    scale = np.quantile(np.abs(bend[part]), 0.9) + 1e-12
    families = {
        "radius": [on * s for s in splines(radius, 6, 0, radius[part].max())],
        "x": [on * s for s in splines(x, 6, x[part].min(), x[part].max())],
        "y": [on * s for s in splines(y, 6, y[part].min(), y[part].max())],
        "slope": [slope, slope**2, on * np.clip(-along_y, -3, 3), on * np.clip(along_x, -3, 3)],
        "curvature": [np.clip(bend / scale, -3, 3)],
        "place": _tiles(target, on),
    }
    if high - low > 1e-3:
        families["height"] = [on * s for s in splines(predicted_um, 6, low, high)]
    for side, distance in edge_distances(target).items():
        near = np.where(np.isfinite(distance), distance, EDGE_UM)
        families[f"{side} edges"] = [
            on * s for s in splines(np.sqrt(np.minimum(near, EDGE_UM)), 5, 0, EDGE_UM**0.5)[:-1]
        ]
    return {family: np.stack(columns) for family, columns in families.items() if columns}


def _tiles(target: HeightMap, on: np.ndarray) -> list[np.ndarray]:
    """Return products of broad bumps along x and y, one per place."""
    part = on > 0
    rows, cols = np.nonzero(part)
    across = splines(np.arange(part.shape[1], dtype=float), TILES, cols.min(), cols.max())
    down = splines(np.arange(part.shape[0], dtype=float), TILES, rows.min(), rows.max())
    return [on * np.outer(d, a) for d in down for a in across]

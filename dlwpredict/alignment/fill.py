"""Gaps in a map: filled by a soap film, never outside the hull of what was measured."""

from __future__ import annotations

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse.linalg import cg
from scipy.spatial import ConvexHull, QhullError

from dlwpredict.alignment.plane import plane_columns


def inside_hull(measured: np.ndarray) -> np.ndarray:
    """Tell which points lie inside the convex hull of the measured points.

    Parameters
    ----------
    measured : numpy.ndarray of bool, shape (rows, cols)

    Examples
    --------
    >>> inside_hull(np.array([[1, 0, 1], [0, 0, 0], [1, 0, 0]], bool)).astype(int).tolist()
    [[1, 1, 1], [1, 1, 0], [1, 0, 0]]
    """
    rim = measured & ~ndimage.binary_erosion(measured)
    points = np.argwhere(rim)
    try:
        faces = ConvexHull(points).equations
    except (QhullError, ValueError):  # fewer than three points, or all on one line: the hull has no area
        return measured.copy()
    row, col = np.indices(measured.shape)
    outside = np.zeros(measured.shape, bool)
    for normal_row, normal_col, offset in faces:
        outside |= normal_row * row + normal_col * col + offset > 1e-9 * max(measured.shape)
    return ~outside | measured


def fill(heights_um: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Fill the points that were not measured; outside the measured hull they become NaN.

    Each gap carries a soap film: Laplace's equation with the measured heights around it as boundary, solved
    for what stands above the map's mean plane, so that a tilted flat stays one (the paper's spline fill with no
    freedom to overshoot).

    Parameters
    ----------
    heights_um : numpy.ndarray, shape (rows, cols)
    measured : numpy.ndarray of bool, shape (rows, cols)
    """
    known = measured & np.isfinite(heights_um)
    gaps = inside_hull(known) & ~known
    row, col = np.indices(heights_um.shape, dtype=float)
    columns = plane_columns(col, row)
    at_known = known.ravel()
    plane = np.linalg.lstsq(columns[at_known], heights_um[known], rcond=None)[0]
    trend = (columns @ plane).reshape(heights_um.shape)
    filled = np.where(known, heights_um, np.nan)
    if gaps.any():
        filled[gaps] = trend[gaps] + _soap_film(np.where(known, heights_um - trend, 0.0), known, gaps)
    return filled


def _soap_film(heights: np.ndarray, known: np.ndarray, gaps: np.ndarray) -> np.ndarray:
    """Heights of the gaps that equal the mean of their neighbours."""
    index = np.full(gaps.shape, -1)
    index[gaps] = np.arange(gaps.sum())
    pulled, degree, pairs = np.zeros(gaps.shape), np.zeros(gaps.shape), []
    for axis in (0, 1):
        for here, there in ((slice(1, None), slice(None, -1)), (slice(None, -1), slice(1, None))):
            a, b = (
                ((here, slice(None)), (there, slice(None)))
                if axis == 0
                else ((slice(None), here), (slice(None), there))
            )
            degree[a] += known[b] | gaps[b]
            pulled[a] += np.where(known[b], heights[b], 0.0)
            both = gaps[a] & gaps[b]
            pairs.append((index[a][both], index[b][both]))
    left, right = (np.concatenate(side) for side in zip(*pairs, strict=True))
    count = int(gaps.sum())
    laplacian = sparse.diags(degree[gaps]) - sparse.csr_matrix((np.ones(len(left)), (left, right)), (count, count))
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    start = heights[tuple(nearest)][gaps]
    precondition = sparse.diags(1 / degree[gaps])
    return cg(laplacian, pulled[gaps], x0=start, rtol=1e-6, maxiter=2000, M=precondition)[0]


def extend(heights_um: np.ndarray) -> np.ndarray:
    """Give every point still NaN its nearest height (for filters only: such points carry no support)."""
    lost = np.isnan(heights_um)
    if not lost.any():
        return heights_um
    nearest = ndimage.distance_transform_edt(lost, return_distances=False, return_indices=True)
    return heights_um[tuple(nearest)]

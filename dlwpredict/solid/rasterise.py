"""Triangles to heights: a z-buffer that looks at a mesh from above."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dlwpredict.errors import InputError

_MOST_PIXELS = 50_000_000
_CHUNK = 2_000_000  # pairs of triangle and pixel in memory at a time
_SLACK_PX = 1e-3  # a pixel centre this near to a triangle's edge lies in it (STL stores float32)

_UPRIGHT_PX2 = 1e-12  # less than this seen from above is a vertical triangle


def seen_from_above(triangles_um: np.ndarray, dx_um: float, dy_um: float) -> np.ndarray:
    """Return the highest point of a mesh over every pixel centre, counted from the lowest point of the mesh.

    Pixel centres are the whole multiples of the pitch inside the mesh's bounds, so that a mesh made from a height
    map gives that map back. Within a triangle z is linear, evaluated exactly at the pixel centre; vertical triangles
    are seen edge-on and skipped.

    Parameters
    ----------
    triangles_um : numpy.ndarray, shape (n, 3, 3)
        Corners (x, y, z) of every triangle, µm.
    dx_um, dy_um : float
        Pitch, µm.

    Returns
    -------
    numpy.ndarray, shape (rows, cols)
        Heights, µm; row 0 has the largest y; 0 where nothing covers the pixel.

    Raises
    ------
    InputError
        More pixels than 50 million.
    """
    pitch = np.array([dx_um, dy_um])
    flat = triangles_um[..., :2] / pitch  # in pixels
    first = np.ceil(flat.min(axis=(0, 1)) - _SLACK_PX)
    extent = np.maximum(np.floor(flat.max(axis=(0, 1)) + _SLACK_PX) - first + 1, 0)
    if extent.prod() > _MOST_PIXELS:
        size = f"{extent[0]:.6g} x {extent[1]:.6g} pixels"
        raise InputError(size, key="--pitch-um", allowed=f"allowed: up to {_MOST_PIXELS} pixels")
    cols, rows = (int(n) for n in extent)
    heights = np.zeros((rows, cols))
    area = _cross(flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0])  # twice the area, px²
    lying = np.abs(area) > _UPRIGHT_PX2
    flat, area = flat[lying] - first, area[lying]
    z = triangles_um[lying, :, 2] - triangles_um[..., 2].min()
    for which, pixel in _candidates(flat, (cols, rows)):
        inside, level = _levels(pixel, flat[which], area[which], z[which])
        x, y = pixel[inside].T
        np.maximum.at(heights, (rows - 1 - y, x), level[inside])
    return heights


def _candidates(flat: np.ndarray, size: tuple[int, int]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield triangles (n,) and pixels (n, 2) as pairs: every pixel of the box around each triangle, some at a time."""
    low = np.ceil(flat.min(axis=1) - _SLACK_PX).astype(np.int64).clip(min=0)
    high = np.floor(flat.max(axis=1) + _SLACK_PX).astype(np.int64).clip(max=np.array(size) - 1)
    wide, tall = (high - low + 1).clip(min=0).T
    pairs = wide * tall
    group = np.cumsum(pairs) // _CHUNK
    for part in np.split(np.arange(pairs.size), np.flatnonzero(np.diff(group)) + 1):
        which = np.repeat(part, pairs[part])
        before = np.cumsum(pairs[part]) - pairs[part]
        down, across = np.divmod(np.arange(which.size) - np.repeat(before, pairs[part]), wide[which])
        yield which, low[which] + np.stack([across, down], axis=1)


def _levels(pixel: np.ndarray, flat: np.ndarray, area: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tell which pixels lie in their triangle, and how high it is there (barycentric coordinates)."""
    inside, level = np.ones(len(pixel), dtype=bool), np.zeros(len(pixel))
    for k in range(3):
        start, end = flat[:, (k + 1) % 3], flat[:, (k + 2) % 3]
        twice = _cross(end - start, pixel - start)  # signed distance from the edge times its length
        inside &= twice * np.sign(area) >= -_SLACK_PX * np.linalg.norm(end - start, axis=1)
        level += z[:, k] * twice / area
    return inside, level.clip(z.min(axis=1), z.max(axis=1))


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]

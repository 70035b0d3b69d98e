"""Right triangles by bisection: a grid covered with few of them, none further from its heights than stated.

A right isosceles triangle is cut from its right angle to the middle of its longest side. Cutting moves the surface by
e = |mean height of that side's ends − height of its middle| at most, so a triangle left whole is off by no more than

    E(triangle) = e(middle) + max(E(both halves)).

Both triangles at a side share its middle, so one number per grid point decides for both; since it grows from half to
whole, a point that is kept keeps all that it hangs on, and the triangles fit without gaps.
"""

from __future__ import annotations

import numpy as np


def triangles(heights_um: np.ndarray, keep: np.ndarray, tolerance_um: float) -> np.ndarray:
    """Return triangles of grid points that cover a grid.

    Parameters
    ----------
    heights_um : numpy.ndarray, shape (rows, cols)
        Heights of the grid points, µm.
    keep : numpy.ndarray of bool, shape (rows, cols)
        Points that must be corners, beside the grid's border, which is kept whole. A cell with four of them is covered
        by two triangles of its own.
    tolerance_um : float
        Largest vertical distance of any height from the triangles, µm.

    Returns
    -------
    numpy.ndarray, shape (n, 3, 2)
        Row and column of every corner, anticlockwise where rows go down.
    """
    rows, cols = heights_um.shape
    n = 1 << int(max(rows, cols) - 2).bit_length()  # the grid becomes a square of 2^k cells
    outside = (0, n + 1 - rows), (0, n + 1 - cols)
    kept = np.pad(keep[1:-1, 1:-1], 1, constant_values=True)
    needed = _needed(np.pad(heights_um, outside), np.pad(kept, outside, constant_values=True))
    corners = _cut(needed > tolerance_um, n)
    inside = (corners.max(axis=1) < (rows, cols)).all(axis=1)
    return corners[inside]


def _needed(z: np.ndarray, keep: np.ndarray) -> np.ndarray:
    """Return, for every point, the largest tolerance that still needs it as a corner, µm."""
    n = len(z) - 1
    needed = np.where(keep, np.inf, 0.0)
    step = 2
    while step <= n:
        half, quarter = step // 2, step // 4
        for rows, cols in (
            (slice(0, None, step), slice(half, None, step)),
            (slice(half, None, step), slice(0, None, step)),
        ):
            along = z if rows.start == 0 else z.T
            off = abs((along[::step, :-1:step] + along[::step, step::step]) / 2 - along[::step, half::step])
            halves = _largest(needed, rows, cols, [(a, b) for a in (-quarter, quarter) for b in (-quarter, quarter)])
            _raise(needed, rows, cols, (off if rows.start == 0 else off.T) + (halves if quarter else 0.0))
        corner = z[::step, ::step]
        falling, rising = (corner[:-1, :-1] + corner[1:, 1:]) / 2, (corner[1:, :-1] + corner[:-1, 1:]) / 2
        even = np.add.outer(*(np.arange(m) for m in falling.shape)) % 2 == 0
        middle = slice(half, None, step)
        off = abs(np.where(even, falling, rising) - z[middle, middle])
        halves = _largest(needed, middle, middle, [(-half, 0), (half, 0), (0, -half), (0, half)])
        _raise(needed, middle, middle, off + halves)
        step *= 2
    return needed


def _largest(values: np.ndarray, rows: slice, cols: slice, offsets: list[tuple[int, int]]) -> np.ndarray:
    """Return the largest value among the neighbours of chosen points; beyond the grid there are none."""
    wide = np.pad(values, reach := max(abs(step) for offset in offsets for step in offset))
    row, col = (np.arange(len(values))[chosen] + reach for chosen in (rows, cols))
    return np.max([wide[np.ix_(row + down, col + right)] for down, right in offsets], axis=0)


def _raise(values: np.ndarray, rows: slice, cols: slice, least: np.ndarray) -> None:
    values[rows, cols] = np.maximum(values[rows, cols], least)


def _cut(kept: np.ndarray, n: int) -> np.ndarray:
    """Return the triangles whose middle is not kept, cut from the two halves of the square, shape (n, 3, 2)."""
    waiting = np.array([[(n, 0), (n, n), (0, 0)], [(0, n), (0, 0), (n, n)]])  # right angle first
    done = []
    while len(waiting):
        twice = waiting[:, 1] + waiting[:, 2]
        smallest = (twice % 2).any(axis=1)
        middle = twice // 2
        cut = ~smallest & kept[tuple(middle.T)]
        done.append(waiting[~cut])
        (apex, first, second), middle = waiting[cut].transpose(1, 0, 2), middle[cut]
        waiting = np.concatenate([np.stack([middle, apex, first], axis=1), np.stack([middle, second, apex], axis=1)])
    return np.concatenate(done)

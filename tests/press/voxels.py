"""From height maps to voxels and back, sharper than a voxel."""

import numpy as np


def fill_fractions(heights, support, grid):
    """Return how much of each voxel lies below the heights; ghost layers hold `support` (written or not)."""
    bottom = grid.z - grid.dz / 2
    fill = np.clip((heights[None] - bottom[:, None, None]) / grid.dz, 0.0, 1.0).astype(np.float32)
    fill[grid.z < 0] = support
    return fill


def with_true_moment(fill):
    """Move part of each partly filled voxel one layer down, so that the first moment of the column is right too.

    A voxel filled to f from its floor has its centre of mass (1 - f)/2 layers below the voxel centre; moving f(1 - f)/2
    into the full voxel below puts it there. The convolution then errs in third order of the layer thickness only.
    """
    moved = fill * (1 - fill) / 2
    moved[0] = 0
    moved[1:] *= fill[:-1] > 0.999
    out = fill - moved
    out[:-1] += moved[1:]
    return out


def top_crossing(field, grid):
    """Return the highest z at which `field` falls below 1, by a cubic through four layers; 0 where it never reaches 1.

    The upper layer of the bracket is found from the voxels, the place within it by bisection of Lagrange's cubic.
    """
    count = len(grid.z)
    inside = field >= 1
    last = count - 1 - np.argmax(inside[::-1], axis=0)
    last = np.clip(np.where(inside.any(axis=0), last, 0), 1, count - 3)
    values = [np.take_along_axis(field, (last + step)[None], axis=0)[0].astype(float) for step in (-1, 0, 1, 2)]
    low, high = np.zeros(last.shape), np.ones(last.shape)
    for _ in range(14):
        middle = (low + high) / 2
        above = _cubic(values, middle) >= 1
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    surface = grid.z[last] + (low + high) / 2 * grid.dz
    return np.where(inside.any(axis=0), np.maximum(surface, 0.0), 0.0)


def solid_shares(field, grid):
    """Return how much of each voxel of resin has a field of at least 1: below the crossing, and beside walls too.

    A column that ends at a height much unlike its neighbours' has a wall in it or beside it. It is taken as many thin
    columns, whose field comes from the pixels around: its logarithm by a parabola along each axis, the other axis after
    the one, since the tail of a Gaussian beam is one.
    """
    heights = top_crossing(field, grid)
    shares = _below(heights, grid)
    rows, cols = np.nonzero(_beside_wall(heights, grid))
    for some in np.array_split(np.arange(len(rows)), max(len(rows) * len(grid.z) // AT_ONCE, 1)):
        logs = np.log(np.maximum(_around(field, rows[some], cols[some]), FAINTEST))
        thin = np.zeros((np.sum(grid.z > 0), len(some)))
        for x, y in THIN:
            lines = [_parabola(logs[:, j], y) for j in range(3)]
            thin += _below(top_crossing(np.exp(_parabola(lines, x)), grid), grid)
        shares[:, rows[some], cols[some]] = thin / len(THIN)
    return shares


PAIRED = (0, 7), (1, 10), (2, 5), (3, 9), (4, 11), (6, 8)
THIN = tuple(
    (sign * (i + 0.5) / 24, other * (j + 0.5) / 24)
    for pair in PAIRED
    for i, j in (pair, pair[::-1])
    for sign in (-1, 1)
    for other in (-1, 1)
)
"""Places of thin columns in a pixel: mirrored and turned they are the same ones, and a wall along an axis passes few at
a time."""

WALL_SLOPE = 6.0
"""Neighbours whose heights differ by more than so many pitches have a wall between them."""

FAINTEST = 1e-9
AT_ONCE = 2_000_000  # values of one of the nine columns around


def _parabola(values, t):
    before, here, after = values
    return here + t * ((after - before) / 2 + t * (before - 2 * here + after) / 2)


def _around(field, rows, cols):
    """Return the columns around some and their own, (3, 3, layers, columns), at the rim of the plane those there."""
    near_y, near_x = (
        [np.clip(index + step, 0, count - 1) for step in (-1, 0, 1)]
        for index, count in ((rows, field.shape[1]), (cols, field.shape[2]))
    )
    return np.array([[field[:, y, x] for x in near_x] for y in near_y])


def _below(heights, grid):
    """Return how much of each voxel of resin lies below the heights, given for columns of any arrangement."""
    bottom = (grid.z[grid.z > 0] - grid.dz / 2).reshape(-1, *[1] * heights.ndim)
    return np.clip((heights - bottom) / grid.dz, 0, 1).astype(np.float32)


def _beside_wall(heights, grid):
    """Return which columns have a wall between them and a neighbour."""
    beside = np.zeros(heights.shape, bool)
    for lines, marks, pitch in ((heights, beside, grid.dy), (heights.T, beside.T, grid.dx)):
        jumps = np.abs(lines[1:] - lines[:-1]) > WALL_SLOPE * pitch
        marks[1:] |= jumps
        marks[:-1] |= jumps
    return beside


def _cubic(values, t):
    """Evaluate the cubic through the values at -1, 0, 1, 2 at t."""
    before, start, end, after = values
    return (
        -before * t * (t - 1) * (t - 2) / 6
        + start * (t + 1) * (t - 1) * (t - 2) / 2
        - end * (t + 1) * t * (t - 2) / 2
        + after * (t + 1) * t * (t - 1) / 6
    )


def peak(stack, inside):
    """Return the maximum of a smooth stack over some voxels, refined between them by a parabola along each axis.

    The parabolas are those of the stack itself, which goes on beyond the voxels that count; where it grows on there,
    they hold its maximum no more, and the highest of the voxels is it.
    """
    place = np.unravel_index(np.argmax(np.where(inside, stack, -np.inf)), stack.shape)
    top = float(stack[place])
    gain = 0.0
    for axis in range(stack.ndim):
        if 0 < place[axis] < stack.shape[axis] - 1:
            below, above = (float(stack[_moved(place, axis, step)]) for step in (-1, 1))
            bend = below - 2 * top + above
            if max(below, above) <= top and bend < 0:
                gain += -((above - below) ** 2) / (8 * bend)
    return top + gain


def _moved(place, axis, step):
    """Return an index moved by `step` along one axis."""
    return tuple(index + step if which == axis else index for which, index in enumerate(place))

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

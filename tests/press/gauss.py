"""Gaussian filters as banded matrices: resin or air outside the window is exactly zero, nothing wraps round.

Symbols: s = FWHM / 2.3548, the standard deviation.
"""

import numpy as np

SIGMA_PER_FWHM = 1 / np.sqrt(8 * np.log(2))
REACH = 5.0  # kernels end at this many standard deviations
FINEST = 0.5  # pixels; below this standard deviation a sampled Gaussian aliases
PARTS = 9  # sub-pixels then
BLOCK = 96


def parts_of(sigma_px):
    """Return into how many sub-pixels a pixel is refined, along each axis, for a Gaussian of this width in pixels."""
    return 1 if sigma_px >= FINEST else PARTS


def line_kernel(sigma_px, parts=None):
    """Return the weights of a Gaussian on whole pixels, sum 1, centre in the middle.

    From half a pixel on it is the sampled Gaussian (aliasing below 1.5 %, right for maps that are smooth between
    pixels). Below, every pixel is replicated into sub-pixels, the Gaussian is sampled on these and the weights of each
    pixel's sub-pixels are added: the same as refining the map, filtering it and reading it at the pixel centres.
    `parts` says otherwise, where the other axis decides.
    """
    if sigma_px < 1e-3:
        return np.ones(1)
    parts = parts or parts_of(sigma_px)
    half = int(np.ceil(REACH * sigma_px))
    fine = np.arange(-half * parts - parts // 2, half * parts + parts // 2 + 1) / parts
    weights = np.exp(-0.5 * (fine / sigma_px) ** 2).reshape(2 * half + 1, parts).sum(axis=1)
    return weights / weights.sum()


def _banded(kernel, count):
    """Return the matrix that applies `kernel` to a line of `count` pixels, and its half width."""
    half = len(kernel) // 2
    offset = np.arange(count)[:, None] - np.arange(count)[None, :] + half
    inside = (offset >= 0) & (offset < len(kernel))
    return np.where(inside, kernel[np.clip(offset, 0, len(kernel) - 1)], 0.0), half


def along_x(stack, kernel):
    """Filter the last axis with zeros outside."""
    if len(kernel) == 1:
        return stack * stack.dtype.type(kernel[0])
    count = stack.shape[-1]
    matrix, half = _banded(kernel, count)
    matrix = matrix.astype(stack.dtype)
    out = np.empty_like(stack)
    for start in range(0, count, BLOCK):
        stop = min(start + BLOCK, count)
        low, high = max(0, start - half), min(count, stop + half)
        out[..., start:stop] = stack[..., low:high] @ matrix[low:high, start:stop]
    return out


def along_y(stack, kernel):
    """Filter the last but one axis with zeros outside (turned over, because one large product beats many small)."""
    if len(kernel) == 1:
        return along_x(stack, kernel)
    turned = np.ascontiguousarray(np.swapaxes(stack, -1, -2))
    return np.ascontiguousarray(np.swapaxes(along_x(turned, kernel), -1, -2))


def along_z(stack, matrix):
    """Apply a (layers out, layers in) matrix to the first axis."""
    flat = stack.reshape(stack.shape[0], -1)
    return (matrix.astype(stack.dtype) @ flat).reshape((matrix.shape[0], *stack.shape[1:]))


def lateral(stack, s_x_um, s_y_um, grid):
    """Filter the layers of a stack (or one map) with a Gaussian of standard deviations in um, zeros outside."""
    return along_y(along_x(stack, line_kernel(s_x_um / grid.dx)), line_kernel(s_y_um / grid.dy))


def on_map(heights, s_um, grid):
    """Filter a map whose rim continues outside (weights renormalised), for what a microscope sees."""
    ones = np.ones_like(heights)
    return lateral(heights, s_um, s_um, grid) / lateral(ones, s_um, s_um, grid)

"""Gaussian smoothing over pixels, with empty resin (zeros) outside the array."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np
import scipy  # its parts are imported on first use: each takes longer than a small prediction, and most need none

FWHM_PER_SIGMA = 2 * np.sqrt(2 * np.log(2))
"""FWHM of a Gaussian of standard deviation 1. The paper writes σ for what are FWHMs."""

REACH_SIGMAS = 5.0
"""Kernels end here; the mass beyond is 6e-7."""

COARSE_PIXELS_PER_SIGMA = 5.0
"""A wide Gaussian leaves nothing finer than this many pixels per standard deviation can hold (to about 1e-5)."""

WIDE_PIXELS_PER_SIGMA = 4.0
"""The same for means that are read at points only, not over pixels."""

NOTHING = 1e-12
"""Weights below this are taken as 0."""

FAINT = 1e-7
"""Weights of a mean or an interpolation that do not count: a height's error stays far below a nanometre."""

BLOCK_PX = 64
"""Pixels of a line that one matrix product gives: a convolution by blocks is several times quicker than tap by tap."""

NEWTON_STEPS = 60
"""Enough for the narrowest kernels, where every step first gains little more than a unit of the exponent."""


@lru_cache(maxsize=256)
def mean_taps(width_px: float) -> np.ndarray:
    """Return the weights of five pixels whose sum is the mean over a width about the middle one.

    f + w²/24·f″ + w⁴/1920·f⁗ with derivatives by differences, exact for polynomials of fifth order.

    Examples
    --------
    >>> (5760 * mean_taps(1.0)).round(6).tolist()
    [-17.0, 308.0, 5178.0, 308.0, -17.0]
    """
    second, fourth = width_px**2 / 24, width_px**4 / 1920 - width_px**2 / 288
    bends = np.array([0, 1, -2, 1, 0]), np.array([1, -4, 6, -4, 1])
    return np.array([0.0, 0, 1, 0, 0]) + second * bends[0] + fourth * bends[1]


def means_over(maps: np.ndarray, width_px: float) -> np.ndarray:
    """Return maps (..., rows, cols) as means over squares of this side; beyond the rim the last pixel goes on."""
    for axis in (-2, -1) if width_px else ():
        maps = scipy.ndimage.correlate1d(maps, mean_taps(width_px), axis=axis, mode="nearest")
    return maps


@lru_cache(maxsize=256)
def gaussian_taps(sigma_px: float) -> np.ndarray:
    """Return a sampled Gaussian of sum 1 whose variance over the pixels is exactly sigma_px².

    Above one pixel this is the Gaussian itself. Below, plain sampling loses width (at 0.4 pixels a third
    of it); the exponent is then chosen so that the variance is kept, so a width in µm means the same at every pitch.

    Parameters
    ----------
    sigma_px : float
        Standard deviation in pixels, ≥ 0.

    Returns
    -------
    numpy.ndarray, shape (2·radius + 1,)

    Examples
    --------
    >>> taps = gaussian_taps(0.4)
    >>> n = np.arange(len(taps)) - len(taps) // 2
    >>> round(float(taps @ n**2), 9)
    0.16
    """
    radius = int(np.ceil(REACH_SIGMAS * sigma_px))
    if radius == 0:
        return np.ones(1)
    squares = np.arange(-radius - 2, radius + 3) ** 2.0

    def taps(exponent: float) -> np.ndarray:
        weights = np.exp(-exponent * squares)
        return weights / weights.sum()

    exponent = 0.5 / sigma_px**2
    if sigma_px < 1:
        exponent = 0.5 / (sigma_px + 0.5) ** 2  # too wide; from there Newton's steps never overshoot: Σ n² w is convex
        for _ in range(NEWTON_STEPS):
            weights = taps(exponent)
            variance = weights @ squares
            exponent += (variance - sigma_px**2) / (weights @ squares**2 - variance**2)
    kernel = taps(exponent)
    kernel.setflags(write=False)
    return kernel


def blur(planes: np.ndarray, sigma_y_px: float, sigma_x_px: float) -> np.ndarray:
    """Convolve the last two axes with an axis-parallel Gaussian; outside the array there is nothing.

    Parameters
    ----------
    planes : numpy.ndarray, shape (..., rows, cols)
        One plane or a stack.
    sigma_y_px, sigma_x_px : float
        Standard deviations along rows (axis −2) and columns (axis −1), pixels.
    """
    for axis, sigma in ((-2, sigma_y_px), (-1, sigma_x_px)):
        taps = gaussian_taps(float(sigma))
        if len(taps) > 1:
            planes = _convolved(planes, _block(float(sigma), planes.dtype), len(taps) // 2, axis)
    return planes


def _convolved(planes: np.ndarray, block: np.ndarray, radius: int, axis: int) -> np.ndarray:
    """Multiply every `BLOCK_PX` pixels of an axis, and those within the radius, with the block of taps."""
    count, result = planes.shape[axis], np.empty_like(planes)
    for start in range(0, count, BLOCK_PX):
        stop = min(start + BLOCK_PX, count)
        around = slice(max(start - radius, 0), min(stop + radius, count))
        part = block[around.start - start + radius : around.stop - start + radius, : stop - start]
        if axis == -1:
            result[..., start:stop] = planes[..., around] @ part
        else:
            result[..., start:stop, :] = part.T @ planes[..., around, :]
    return result


@lru_cache(maxsize=32)
def _block(sigma_px: float, dtype: np.dtype) -> np.ndarray:
    """Return the taps from pixels to a block in their middle, shape (BLOCK_PX + 2·radius, BLOCK_PX)."""
    taps = gaussian_taps(sigma_px)
    offsets = np.arange(BLOCK_PX + len(taps) - 1)[:, None] - np.arange(BLOCK_PX)
    inside = (offsets >= 0) & (offsets < len(taps))
    block = np.where(inside, taps[np.clip(offsets, 0, len(taps) - 1)], 0).astype(dtype)
    block.setflags(write=False)
    return block


def banded(matrix: np.ndarray, planes: np.ndarray, axis: int = 0) -> np.ndarray:
    """Multiply the first or the last axis of planes with a matrix whose weights lie near its diagonal.

    Block of rows by block, without the weights that do not count: on large maps that is most of them.

    Parameters
    ----------
    matrix : numpy.ndarray, shape (wanted, given)
    planes : numpy.ndarray, shape (given, ...) or (..., given)
    axis : int
        0 or -1.

    Examples
    --------
    >>> banded(np.eye(3, 2), np.arange(8.0).reshape(2, 2, 2)).shape
    (3, 2, 2)
    """
    if axis == 0:
        flat = planes.reshape(len(planes), -1)
        blocks = [part @ flat[near] for part, near in _bands(matrix)]
        return np.concatenate(blocks).reshape(-1, *planes.shape[1:])
    flat = planes.reshape(-1, planes.shape[-1])
    blocks = [flat[:, near] @ part.T for part, near in _bands(matrix)]
    return np.concatenate(blocks, axis=1).reshape(*planes.shape[:-1], -1)


def _bands(matrix: np.ndarray) -> Iterator[tuple[np.ndarray, slice]]:
    """Yield blocks of rows of a matrix, cut to the columns that count in them, and these columns."""
    for start in range(0, len(matrix), BLOCK_PX):
        rows = matrix[start : start + BLOCK_PX]
        used = np.flatnonzero(np.abs(rows).max(axis=0) > FAINT)
        near = slice(used[0], used[-1] + 1) if len(used) else slice(0)
        yield rows[:, near], near


def block_mean(planes: np.ndarray, factors: Sequence[int]) -> np.ndarray:
    """Average planes (..., rows, cols) over blocks of whole pixels, (rows, cols) each; they must hold whole blocks."""
    if max(factors) == 1:
        return planes
    stack, (rows, cols) = planes.shape[:-2], (n // m for n, m in zip(planes.shape[-2:], factors, strict=True))
    weights = np.full(factors[1], 1 / (factors[0] * factors[1]), planes.dtype)
    return planes.reshape(*stack, rows, factors[0], -1).sum(axis=-2).reshape(*stack, rows, cols, factors[1]) @ weights


def wide_blur(planes: np.ndarray, sigma_y_px: float, sigma_x_px: float) -> np.ndarray:
    """Do what `blur` does, to about 1e-5 of a step, but evaluate a wide Gaussian on no more points than it needs."""
    if min(sigma_y_px, sigma_x_px) < WIDE_PIXELS_PER_SIGMA:
        return blur(planes, sigma_y_px, sigma_x_px)
    (down_y, up_y), (down_x, up_x) = (
        (matrix.astype(planes.dtype) for matrix in sparse_means(n, float(s)))
        for n, s in zip(planes.shape[-2:], (sigma_y_px, sigma_x_px), strict=True)
    )
    return up_y @ (down_y @ planes @ down_x.T) @ up_x.T


@lru_cache(maxsize=16)
def sparse_means(count: int, sigma_px: float, finer: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return Gaussian means along a row of pixels as two matrices, up @ down, that meet at few points.

    The points lie σ/4 apart, or one pixel where σ is below 4 pixels: no more than a cubic spline through them needs.

    Parameters
    ----------
    count : int
        Pixels in the row; beyond it there is nothing.
    sigma_px : float
        Standard deviation in pixels.
    finer : int
        Parts of a pixel at whose centres the means are wanted.

    Returns
    -------
    down : numpy.ndarray, shape (points, count)
        From the pixels to the means at the points.
    up : numpy.ndarray, shape (finer · count, points)
        From the means at the points to those wanted.
    """
    step, pixels = sigma_px / WIDE_PIXELS_PER_SIGMA, np.arange(count)
    if step <= 1:
        points = np.arange(-3.0, count + 3)
        taps = np.pad(gaussian_taps(sigma_px), 1)
        middle = len(taps) // 2
        down = taps[np.clip(points[:, None] - pixels, -middle, middle).astype(int) + middle]
    else:
        half = int(np.ceil((count - 1) / 2 / step)) + 3
        points = (count - 1) / 2 + step * np.arange(-half, half + 1)  # a mirrored map has mirrored points
        down = np.exp(-(((points[:, None] - pixels) / sigma_px) ** 2) / 2) / (sigma_px * np.sqrt(2 * np.pi))
    wanted = (np.arange(finer * count) + 0.5) / finer - 0.5
    up = spline_matrix(len(points), (wanted - points[0]) / (points[1] - points[0]))
    for matrix in (down, up):
        # in single precision the least of them would be denormal numbers, with which a product takes many times longer
        matrix[np.abs(matrix) < NOTHING] = 0
        matrix.setflags(write=False)
    return down, up


def spline_matrix(count: int, places: np.ndarray) -> np.ndarray:
    """Return what a cubic spline through values at 0, 1, …, count − 1 reads at places between them.

    The one that SciPy makes (its third derivative goes through the first and the last inner value), without loading
    SciPy's splines, which takes longer than a small prediction.

    Returns
    -------
    numpy.ndarray, shape (places, count)

    Examples
    --------
    >>> from scipy.interpolate import make_interp_spline
    >>> places = np.linspace(0, 6, 50)
    >>> expected = make_interp_spline(np.arange(7.0), np.eye(7), k=3)(places)
    >>> bool(np.abs(spline_matrix(7, places) - expected).max() < 1e-12)
    True
    """
    bend = np.eye(count, k=-1) + 4 * np.eye(count) + np.eye(count, k=1)
    rise = 6 * (np.eye(count, k=-1) - 2 * np.eye(count) + np.eye(count, k=1))
    bend[[0, -1]], rise[[0, -1]] = 0, 0
    bend[0, :3], bend[-1, -3:] = (1, -2, 1), (1, -2, 1)
    bends = np.linalg.solve(bend, rise)  # second derivatives at the values
    left = np.clip(np.floor(places).astype(int), 0, count - 2)
    t = (places - left)[:, None]
    values = np.eye(count)
    return (
        (1 - t) * values[left]
        + t * values[left + 1]
        + (((1 - t) ** 3 - (1 - t)) * bends[left] + (t**3 - t) * bends[left + 1]) / 6
    )


def blur_turned(planes: np.ndarray, covariance_px: np.ndarray) -> np.ndarray:
    """Convolve the last two axes with a Gaussian of any orientation; outside the array there is nothing.

    The kernel is `turned_taps`. Without correlation this is `blur`, and it tends to it.

    Parameters
    ----------
    planes : numpy.ndarray, shape (..., rows, cols)
    covariance_px : numpy.ndarray, shape (2, 2)
        Covariance in pixels², order (x, y) with y upwards.
    """
    (xx, xy), (_, yy) = covariance_px
    taps, fft = turned_taps(float(xx), float(xy), float(yy)), scipy.fft
    rows, cols = planes.shape[-2:]
    shape = [fft.next_fast_len(max(n + m // 2, m), real=True) for n, m in zip((rows, cols), taps.shape, strict=True)]
    kernel = np.zeros(shape, planes.dtype)
    kernel[: taps.shape[0], : taps.shape[1]] = taps
    kernel = np.roll(kernel, [-(m // 2) for m in taps.shape], axis=(0, 1))
    return fft.irfft2(fft.rfft2(planes, shape) * fft.rfft2(kernel), shape)[..., :rows, :cols]


@lru_cache(maxsize=64)
def turned_taps(xx: float, xy: float, yy: float) -> np.ndarray:
    """Return a sampled Gaussian of any orientation, of sum 1, whose covariance over the pixels is exactly Σ.

    What `gaussian_taps` is along one axis: the weights are exp(−nᵀ A n), with A = Σ⁻¹/2 where the narrowest width is
    one pixel or more. Below, A is chosen so that the covariance is kept: it is where the convex
    ln Σₙ exp(−nᵀ A n) + tr(A Σ) is least, found by Newton's steps that start too wide and are halved if they overshoot.

    Parameters
    ----------
    xx, xy, yy : float
        Σ in pixels², x to the right, y upwards; positive definite.

    Returns
    -------
    numpy.ndarray, shape (rows, cols)
        Both odd, centre in the middle, rows downwards.

    Examples
    --------
    >>> taps = turned_taps(0.5, 0.3, 0.3)
    >>> y, x = (np.arange(n) - n // 2 for n in taps.shape)
    >>> float((-y @ taps @ x).round(9)), float((taps @ x**2).sum().round(9))
    (0.3, 0.5)
    """
    half_x, half_y = (int(np.ceil(REACH_SIGMAS * np.sqrt(variance))) + 2 for variance in (xx, yy))
    y, x = np.mgrid[half_y : -half_y - 1 : -1, -half_x : half_x + 1].astype(float)
    squares, wanted = np.stack([x * x, 2 * x * y, y * y]).reshape(3, -1), np.array([xx, 2 * xy, yy])

    def weighed(exponents: np.ndarray) -> tuple[np.ndarray, float]:
        powers = -exponents @ squares
        weights = np.exp(powers - powers.max())
        return weights / weights.sum(), float(np.log(weights.sum()) + powers.max() + exponents @ wanted)

    narrow = np.linalg.eigvalsh([[xx, xy], [xy, yy]])[0] < 1
    wider = 0.25 + np.sqrt(min(xx, yy)) if narrow else 0.0
    determinant = (xx + wider) * (yy + wider) - xy**2
    exponents = np.array([yy + wider, -xy, xx + wider]) / (2 * determinant)
    weights, value = weighed(exponents)
    for _ in range(NEWTON_STEPS if narrow else 0):
        excess = squares @ weights - wanted
        if np.abs(excess).max() < NOTHING * max(xx, yy):
            break
        spread = np.cov(squares, aweights=weights, ddof=0)
        scale = 1 / np.sqrt(np.diag(spread))
        step = scale * np.linalg.lstsq(spread * np.outer(scale, scale), scale * excess, rcond=None)[0]
        for _ in range(NEWTON_STEPS):
            trial_weights, trial = weighed(exponents + step)
            if trial <= value + NOTHING * (1 + abs(value)):
                break
            step = step / 2
        exponents, weights, value = exponents + step, trial_weights, trial
    taps: np.ndarray = weights.reshape(x.shape)
    taps.setflags(write=False)
    return taps

"""Gaussian smoothing over pixels, with empty resin (zeros) outside the array."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy import fft, ndimage, signal
from scipy.optimize import brentq

FWHM_PER_SIGMA = 2 * np.sqrt(2 * np.log(2))
"""FWHM of a Gaussian of standard deviation 1. The paper writes σ for what are FWHMs."""

REACH_SIGMAS = 5.0
"""Kernels end here; the mass beyond is 6e-7."""

_LONG_KERNEL = 129
"""Taps above which convolution goes through Fourier space."""


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
        low, high = 0.5 / (sigma_px + 0.5) ** 2, exponent
        while taps(high) @ squares > sigma_px**2:
            high *= 2
        exponent = brentq(lambda a: taps(a) @ squares - sigma_px**2, low, high, xtol=1e-14, rtol=1e-13)
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
        if len(taps) > _LONG_KERNEL:
            shape = [1] * planes.ndim
            shape[axis] = len(taps)
            planes = signal.oaconvolve(planes, taps.astype(planes.dtype).reshape(shape), mode="same", axes=axis)
        elif len(taps) > 1:
            planes = ndimage.correlate1d(planes, taps, axis=axis, mode="constant")
    return planes


def blur_turned(planes: np.ndarray, covariance_px: np.ndarray) -> np.ndarray:
    """Convolve the last two axes with a Gaussian of any orientation; outside the array there is nothing.

    The transfer function exp(−2π² fᵀΣf) is applied on a frame widened by the kernel's reach.

    Parameters
    ----------
    planes : numpy.ndarray, shape (..., rows, cols)
    covariance_px : numpy.ndarray, shape (2, 2)
        Covariance in pixels², order (x, y) with y upwards.
    """
    rows, cols = planes.shape[-2:]
    reach = int(np.ceil(REACH_SIGMAS * np.sqrt(np.max(np.diag(covariance_px)))))
    shape = [fft.next_fast_len(n + reach, real=True) for n in (rows, cols)]
    fx, fy = np.meshgrid(fft.rfftfreq(shape[1]), -fft.fftfreq(shape[0]))
    (xx, xy), (_, yy) = covariance_px
    transfer = np.exp(-2 * np.pi**2 * (xx * fx**2 + 2 * xy * fx * fy + yy * fy**2))
    spectrum = fft.rfft2(planes, shape, workers=-1) * transfer
    return fft.irfft2(spectrum, shape, workers=-1)[..., :rows, :cols]

"""Noise of a recording: correlated, white, by rows, blotches and spikes. Everything takes a random generator."""

import numpy as np
from scipy.fft import irfft2, next_fast_len, rfft2


def _autocorrelation(distance, kind):
    """Return the correlation at a distance in units of the correlation length."""
    if kind == "gaussian":
        return np.exp(-(distance**2) / 4)
    if kind == "matern32":
        return (1 + np.sqrt(3) * distance) * np.exp(-np.sqrt(3) * distance)
    if kind == "exponential":
        return np.exp(-distance)
    raise ValueError(f"noise.kind: {kind}, allowed are gaussian, matern32, exponential")


def correlated(rng, shape, grid, length_um, kind="gaussian"):
    """Return a normal field of unit variance.

    `gaussian` is white noise filtered with a Gaussian of standard deviation `length_um` (correlation exp(-r^2/4l^2));
    `matern32` and `exponential` have (1 + sqrt(3) r/l) exp(-sqrt(3) r/l) and exp(-r/l). The field is drawn by FFT on a
    larger torus and cut out.
    """
    if length_um <= 0:
        return rng.standard_normal(shape)
    rim = [int(np.ceil(8 * length_um / pitch)) for pitch in (grid.dy, grid.dx)]
    big = [next_fast_len(count + extra, real=True) for count, extra in zip(shape, rim, strict=True)]
    y, x = (np.minimum(np.arange(count), count - np.arange(count)) for count in big)
    distance = np.hypot(x[None, :] * grid.dx, y[:, None] * grid.dy) / length_um
    power = np.maximum(rfft2(_autocorrelation(distance, kind)).real, 0)
    field = irfft2(rfft2(rng.standard_normal(big)) * np.sqrt(power), s=big)
    return field[: shape[0], : shape[1]]


def blotches(rng, shape, grid, fraction, size_um):
    """Return a mask that covers `fraction` of the map in blotches of about `size_um`."""
    field = correlated(rng, shape, grid, size_um / 2)
    return field > np.quantile(field, 1 - fraction) if fraction > 0 else np.zeros(shape, bool)


def spikes(rng, shape, fraction, height_um):
    """Return single wrong pixels of either sign with exponentially distributed heights."""
    hit = rng.random(shape) < fraction
    return hit * rng.choice([-1.0, 1.0], shape) * rng.exponential(height_um, shape)

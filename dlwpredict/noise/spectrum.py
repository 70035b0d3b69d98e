"""Power spectra of what is left of a recording, along x and y, beside those that its noise model expects.

A line's periodogram, tapered by Hann's window, points that do not count at weight 0, is averaged over all lines. The
model's is not fitted: it is the expectation of the same figure, holes and taper included.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from dlwpredict.noise.covariance import Noise  # noqa: F401  (the doctest's)
from dlwpredict.noise.unevenness import Uneven

PER_OCTAVE = 4
"""Bands of frequency per octave; where lines of the spectrum are further apart, each is a band."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """One-sided power spectral density along one axis; its integral over the frequency is the variance.

    Parameters
    ----------
    per_um : numpy.ndarray, shape (bands,)
        Frequency, 1/µm.
    measured_um3, model_um3 : numpy.ndarray, shape (bands,)
        µm² per 1/µm.
    """

    per_um: np.ndarray
    measured_um3: np.ndarray
    model_um3: np.ndarray


def spectra(
    residual_um: np.ndarray, used: np.ndarray, noise: Uneven, slope: np.ndarray | float = 0.0
) -> tuple[Spectrum, Spectrum]:
    """Return the spectra along x and along y.

    Parameters
    ----------
    residual_um : numpy.ndarray, shape (rows, cols)
        Recording − prediction.
    used : numpy.ndarray of bool, shape (rows, cols)
    noise : Uneven
    slope : numpy.ndarray, shape (rows, cols), or 0
        |∇f|, on which the noise hangs.

    Examples
    --------
    >>> white = Uneven(Noise(0.01, 0.0, 1.0, 0.5, 0.5))
    >>> along_x, _ = spectra(np.zeros((8, 64)), np.ones((8, 64), dtype=bool), white)
    >>> (along_x.model_um3 / (2 * 0.01**2 * 0.5)).round(3).tolist()[::5]  # 2σ²·dx at all frequencies
    [1.0, 1.0, 1.0, 1.0]
    """
    scale = np.broadcast_to(noise.scale(slope), used.shape)
    even = replace(noise.even, dx_um=noise.even.dy_um, dy_um=noise.even.dx_um)
    turned = replace(noise, even=even, rows=noise.columns, columns=noise.rows)
    return _along_rows(residual_um, used, noise, scale), _along_rows(residual_um.T, used.T, turned, scale.T)


def _along_rows(residual_um: np.ndarray, used: np.ndarray, noise: Uneven, scale: np.ndarray) -> Spectrum:
    """Return the spectrum along rows.

    With weights w, E Σ_rows |Σ_j w_j ε_j e^(−2πi·f·x_j)|² = Σ_d C(d)·A(d)·e^(−2πi·f·d·dx), where A(d) = Σ w_j·w_(j+d)
    over all rows. Lines that are rows, or lean against them, and columns have the covariance of lines that lie as many
    lines apart as d pixels cross; the tilt of a row grows along it, and is taken as if rows did not lean.
    """
    rows, cols = used.shape
    dx_um, period = noise.even.dx_um, fft.next_fast_len(2 * cols, real=True)
    weights = used * (0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(cols) + 0.5) / cols))

    def power(values: np.ndarray) -> np.ndarray:
        return np.sum(np.abs(fft.rfft(values, period, axis=1)) ** 2, axis=0)

    def expected(covariance: np.ndarray, weighted: np.ndarray) -> np.ndarray:
        lags = np.minimum(np.arange(period), period - np.arange(period))
        at_lags = np.append(covariance, np.zeros(period))[lags]
        return fft.rfft(fft.irfft(power(weighted), period) * at_lags).real

    apart = np.arange(cols)
    model = expected(noise.even.at(apart * dx_um), weights * scale)
    if noise.row_um or noise.rows.tilt_um:
        model += expected(noise.rows.between(noise.rows.lean * apart), weights)
        model += noise.rows.tilt_um**2 * power(weights * np.linspace(-1, 1, cols))
    if noise.column_um or noise.columns.tilt_um:
        model += expected(noise.columns.between(apart), weights)
        model += noise.columns.tilt_um**2 * np.sum((weights * np.linspace(-1, 1, rows)[:, None]) ** 2)
    both = np.stack([power(weights * residual_um), model]) * (2 * dx_um / max(float(np.sum(weights**2)), 1e-300))
    return Spectrum(*_banded(fft.rfftfreq(period, dx_um), both, cols * dx_um))


def _banded(per_um: np.ndarray, densities: np.ndarray, length_um: float) -> np.ndarray:
    """Return mean frequencies and densities of bands, one wave per length and above, shape (1 + spectra, bands)."""
    first, last = 1 / length_um, per_um[-1]
    count = max(int(PER_OCTAVE * np.log2(last / first)), 1)
    band = np.searchsorted(np.geomspace(first, last * (1 + 1e-9), count + 1), per_um, side="right")
    inside = (band > 0) & (band <= count)
    members = np.bincount(band[inside], minlength=count + 1)
    held = members > 0

    def mean(values: np.ndarray) -> np.ndarray:
        return np.bincount(band[inside], values[inside], minlength=count + 1)[held] / members[held]

    return np.stack([mean(values) for values in (per_um, *densities)])

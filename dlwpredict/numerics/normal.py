"""The integral of the standard Gaussian and its inverse, as exact as predictions need, and quicker than SciPy's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_ARTANH_ERF = (1.425005e-6, -3.6693431e-5, -8.7826621e-5, 0.036392286, 0.79786971)
"""artanh(2Φ(x) − 1) / x as a polynomial in x², fitted for the smallest error of Φ up to 6; it rises beyond."""

_NDTRI = (0.0168853670, 0.624387671), (6.03085565e-5, 0.0431534137, 1.0)
"""Φ⁻¹ / logit as a ratio of polynomials in logit², fitted for the smallest error up to 3.75."""


def ndtr(x: np.ndarray) -> np.ndarray:
    """Return Φ(x), the integral of the standard Gaussian, to 1.5e-6: five times quicker than SciPy's.

    Examples
    --------
    >>> from scipy import special
    >>> x = np.linspace(-40, 40, 4001)
    >>> bool(np.abs(ndtr(x) - special.ndtr(x)).max() < 1.5e-6), ndtr(x.astype(np.float32)).dtype
    (True, dtype('float32'))
    """
    result = _polynomial(_ARTANH_ERF, x * x)
    result *= x
    np.tanh(result, out=result)
    result += 1
    result *= 0.5
    return result


def ndtri_of_odds(odds: np.ndarray) -> np.ndarray:
    """Return Φ⁻¹(p) for odds p / (1 − p), to 0.0014 up to ±3.75: SciPy's takes longer to load than a small prediction.

    Examples
    --------
    >>> from scipy import special
    >>> x = np.linspace(-3.75, 3.75, 751)
    >>> bool(np.abs(ndtri_of_odds(special.ndtr(x) / special.ndtr(-x)) - x).max() < 0.0014)
    True
    """
    logit = np.log(odds)
    square = logit * logit
    above, below = (_polynomial(coefficients, square) for coefficients in _NDTRI)
    logit *= above
    logit /= below
    return logit


def _polynomial(coefficients: Sequence[float], x: np.ndarray) -> np.ndarray:
    """Return a polynomial, highest coefficient first, by Horner's rule in place: twice as quick as NumPy's."""
    result = np.full_like(x, coefficients[0])  # an array for a number, too
    result *= x
    for coefficient in coefficients[1:-1]:
        result += coefficient
        result *= x
    result += coefficients[-1]
    return result

"""How surely the largest of many energies is more than noise."""

from __future__ import annotations

import numpy as np

LARGEST_OF = 80
"""Draws whose largest energies are looked at: two parameters of a Gumbel law to 8 and 10 %."""


def p_of_largest(energy: float, largest: np.ndarray, of: int = 1) -> float:
    """Return the probability that the largest energy of noise alone reaches this one in any of several recordings.

    The largest of many squares of normal scores follows Gumbel's law; its two parameters are those of the draws.
    """
    scale = np.sqrt(6) / np.pi * largest.std(ddof=1)
    single = -np.expm1(-np.exp(-(energy - largest.mean()) / scale - np.euler_gamma))
    return float(-np.expm1(of * np.log1p(-min(single, 1 - 1e-12))))

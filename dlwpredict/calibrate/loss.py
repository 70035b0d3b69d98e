"""What a residual costs: its square, or less than that where it is a spike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

HUBER_CUT = 3.0
"""Residuals up to this many standard deviations cost their square; noise is left alone, spikes lose their hold."""


class Loss(Protocol):
    """How residuals are weighed."""

    def cost(self, residual_um: np.ndarray) -> float:
        """Return the sum over all points, µm²."""
        ...

    def weights(self, residual_um: np.ndarray) -> np.ndarray:
        """Return the weight of every point in an equivalent square loss, 0–1."""
        ...


@dataclass(frozen=True)
class Square:
    """Σ r²: the paper's root mean square error."""

    def cost(self, residual_um: np.ndarray) -> float:
        """Return Σ r², µm²."""
        return float(residual_um @ residual_um)

    def weights(self, residual_um: np.ndarray) -> np.ndarray:
        """Return ones."""
        return np.ones_like(residual_um)


@dataclass(frozen=True)
class Huber:
    """Σ ρ(r) with ρ = r² up to c·σ, and 2cσ|r| − c²σ² beyond (Huber 1964).

    Parameters
    ----------
    sigma_um : float
        Scale of the honest residuals, µm.
    """

    sigma_um: float

    def cost(self, residual_um: np.ndarray) -> float:
        """Return Σ ρ(r), µm²."""
        cut, size = HUBER_CUT * self.sigma_um, np.abs(residual_um)
        return float(np.where(size <= cut, size**2, 2 * cut * size - cut**2).sum())

    def weights(self, residual_um: np.ndarray) -> np.ndarray:
        """Return min(1, cσ/|r|)."""
        cut = HUBER_CUT * self.sigma_um
        return cut / np.maximum(np.abs(residual_um), cut)


def scale_um(residual_um: np.ndarray) -> float:
    """Return the standard deviation of the bulk of the residuals, 1.4826·median|r|; at least 1 nm.

    Examples
    --------
    >>> round(scale_um(np.array([-0.1, 0.1, 0.1, -0.1, 50.0])), 5)
    0.14826
    """
    return max(float(1.4826 * np.median(np.abs(residual_um))), 1e-3)

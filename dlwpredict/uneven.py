"""Noise that is not the same everywhere on a map: more on slopes, and with offsets of whole rows and columns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.noise import Noise


@dataclass(frozen=True)
class Uneven:
    """Noise that is not the same everywhere: more on slopes, and with offsets of whole rows and columns.

    ε(x, y)·(1 + (jitter·|∇f|/σ)^p)^(1/p) + u(y) + v(x): a lateral jitter becomes height where the surface f is steep
    (in quadrature, p = 2, where it is independent of ε), and scanning instruments give every line that they scan an
    offset of its own.

    Parameters
    ----------
    even : Noise
        ε, of standard deviation σ on flat ground.
    jitter_um : float
        Standard deviation of the lateral jitter, µm.
    power : float
        p.
    row_um, column_um : float
        Standard deviations of the offsets, µm.

    Examples
    --------
    >>> round(float(Uneven(Noise(0.003, 0.004, 1.0, 0.5, 0.5), jitter_um=0.012).scale(1.0)), 9)
    2.6
    """

    even: Noise
    jitter_um: float = 0.0
    power: float = 2.0
    row_um: float = 0.0
    column_um: float = 0.0

    @property
    def sigma_um(self) -> float:
        """Standard deviation of one pixel on flat ground, µm."""
        return float(np.sqrt(self.even.sigma_um**2 + self.row_um**2 + self.column_um**2))

    def scale(self, slope: np.ndarray | float) -> np.ndarray:
        """Return how many times stronger ε is on a slope |∇f| than on flat ground."""
        return grown(self.jitter_um / self.even.sigma_um * np.asarray(slope), self.power)

    def simulate(self, shape: tuple[int, int], rng: np.random.Generator, slope: np.ndarray | float = 0.0) -> np.ndarray:
        """Draw one map of noise, shape (rows, cols), on ground of this slope."""
        drawn = self.even.simulate(shape, rng) * self.scale(slope)
        drawn += self.row_um * rng.standard_normal((shape[0], 1)) if self.row_um else 0.0
        return drawn + (self.column_um * rng.standard_normal((1, shape[1])) if self.column_um else 0.0)


def grown(ratio: np.ndarray | float, power: float) -> np.ndarray:
    """Return (1 + ratio^p)^(1/p): 1 for a small, the ratio itself for a large one."""
    return (1 + np.power(ratio, power)) ** (1 / power)

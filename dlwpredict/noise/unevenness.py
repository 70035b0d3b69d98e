"""Noise that is not the same everywhere on a map: more on slopes, and with offsets and tilts of whole rows and columns.

Offsets of a tenth of the noise of one point are still what the mean of a long row consists of, and noise that is twice
as strong on slopes is what stands out there; free forms, ripples and names then find structure where there is none.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.lines import Lines


@dataclass(frozen=True, eq=False)
class Ground:
    """What the noise of a map may hang on.

    Parameters
    ----------
    slope : numpy.ndarray, shape (rows, cols), or 0
        |∇f| of the surface.
    axes : tuple of int
        Whether lines of the scan may be rows (0), or columns (1).
    lean : float
        Lines that a row, or a column, crosses per pixel, where it is known how the scan is turned against the map.
    read_px : float
        Pitch of an instrument's pixels between which the map was read, in its own pixels; 0: they are the instrument's.
        What neighbours nearer than that share is the reading's, and tells nothing of the noise farther away.
    """

    slope: np.ndarray | float = 0.0
    axes: tuple[int, ...] = (0, 1)
    lean: float = 0.0
    read_px: float = 0.0


@dataclass(frozen=True)
class Uneven:
    """Noise that is not the same everywhere: more on slopes, and with offsets and tilts of whole rows and columns.

    ε(x, y)·(1 + (jitter·|∇f|/σ)^p)^(1/p) + u(y) + v(x): a lateral jitter becomes height where the surface f is steep
    (in quadrature, p = 2, where it is independent of ε), and scanning instruments give every line that they scan an
    offset and a tilt of its own. Lines lean where a scan is known to be turned against the map; where that is not
    known, they are rows or columns.

    Parameters
    ----------
    even : Noise
        ε, of standard deviation σ on flat ground.
    jitter_um : float
        Standard deviation of the lateral jitter, µm.
    power : float
        p.
    rows, columns : Lines

    Examples
    --------
    >>> round(float(Uneven(Noise(0.003, 0.004, 1.0, 0.5, 0.5), jitter_um=0.012).scale(1.0)), 9)
    2.6
    """

    even: Noise
    jitter_um: float = 0.0
    power: float = 2.0
    rows: Lines = field(default_factory=Lines)
    columns: Lines = field(default_factory=Lines)

    @property
    def sigma_um(self) -> float:
        """Standard deviation of one pixel on flat ground, on the middle of its lines, µm."""
        return float(np.sqrt(self.even.sigma_um**2 + self.row_um**2 + self.column_um**2))

    @property
    def row_um(self) -> float:
        """Standard deviation of the offsets of rows, µm."""
        return self.rows.offset_um

    @property
    def column_um(self) -> float:
        """Standard deviation of the offsets of columns, µm."""
        return self.columns.offset_um

    @property
    def ways(self) -> tuple[bool, ...]:
        """In which ways it is uneven."""
        parts = (
            size > 0 for lines in (self.rows, self.columns) for size in (lines.red_um, lines.hum_um, lines.tilt_um)
        )
        return (self.jitter_um > 0, self.row_um > 0, self.column_um > 0, *parts)

    def scale(self, slope: np.ndarray | float) -> np.ndarray:
        """Return how many times stronger ε is on a slope |∇f| than on flat ground."""
        return grown(self.jitter_um / self.even.sigma_um * np.asarray(slope), self.power)

    def simulate(self, shape: tuple[int, int], rng: np.random.Generator, slope: np.ndarray | float = 0.0) -> np.ndarray:
        """Draw one map of noise, shape (rows, cols), on ground of this slope."""
        return self.simulate_many(shape, rng, 1, slope)[0]

    def simulate_many(
        self, shape: tuple[int, int], rng: np.random.Generator, count: int, slope: np.ndarray | float = 0.0
    ) -> np.ndarray:
        """Draw maps of noise, shape (count, rows, cols), on ground of this slope."""
        drawn = self.even.simulate_many(shape, rng, count)
        if self.jitter_um:
            drawn *= self.scale(slope)
        if self.row_um:
            drawn += self.rows.simulate(*shape, rng, count)
        if self.column_um:
            drawn += self.columns.simulate(*shape[::-1], rng, count).swapaxes(1, 2)
        return drawn


def grown(ratio: np.ndarray | float, power: float) -> np.ndarray:
    """Return (1 + ratio^p)^(1/p): 1 for a small, the ratio itself for a large one."""
    return (1 + np.power(ratio, power)) ** (1 / power)

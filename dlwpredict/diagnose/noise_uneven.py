"""Where noise is not the same everywhere: more on slopes, and offsets of whole rows or columns.

Offsets of a tenth of the noise of one point are still what the mean of a long row consists of, and noise that is twice
as strong on slopes is what stands out there; free forms, ripples and names then find structure where there is none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize, sparse, special

from dlwpredict.uneven import grown

LEVEL = 0.01
"""Probability that even noise is called uneven, each way of being so."""

OUTLYING = 4.0
"""Whitened values are clipped here, so that no spike passes for what it lies on."""

JITTERS = 0.05, 50.0
"""Jitter, in standard deviations of the noise on flat ground, that is looked for."""

OFFSETS_UM = 1e-5, 10.0
"""Standard deviation of offsets that is looked for, µm."""


@dataclass(frozen=True)
class Unevenness:
    """One way of being uneven.

    Parameters
    ----------
    size : float
        Where it is most likely.
    gain : float
        2 ln L there above that of even noise.
    """

    size: float
    gain: float

    @property
    def p_value(self) -> float:
        """Probability that even noise looks as uneven.

        Half the time it is most likely even; else the gain is χ² of one degree of freedom (Self & Liang, J. Am. Stat.
        Assoc. 82, 605, 1987).
        """
        return float(special.chdtrc(1, self.gain) / 2) if self.gain > 0 else 1.0

    @property
    def found(self) -> float:
        """The size where it is more than chance, else 0."""
        return self.size if self.p_value < LEVEL else 0.0


@dataclass(frozen=True, eq=False)
class Evened:
    """Values, and what may be in them, where their noise is made even.

    Parameters
    ----------
    values_um : numpy.ndarray, shape (points,)
    design : numpy.ndarray, shape (points, columns)
        What may be in the values besides noise.
    members : tuple of scipy.sparse.csr_array, shape (points, lines)
        Which points lie on which row, and on which column.
    steep : numpy.ndarray, shape (points,)
        |∇f|.
    growth, power : float
        k and p of s = (1 + (k·|∇f|)^p)^(1/p), how many times stronger the noise is than on flat ground: everything is
        divided by it.
    axes : tuple of int
        0 or 1: rows or columns beside whose means everything is looked at.
    """

    values_um: np.ndarray
    design: np.ndarray
    members: tuple[sparse.csr_array, sparse.csr_array]
    steep: np.ndarray
    growth: float = 0.0
    power: float = 2.0
    axes: tuple[int, ...] = ()

    @property
    def scale(self) -> np.ndarray:
        """How many times stronger the noise is than on flat ground, shape (points,)."""
        return grown(self.growth * self.steep, self.power)

    def of(self, values: np.ndarray) -> np.ndarray:
        """Return values (points, columns) made even."""
        return self.beside_lines(values / self.scale[:, None])

    def beside_lines(self, values: np.ndarray) -> np.ndarray:
        """Return values (points, columns), divided already, without what is constant along the uneven lines."""
        for axis in self.axes * len(self.axes):
            lines = self._lines(axis)
            sizes = np.maximum(lines.power(2).sum(axis=0), 1e-300)
            values = values - lines @ ((lines.T @ values) / np.reshape(sizes, (-1, 1)))
        return values

    def offsets(self, near: sparse.csr_array, axis: int) -> Unevenness:
        """Estimate the offsets of rows (axis 0) or columns (axis 1), µm, by restricted maximum likelihood.

        With whitened values w and lines A, both beside the design, and G = AᵀA = Σ g_i v_i v_iᵀ, c = VᵀAᵀw:
        2 ln L(σ) − 2 ln L(0) = Σ σ² c_i²/(1 + σ² g_i) − ln(1 + σ² g_i).

        Parameters
        ----------
        near : scipy.sparse.csr_array, shape (points, points)
            Whitens noise that is even.
        axis : int
        """
        others = replace(self, axes=tuple(other for other in self.axes if other != axis))
        white = np.clip(near @ others.of(self.values_um[:, None])[:, 0], -OUTLYING, OUTLYING)
        basis, _ = _orthonormal(near @ others.of(self.design))
        along = near @ self._lines(axis)
        shared = along.T @ basis
        energies, vectors = np.linalg.eigh((along.T @ along).toarray() - shared @ shared.T)
        known = energies > 1e-9 * energies[-1]
        squares = (vectors[:, known].T @ (along.T @ white - shared @ (basis.T @ white))) ** 2

        def gain(log_size: float) -> float:
            variance = np.exp(2 * log_size)
            grown = 1 + variance * energies[known]
            return float(np.sum(variance * squares / grown - np.log(grown)))

        return _likeliest(gain, OFFSETS_UM)

    def jitter(self, near: sparse.csr_array, power: float) -> Unevenness:
        """Estimate how noise grows on slopes, in standard deviations of the noise on flat ground.

        −2 ln L(k) = n ln Σ w_i² + 2 Σ ln s_i with w the whitened r/s of what the design leaves.

        Parameters
        ----------
        near : scipy.sparse.csr_array, shape (points, points)
            Whitens noise as it is on flat ground.
        power : float
            p.
        """
        if not self.steep.any():
            return Unevenness(0.0, 0.0)
        values, design = self.of(self.values_um[:, None])[:, 0], self.of(self.design)
        basis, turn = _orthonormal(near @ design)
        left = values - design @ (turn @ (basis.T @ (near @ values)))

        def deviance(size: float) -> float:
            scale = grown(size * self.steep, power)
            white = near @ (left / scale)
            most = OUTLYING * np.sqrt(np.mean(white**2))
            return float(len(white) * np.log(np.sum(np.clip(white, -most, most) ** 2)) + 2 * np.log(scale).sum())

        return _likeliest(lambda log_size: deviance(0.0) - deviance(np.exp(log_size)), JITTERS)

    def _lines(self, axis: int) -> sparse.csr_array:
        return sparse.csr_array(sparse.diags_array(1 / self.scale) @ self.members[axis])


def _orthonormal(columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return an orthonormal basis of columns, and the matrix that makes it of them."""
    energies, turn = np.linalg.eigh(columns.T @ columns)
    real = energies > 1e-10 * energies.max(initial=1e-300)
    turn = turn[:, real] / np.sqrt(energies[real])
    return columns @ turn, turn


def _likeliest(gain: Callable[[float], float], ends: tuple[float, float]) -> Unevenness:
    found = optimize.minimize_scalar(lambda log_size: -gain(log_size), bounds=np.log(ends), method="bounded")
    return Unevenness(float(np.exp(found.x)), gain(found.x))

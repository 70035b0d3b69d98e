"""Finding out in which ways the noise of a map is uneven, and what is left of its values where it is made even."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import linalg, optimize, sparse, special

from dlwpredict.noise.lines import LEVEL, OFFSET, TILT, Lines, likeliest
from dlwpredict.noise.unevenness import grown

Way = tuple[int, int]
"""One way of being uneven by lines: of rows (0) or of columns (1), and `OFFSET` or `TILT`."""

OUTLYING = 4.0
"""Whitened values are clipped here, so that no spike passes for what it lies on."""

CLIPPED, SETTLED = 30, 0.1
"""Values are clipped anew about what lines have at most so often, until that moves by less, in standard deviations."""

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
    members : mapping of Way to scipy.sparse.csr_array, shape (points, lines)
        What lies on which row, and on which column: 1, and the place from −1 to 1 along it.
    steep : numpy.ndarray, shape (points,)
        |∇f|.
    growth, power : float
        k and p of s = (1 + (k·|∇f|)^p)^(1/p), how many times stronger the noise is than on flat ground: everything is
        divided by it.
    ways : mapping of Way to float
        Offsets or tilts of rows or columns beside which everything is looked at; of each 1/σ², µm⁻², 0 for any size.
    lean : float
        Of the lines.
    near : scipy.sparse.csr_array, shape (points, points), or None
        Whitens the noise from which they are told.
    """

    values_um: np.ndarray
    design: np.ndarray
    members: Mapping[Way, sparse.csr_array]
    steep: np.ndarray
    growth: float = 0.0
    power: float = 2.0
    ways: Mapping[Way, float] = field(default_factory=dict)
    lean: float = 0.0
    near: sparse.csr_array | None = None

    @property
    def scale(self) -> np.ndarray:
        """How many times stronger the noise is than on flat ground, shape (points,)."""
        return grown(self.growth * self.steep, self.power)

    def of(self, values: np.ndarray) -> np.ndarray:
        """Return values (points, columns) made even."""
        if self.growth:
            values = values / self.scale[:, None]
        return self.beside_lines(values)

    def beside_lines(self, values: np.ndarray) -> np.ndarray:
        """Return values (points, columns), divided already, without what the uneven lines likely have of them.

        The best linear prediction of the lines A: v − A·(AᵀWA + 1/σ²)⁻¹·AᵀW·v, with W the inverse covariance of the
        rest. By their plain means, noise that is correlated over many lines would be taken for offsets, and look as if
        it were correlated over shorter distances; or offsets be left, and look as if it were over longer ones.
        """
        if not self.ways:
            return values
        lines, white, factor = self._told
        return values - lines @ linalg.cho_solve(factor, white.T @ (self.near @ values))

    @cached_property
    def _told(self) -> tuple[sparse.csr_array, sparse.csr_array, tuple[np.ndarray, bool]]:
        """The lines of all ways, whitened, and what their products are with what is known of their sizes."""
        parts = {way: self.lines(way) for way in self.ways}
        lines = sparse.csr_array(sparse.hstack(list(parts.values())))
        white = sparse.csr_array(self.near @ lines)
        products = (white.T @ white).toarray()
        known = np.concatenate([np.full(parts[way].shape[1], known) for way, known in self.ways.items()])
        open_ends = 1e-9 * products.diagonal().max(initial=1e-300)  # rows and columns share a constant
        return lines, white, linalg.cho_factor(products + np.diag(known + open_ends))

    def also(self, way: Way, size_um: float, near: sparse.csr_array) -> Evened:
        """Return values beside one more way of being uneven, of this standard deviation, told from the rest so."""
        return replace(self, ways={**self.ways, way: 1 / size_um**2}, near=near)

    def beside_all_of(self, ways: Iterable[Way], near: sparse.csr_array) -> Evened:
        """Return values beside all that lines may have in these ways, likely or not: what is left is no offset."""
        return replace(self, ways=dict.fromkeys(ways, 0.0), near=near)

    def resized(self, near: sparse.csr_array) -> Evened:
        """Return values beside the same ways, each as large as it seems beside all others from a better whitener."""
        sizes = {way: self._beside_others(way, near).seen(near).lines(way).size for way in self.ways}
        return replace(self, ways={way: 1 / size**2 for way, size in sizes.items()}, near=near)

    def _beside_others(self, way: Way, near: sparse.csr_array) -> Evened:
        return self.beside_all_of((known for known in self.ways if known != way), near)

    def lines(self, way: Way) -> sparse.csr_array:
        """Return an offset or a tilt of each row or column, made even, shape (points, lines)."""
        return sparse.csr_array(sparse.diags_array(1 / self.scale) @ self.members[way])

    def seen(self, near: sparse.csr_array) -> Seen:
        """Return what is left to see where the noise is whitened by a matrix (points, points)."""
        values, design = self.of(self.values_um[:, None])[:, 0], self.of(self.design)
        basis, turn = orthonormal(near @ design)
        return Seen(self, near, values - design @ (turn @ (basis.T @ (near @ values))), basis)

    def line_noise(self, near: sparse.csr_array, axis: int) -> tuple[Lines, Unevenness]:
        """Estimate the offsets and tilts of rows or columns, and how sure they are, beside all other ways."""
        offsets = self._beside_others((axis, OFFSET), near).seen(near)
        independent = offsets.lines((axis, OFFSET))
        if not independent.found:
            return Lines(), independent
        process = likeliest(*offsets.products((axis, OFFSET)), independent.found, self.lean)
        if (axis, TILT) in self.ways:
            tilts = self._beside_others((axis, TILT), near).seen(near).lines((axis, TILT))
            process = replace(process, tilt_um=tilts.found)
        return process, independent


@dataclass(frozen=True, eq=False)
class Seen:
    """Values made even and whitened, beside what else may be in them.

    Parameters
    ----------
    even : Evened
    near : scipy.sparse.csr_array, shape (points, points)
        Whitens noise that is even.
    left : numpy.ndarray, shape (points,)
        Values made even, without what the design takes of them.
    basis : numpy.ndarray, shape (points, rank)
        Orthonormal basis of the whitened design.
    """

    even: Evened
    near: sparse.csr_array
    left: np.ndarray
    basis: np.ndarray

    def lines(self, way: Way) -> Unevenness:
        """Estimate offsets or tilts of rows or columns, independent of one another, by restricted maximum likelihood.

        With whitened values w and lines A, both beside the design, and G = AᵀA = Σ g_i v_i v_iᵀ, c = VᵀAᵀw:
        2 ln L(σ) − 2 ln L(0) = Σ σ² c_i²/(1 + σ² g_i) − ln(1 + σ² g_i).
        """
        matrix, along = self.products(way)
        energies, vectors = np.linalg.eigh(matrix)
        known = energies > 1e-9 * energies[-1]
        squares = (vectors[:, known].T @ along) ** 2

        def gain(log_size: float) -> float:
            variance = np.exp(2 * log_size)
            grown = 1 + variance * energies[known]
            return float(np.sum(variance * squares / grown - np.log(grown)))

        return _likeliest(gain, OFFSETS_UM)

    def products(self, way: Way) -> tuple[np.ndarray, np.ndarray]:
        """Return AᵀA (lines, lines) and Aᵀw (lines,) of whitened lines and values, beside the design.

        Values are clipped about what the lines have of them: Huber's modified residuals (Robust Statistics, 1981, 7.8).
        About nothing, offsets of ten times the noise would be clipped to half of what they are.
        """
        along, white = self.near @ self.even.lines(way), self.near @ self.left
        shared, taken = along.T @ self.basis, np.zeros(len(white))
        whole = (along.T @ along).toarray()
        matrix = whole - shared @ shared.T
        open_ends = 1e-9 * whole.diagonal().max(initial=1e-300)  # the design may hold lines whole
        factor = linalg.cho_factor(matrix + open_ends * np.eye(len(matrix)))
        for _ in range(CLIPPED):
            clipped = taken + np.clip(white - taken, -OUTLYING, OUTLYING)
            right = along.T @ clipped - shared @ (self.basis.T @ clipped)
            offsets, before = linalg.cho_solve(factor, right), taken
            taken = along @ offsets - self.basis @ (shared.T @ offsets)
            if np.abs(taken - before).max() < SETTLED:
                break
        return matrix, right

    def jitter(self, power: float) -> Unevenness:
        """Estimate how noise grows on slopes, in standard deviations of the noise on flat ground.

        −2 ln L(k) = n ln Σ w_i² + 2 Σ ln s_i with w the whitened r/s of what the design leaves.

        Parameters
        ----------
        power : float
            p.
        """
        steep = self.even.steep
        if not steep.any():
            return Unevenness(0.0, 0.0)

        def deviance(size: float) -> float:
            scale = grown(size * steep, power)
            white = self.near @ (self.left / scale)
            most = OUTLYING * np.sqrt(np.mean(white**2))
            return float(len(white) * np.log(np.sum(np.clip(white, -most, most) ** 2)) + 2 * np.log(scale).sum())

        even = deviance(0.0)
        return _likeliest(lambda log_size: even - deviance(np.exp(log_size)), JITTERS)


def orthonormal(columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return an orthonormal basis of columns, and the matrix that makes it of them."""
    energies, turn = np.linalg.eigh(columns.T @ columns)
    real = energies > 1e-10 * energies.max(initial=1e-300)
    turn = turn[:, real] / np.sqrt(energies[real])
    return columns @ turn, turn


def _likeliest(gain: Callable[[float], float], ends: tuple[float, float]) -> Unevenness:
    minimum = optimize.minimize_scalar(lambda log_size: -gain(log_size), bounds=np.log(ends), method="bounded")
    return Unevenness(float(np.exp(minimum.x)), gain(minimum.x))

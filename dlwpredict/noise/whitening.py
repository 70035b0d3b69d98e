"""Whitening of correlated noise on maps with holes: conditional on a few neighbours (Vecchia 1988).

Pixels are taken in raster order. Given its measured predecessors n in a fixed neighbourhood, the noise at a point i has
mean b·ε_n with b = C_nn⁻¹ c_in and variance v = C_ii − c_in·b. The rows (ε_i − b·ε_n)/√v are nearly independent with
variance 1. They form a sparse matrix W with WᵀW ≈ C⁻¹ on the measured points alone: nothing is filled in, and no border
is wrapped round.

Where noise is stronger on slopes, values are divided by how much so before. Offsets and tilts R·u of whole rows and
columns reach too far for neighbours. They are added in closed form: with A = W·R and u of covariance L·Lᵀ,
(I + A·L·Lᵀ·Aᵀ)^(−1/2)·W whitens C + R·L·Lᵀ·Rᵀ, and the symmetric root differs from I on the few columns of A alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import spsolve_triangular

from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.lines import (
    OFFSET,
    TILT,
    Lines,  # noqa: F401  (the doctest's)
    on_lines,
)
from dlwpredict.noise.unevenness import Uneven

NEAR_PX, FAR_PX = 3, (5, 8, 13, 21)
"""Neighbours are all predecessors up to the first distance (rows and columns), and some at the further ones: at most 64
in all, since a set of them is told by the bits of a number."""

_CHUNK = 4000
"""Sets of neighbours that are solved for at once, to bound memory."""


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """The measured predecessors of measured points of a map.

    Parameters
    ----------
    lags_um : numpy.ndarray, shape (neighbours, 2)
        Where the neighbours lie, (y, x), in raster order.
    index : numpy.ndarray of int, shape (points, neighbours)
        Number of each neighbour among all measured points, in raster order.
    present : numpy.ndarray of bool, shape (points, neighbours)
        Whether it is measured.
    own : numpy.ndarray of int, shape (points,)
        Numbers of the points themselves.
    stride : int
        Pixels from a point to the next that counts: the map is as many squared lattices, each for itself.
    """

    lags_um: np.ndarray
    index: np.ndarray
    present: np.ndarray
    own: np.ndarray
    stride: int = 1

    @classmethod
    def of(
        cls,
        used: np.ndarray,
        dx_um: float,
        dy_um: float,
        near_px: int = NEAR_PX,
        far_px: tuple[int, ...] = FAR_PX,
        stride: int = 1,
    ) -> Neighbourhood:
        """Look for the neighbours of all measured points.

        Parameters
        ----------
        used : numpy.ndarray of bool, shape (rows, cols)
            Measured points.
        dx_um, dy_um : float
            Pitch.
        near_px : int
        far_px : tuple of int
            Extent of the neighbourhood, in strides.
        stride : int
            Pixels from a point to the next that counts.
        """
        offsets = stride * _offsets(near_px, far_px)
        reach = int(np.abs(offsets).max())
        number: np.ndarray = np.full(np.add(used.shape, 2 * reach), -1, dtype=np.int32)
        inner = number[reach:-reach, reach:-reach]
        inner[used] = np.arange(int(used.sum()))
        place = (np.flatnonzero(number >= 0)[:, None]) + offsets @ (number.shape[1], 1)
        index = number.ravel()[place]
        lags_um, own = offsets * np.array([dy_um, dx_um]), np.arange(len(index), dtype=np.int32)
        return cls(lags_um, index, index >= 0, own, stride)

    def __getitem__(self, points: np.ndarray) -> Neighbourhood:
        """Return the neighbourhoods of some of the points."""
        return Neighbourhood(self.lags_um, self.index[points], self.present[points], self.own[points], self.stride)

    @cached_property
    def patterns(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Every set of present neighbours once, (patterns, neighbours) of bool; which a point has; points of each."""
        bits = np.uint64(1) << np.arange(self.present.shape[1], dtype=np.uint64)
        code = np.bitwise_or.reduce(self.present * bits, axis=1)
        known, place, points = np.unique(code, return_inverse=True, return_counts=True)
        return (known[:, None] & bits) > 0, place, points

    @cached_property
    def distances_um(self) -> tuple[np.ndarray, np.ndarray]:
        """Distances of the neighbours from one another, and from the point itself."""
        between = np.linalg.norm(self.lags_um[:, None] - self.lags_um, axis=-1)
        return between, np.linalg.norm(self.lags_um, axis=-1)

    def rows(self, noise: Noise) -> tuple[np.ndarray, np.ndarray]:
        """Return the coefficients b (points, neighbours) and the variances v (points,)."""
        place = self.patterns[1]
        coefficients, variances = self.of_patterns([noise])
        return coefficients[0, place], variances[0, place]

    def of_patterns(self, noises: Sequence[Noise]) -> tuple[np.ndarray, np.ndarray]:
        """Return coefficients (noises, patterns, neighbours) and variances (noises, patterns) of sets of neighbours.

        Those of a set are C_ss⁻¹·c_s; where few neighbours m are missing, with K = C_nn⁻¹ of all of them and b = K·c,
        b − K_m·K_mm⁻¹·b_m, a smaller system.
        """
        between, away = self.distances_um
        covariance = np.stack([noise.at(between) for noise in noises])
        towards = np.stack([noise.at(away) for noise in noises])
        inverse = np.linalg.inv(covariance)
        all_known = (inverse @ towards[..., None])[..., 0]
        present = self.patterns[0]
        few = present.sum(axis=1) < present.shape[1] / 2
        coefficients = np.zeros((len(noises), *present.shape))
        coefficients[:, few] = _solved(covariance, towards, present[few])
        without = _solved(inverse, all_known, ~present[~few])
        coefficients[:, ~few] = np.where(present[~few], all_known[:, None] - without @ inverse, 0.0)
        marginal = np.array([noise.sigma_um**2 for noise in noises])
        return coefficients, marginal[:, None] - (coefficients @ towards[..., None])[..., 0]

    def whitener(self, noise: Noise) -> sparse.csr_array:
        """Return W (points, points) for all measured points: W·ε has nearly independent entries of variance 1."""
        (coefficients,), (variances,) = self.of_patterns([noise])
        place = self.patterns[1]
        entries = np.column_stack([-coefficients, np.ones(len(variances))]) / np.sqrt(variances)[:, None]
        filled = np.column_stack([self.present, np.ones(len(place), dtype=bool)])
        ends = np.concatenate([[0], np.cumsum(filled.sum(axis=1))]).astype(np.int32)
        columns = np.column_stack([self.index, self.own])[filled]
        return sparse.csr_array((entries[place][filled], columns, ends), shape=(len(place), len(place)))


@dataclass(frozen=True, eq=False)
class Whitener:
    """What turns values at the measured points of a map into independent ones of variance 1.

    Parameters
    ----------
    near : scipy.sparse.csr_array, shape (points, points)
        W, of the noise without offsets of lines.
    offsets : scipy.sparse.csr_array, shape (points, lines)
        A = W·R, the whitened offsets and tilts of rows and columns.
    shrink, grow : numpy.ndarray, shape (lines, lines)
        (I + A·L·Lᵀ·Aᵀ)^(−1/2) = I − A·shrink·Aᵀ, and its inverse I + A·grow·Aᵀ.

    Examples
    --------
    >>> noise = Uneven(Noise(1.0, 0.0, 1.0, 1.0, 1.0), rows=Lines(white_um=2.0))
    >>> whitener = Whitener.of(np.ones((3, 4), dtype=bool), noise)
    >>> round(float(np.linalg.norm(whitener @ np.ones(12))), 6)  # √12 / √(1 + 4·2²)
    0.840168
    """

    near: sparse.csr_array
    offsets: sparse.csr_array
    shrink: np.ndarray
    grow: np.ndarray

    @classmethod
    def of(cls, used: np.ndarray, noise: Uneven, slope: np.ndarray | float = 0.0) -> Whitener:
        """Build the whitener of a noise on the measured points of a map (rows, cols) of this slope."""
        near = Neighbourhood.of(used, noise.even.dx_um, noise.even.dy_um).whitener(noise.even)
        if noise.jitter_um:
            scale = np.broadcast_to(noise.scale(slope), used.shape)[used]
            near.data /= scale[near.indices]
        parts, roots = [], []
        for axis, process in enumerate((noise.rows, noise.columns)):
            for order, size in ((OFFSET, process.offset_um), (TILT, process.tilt_um)):
                if size > 0:
                    parts.append(on_lines(used, axis, order, process.lean))
                    count = parts[-1].shape[1]
                    roots.append(process.root(count) if order == OFFSET else size * np.eye(count))
        if not parts:
            return cls(near, sparse.csr_array((near.shape[0], 1)), np.zeros((1, 1)), np.zeros((1, 1)))
        offsets, root = sparse.csr_array(near @ sparse.hstack(parts)), linalg.block_diag(*roots)
        energies, turn = np.linalg.eigh(root.T @ (offsets.T @ offsets) @ root)
        real = energies > 1e-12 * energies[-1]
        energies, turn = energies[real], root @ turn[:, real]
        grown = np.sqrt(1 + energies)
        shrink, grow = ((turn * (change / energies)) @ turn.T for change in (1 - 1 / grown, grown - 1))
        return cls(near, offsets, shrink, grow)

    def __matmul__(self, values: np.ndarray) -> np.ndarray:
        """Whiten values (points, ...)."""
        white = self.near @ values
        return white - self._along(white, self.shrink)

    def transposed(self, white: np.ndarray) -> np.ndarray:
        """Return the transpose × values (points, ...)."""
        return self.near.T @ (white - self._along(white, self.shrink))

    def solve(self, white: np.ndarray) -> np.ndarray:
        """Return the values (points, ...) that become these."""
        return spsolve_triangular(self.near, white + self._along(white, self.grow), lower=True)

    def _along(self, white: np.ndarray, inner: np.ndarray) -> np.ndarray | float:
        return self.offsets @ (inner @ (self.offsets.T @ white)) if inner.any() else 0.0


def _solved(matrices: np.ndarray, right: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Solve the part of M·x = b that some rows and columns leave, for every set of them (sets, rows) of bool.

    Shape (matrices, sets, rows), 0 elsewhere.
    """
    solved = np.zeros((len(matrices), *chosen.shape))
    counts = chosen.sum(axis=1)
    most = max(_CHUNK // len(matrices), 1)
    for count in np.unique(counts[counts > 0]):
        alike = np.flatnonzero(counts == count)
        for some in np.split(alike, range(most, len(alike), most)):
            rows = np.nonzero(chosen[some])[1].reshape(len(some), count)
            parts = np.linalg.solve(matrices[:, rows[:, :, None], rows[:, None, :]], right[:, rows, None])
            solved[:, some[:, None], rows] = parts[..., 0]
    return solved


def _offsets(near_px: int, far_px: tuple[int, ...]) -> np.ndarray:
    """Return the neighbourhood as offsets (row, col) of predecessors in raster order, shape (neighbours, 2)."""
    near = range(-near_px, near_px + 1)
    chosen = [(r, c) for r in near for c in near]
    chosen += [(r, c) for d in far_px for r, c in ((0, -d), (-d, 0), (-d, -d), (-d, d), (-d // 2, -d), (-d // 2, d))]
    return np.array(sorted((r, c) for r, c in chosen if r < 0 or (r == 0 and c < 0)))

"""The restricted likelihood of noise models: of points given their neighbours, many models at once.

Where most points have the same neighbours, a model costs little more than one product of the whitened design with
itself. "Restricted" counts what the design has taken from the noise too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse, special

from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.evened import Evened, orthonormal
from dlwpredict.noise.whitening import Neighbourhood

SHARES_WITHIN = (-5.0, 7.0)
"""Of the logit of the share: beyond, one part is less than a hundredth of the variance, and hardly matters."""

ROUNDING = 1e-6
"""Of products with seven digits of columns of unit size."""

_NOTHING = 1e-12
_BLOCK, _MODELS = 512, 32
"""Points and models at a time, to bound memory: a block fits the cache."""


@dataclass(frozen=True, eq=False)
class Likelihood:
    """The restricted likelihood of chosen points given their neighbours.

    Parameters
    ----------
    chosen : Neighbourhood
        Of the points whose conditional density enters.
    table : numpy.ndarray of float32, shape (points, maps + columns)
        One map or several, each with a likelihood of its own, and what may be in them besides noise. The columns are
        orthonormal where a model near the likely ones has whitened them, so that seven digits are enough.
    maps : int
    """

    chosen: Neighbourhood
    table: np.ndarray
    maps: int

    @classmethod
    def of(cls, even: Evened, chosen: Neighbourhood, near: Noise) -> Likelihood:
        """Return the likelihood of values that have been made even; a model near the likely ones is known."""
        values, design = even.of(even.values_um[:, None]), even.of(even.design)
        coefficients, variances = chosen.rows(near)
        index, size = chosen.index, len(chosen.own)
        ends = np.arange(size + 1) * index.shape[1]
        matrix = sparse.csr_array((coefficients.ravel(), index.ravel() % len(values), ends), shape=(size, len(values)))
        root = np.sqrt(variances)[:, None]
        white = [(part[chosen.own] - matrix @ part) / root for part in (values, design)]
        basis, turn = orthonormal(white[1])
        values = values - design @ (turn @ (basis.T @ white[0]))
        return cls(chosen, np.column_stack([values, design @ turn]).astype(np.float32), 1)

    def beside(self, maps: np.ndarray) -> Likelihood:
        """Return the likelihood of further maps (points, maps) too."""
        return replace(
            self,
            table=np.column_stack([self.table[:, : self.maps], maps.astype(np.float32), self.table[:, self.maps :]]),
            maps=self.maps + maps.shape[1],
        )

    @property
    def points(self) -> float:
        """How many points it is the likelihood of: all, or those of one lattice where neighbours lie on lattices.

        What lattices have of a smooth column they share: four say no more of it than one.
        """
        return len(self.table) / self.chosen.stride**2

    @property
    def share(self) -> float:
        """Those over the ones looked at."""
        return self.points / len(self.chosen.own)

    def bounds(self, pitch_um: float) -> np.ndarray:
        """Return least and largest place, (2, 2): longer than a sixth of the map, no length can be told."""
        ends = np.log(pitch_um * np.array([0.5, np.sqrt(len(self.table)) / 6]))
        return np.column_stack([SHARES_WITHIN, ends])

    def profiled(self, trials: Sequence[tuple[Noise, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
        """Return −2 ln L at the best multiple of each model, and the logarithm of that multiple, (models, maps).

        Up to a constant, with a weak prior. All terms are scaled from the chosen points to `points`: the design is one
        and is not scaled.

        Parameters
        ----------
        trials : sequence of (Noise, place)
            Templates, and logit of the share and log length.
        """
        chunks = [self._some_profiled(trials[k : k + _MODELS]) for k in range(0, len(trials), _MODELS)]
        deviances, scales = (np.concatenate(parts) for parts in zip(*chunks, strict=True))
        return deviances + _weak_prior(trials)[:, None], scales

    def _some_profiled(self, trials: Sequence[tuple[Noise, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
        models = [model_at(model, np.array([*place, 0.0])) for model, place in trials]
        coefficients, variances = self.chosen.of_patterns(models)
        products = self._products(coefficients, variances)
        m, looked_at = self.maps, len(self.chosen.own)
        rank = products.shape[1] - m
        sizes = np.sqrt(np.maximum(np.diagonal(products, axis1=1, axis2=2), _NOTHING))
        products /= sizes[:, :, None] * sizes[:, None, :]  # else rounding of the largest would swamp the smallest
        root = np.linalg.cholesky(products[:, m:, m:] + ROUNDING * np.eye(rank))
        along = np.linalg.solve(root, products[:, m:, :m])
        left = np.maximum(1 - np.sum(along**2, axis=1), _NOTHING)  # a map may be nothing but what the design holds
        squares = sizes[:, :m] ** 2 * left / looked_at / (1 - rank / min(looked_at, self.points))
        logs = self.share * np.log(variances) @ self.chosen.patterns[2]
        logs += 2 * np.log(np.diagonal(root, axis1=1, axis2=2) * sizes[:, m:]).sum(axis=1)
        return logs[:, None] + (self.points - rank) * np.log(squares), np.log(squares) / 2

    def _products(self, coefficients: np.ndarray, variances: np.ndarray) -> np.ndarray:
        """Return the whitened table's products with itself, (models, columns, columns), of `of_patterns`."""
        rows = np.concatenate([np.ones((*variances.shape, 1)), -coefficients], axis=2) / np.sqrt(variances)[..., None]
        rows = np.ascontiguousarray(rows.swapaxes(0, 1), dtype=np.float32)
        place = self.chosen.patterns[1]
        index = np.column_stack([self.chosen.own, self.chosen.index])
        width = self.table.shape[1]
        products = np.zeros((len(variances), width, width))
        for first in range(0, len(index), _BLOCK):
            block = slice(first, first + _BLOCK)
            white = rows[place[block]] @ self.table[index[block]]
            products += white.transpose(1, 2, 0) @ white.transpose(1, 0, 2)
        return products


def _weak_prior(trials: Sequence[tuple[Noise, np.ndarray]]) -> np.ndarray:
    """Return a penalty that settles what the data leave open: where nothing is correlated, the length is free."""
    lengths = np.array([place[1] - np.log(3 * model.pitch_um) for model, place in trials])
    return (np.array([place[0] for _, place in trials]) / 5) ** 2 + (lengths / 2) ** 2


def model_at(like: Noise, place: np.ndarray) -> Noise:
    """Return the model of (logit of the correlated share of the variance, log length, log scale)."""
    share, scale = special.expit(place[0]), np.exp(place[2])
    white, correlated = float(scale * np.sqrt(1 - share)), float(scale * np.sqrt(share))
    return replace(like, white_um=white, correlated_um=correlated, length_um=float(np.exp(place[1])))

"""The nameless competitor: how much of a residual free forms explain, and how surely that is more than noise.

This is the test that needs no library, the judge of every name, and the source of the places.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from dlwpredict.diagnose.evidence import prior_rows, unwhitened
from dlwpredict.diagnose.fit import Fit
from dlwpredict.diagnose.freeform import free_forms
from dlwpredict.diagnose.screen import Null

LEVEL = 0.025
"""Probability that noise alone is called structure; the naming of effects takes as much again."""

SINGLE = LEVEL / 4
"""The same for each of the four ways of looking for it: free forms, a ripple, a spot, columns."""

SMALLEST = 1e-3
"""Directions shorter than this share of their columns' length are dropped: what the fit explains anyway."""


@dataclass(frozen=True)
class Energy:
    """Energy of a residual along some free forms, in units of the noise.

    Parameters
    ----------
    excess : float
        χ² above what noise alone has there on average.
    p_value : float
        Probability that noise alone has as much.
    """

    excess: float
    p_value: float


@dataclass(frozen=True, eq=False)
class Forms:
    """Whitened free forms of every recording.

    Parameters
    ----------
    families : tuple of dict
        For each recording, family to columns, shape (points, columns).
    """

    families: tuple[dict[str, np.ndarray], ...]

    @classmethod
    def of(cls, fitted: Fit) -> Forms:
        """Whiten the free forms about a fit."""
        found = []
        for item, trace in zip(fitted.data, fitted.point.traces, strict=True):
            forms = free_forms(item.recording.target, trace.heights_um)
            found.append({family: item.white(columns) for family, columns in forms.items()})
        return cls(tuple(found))

    @property
    def every(self) -> list[tuple[int, str]]:
        """All (recording, family)."""
        return [(k, family) for k, families in enumerate(self.families) for family in families]

    @property
    def columns(self) -> np.ndarray:
        """All columns as rows of all recordings, priors included, in the order of `every`."""
        first = np.cumsum([0, *map(_points, self.families)])
        columns = np.zeros((first[-1] + prior_rows(len(self.families)), sum(map(len, self.places.values()))))
        for (k, family), own in self.places.items():
            columns[first[k] : first[k + 1], own] = self.families[k][family]
        return columns

    @property
    def places(self) -> dict[tuple[int, str], np.ndarray]:
        """Which of the columns belong to each (recording, family)."""
        ends = np.cumsum([0, *(self.families[k][family].shape[1] for k, family in self.every)])
        return {key: np.arange(a, b) for key, a, b in zip(self.every, ends, ends[1:], strict=False)}


def _points(families: dict[str, np.ndarray]) -> int:
    return len(next(iter(families.values())))


@dataclass(frozen=True, eq=False)
class Beside:
    """Columns beside what a fit itself may move, with all scalar products that tests on parts of them need.

    Parameters
    ----------
    columns : numpy.ndarray, shape (rows, columns)
        Of length 1 before the fit's own directions were taken out.
    products : numpy.ndarray, shape (columns, columns)
    residual : numpy.ndarray, shape (columns,)
        With the fit's residual.
    draws : numpy.ndarray, shape (columns, draws)
        With the null's draws.
    """

    columns: np.ndarray
    products: np.ndarray
    residual: np.ndarray
    draws: np.ndarray

    @classmethod
    def of(cls, fitted: Fit, columns: np.ndarray, null: Null) -> Beside:
        """Take out of columns what a fit may move."""
        left = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
        own = fitted.basis
        for _ in range(2):
            left -= own @ (own.T @ left)
        return cls(left, left.T @ left, left.T @ fitted.residual, null.along(left))

    def energy(self, chosen: np.ndarray | slice = slice(None)) -> Energy:
        """Return the energy of the residual along some of the columns.

        Noise alone has there a χ² whose mean and variance are those of the null's draws (Satterthwaite), noise models
        that differ from draw to draw included.
        """
        turn = self._directions(chosen)
        if not turn.shape[1]:
            return Energy(0.0, 1.0)
        found = float(np.sum((turn.T @ self.residual[chosen]) ** 2))
        nulls = np.sum((turn.T @ self.draws[chosen]) ** 2, axis=0)
        mean, variance = float(nulls.mean()), float(nulls.var(ddof=1))
        return Energy(found - mean, float(special.chdtrc(2 * mean**2 / variance, max(found * 2 * mean / variance, 0))))

    def _directions(self, chosen: np.ndarray | slice) -> np.ndarray:
        """Return the matrix that makes an orthonormal basis of some columns, shape (columns, directions)."""
        values, vectors = np.linalg.eigh(self.products[chosen][:, chosen])
        real = values > SMALLEST * max(values[-1], SMALLEST)
        return vectors[:, real] / np.sqrt(values[real])

    def structure_um(self, fitted: Fit) -> float:
        """Return the root mean square of what the columns explain of the residual, less what noise has there, µm."""
        turn = self._directions(slice(None))
        along = turn.T @ self.residual
        found = self.columns @ (turn @ along)
        parts = unwhitened(fitted.data, found)
        square, points = sum(float(part @ part) for part in parts), sum(len(part) for part in parts)
        share = 1 - len(along) / max(float(along @ along), len(along), 1.0)
        return float(np.sqrt(share * square / points))


def agreement(fitted: Fit, null: Null) -> Energy | None:
    """Test whether every recording alone would give the same parameters; None with a single recording.

    To first order: the energy that parameters free per recording explain beyond the shared ones.
    """
    if len(fitted.data) < 2:
        return None
    blocks, first = [], 0
    for item in fitted.data:
        own = np.zeros_like(fitted.jacobian)
        last = first + item.recording.points
        own[first:last] = fitted.jacobian[first:last]
        blocks.append(own)
        first = last
    return Beside.of(fitted, np.concatenate(blocks, axis=1), null).energy()

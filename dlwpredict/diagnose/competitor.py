"""The nameless competitor: how much of a residual free forms explain, and how surely that is more than noise.

This is the test that needs no library, the judge of every name, and the source of the places.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.sparse.linalg import spsolve_triangular

from dlwpredict.diagnose.evidence import prior_rows, stack
from dlwpredict.diagnose.fit import Fit
from dlwpredict.diagnose.freeform import free_forms
from dlwpredict.diagnose.screen import Null

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

    def columns(self, chosen: Sequence[tuple[int, str]]) -> np.ndarray:
        """Return the columns of some families as rows of all recordings, priors included."""
        below = prior_rows(len(self.families))
        blocks = []
        for k, family in chosen:
            own = self.families[k][family]
            parts = [own if j == k else np.zeros((_points(f), own.shape[1])) for j, f in enumerate(self.families)]
            blocks.append(stack(parts, below))
        return np.concatenate(blocks, axis=1)

    @property
    def every(self) -> list[tuple[int, str]]:
        """All (recording, family)."""
        return [(k, family) for k, families in enumerate(self.families) for family in families]


def _points(families: dict[str, np.ndarray]) -> int:
    return len(next(iter(families.values())))


def energy(fitted: Fit, columns: np.ndarray, null: Null) -> Energy:
    """Return the energy of a fit's residual along columns, beside what the fit itself may move.

    Noise alone has there a χ² whose mean and variance are those of the null's draws (Satterthwaite), noise models
    that differ from draw to draw included.
    """
    basis = _directions(fitted, columns)
    if not basis.shape[1]:
        return Energy(0.0, 1.0)
    found = float(np.sum((basis.T @ fitted.residual) ** 2))
    nulls = np.sum(null.along(basis) ** 2, axis=0)
    mean, variance = float(nulls.mean()), float(nulls.var(ddof=1))
    return Energy(found - mean, float(stats.chi2.sf(found * 2 * mean / variance, 2 * mean**2 / variance)))


def structure_um(fitted: Fit, columns: np.ndarray) -> float:
    """Return the root mean square of what columns explain of a residual, less what noise has there, µm."""
    basis = _directions(fitted, columns)
    found = basis @ (basis.T @ fitted.residual)
    square, points, first = 0.0, 0, 0
    for item in fitted.data:
        rows = slice(first, first + item.recording.points)
        square += float(np.sum(spsolve_triangular(item.matrix, found[rows], lower=True) ** 2))
        points, first = points + item.recording.points, rows.stop
    share = 1 - basis.shape[1] / max(float(found @ found), basis.shape[1])
    return float(np.sqrt(max(share, 0) * square / points))


def _directions(fitted: Fit, columns: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of the columns beside the fit's own, shape (rows, directions)."""
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
    own = fitted.basis
    left = scaled - own @ (own.T @ scaled)
    left -= own @ (own.T @ left)
    values, vectors = np.linalg.eigh(left.T @ left)
    real = values > SMALLEST * max(values[-1], SMALLEST)
    return left @ (vectors[:, real] / np.sqrt(values[real]))


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
    return energy(fitted, np.concatenate(blocks, axis=1), null)

"""The nameless competitor: how much of a residual free forms explain, and how surely that is more than noise.

This is the test that needs no library, the judge of every name, and the source of the places.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from dlwpredict.diagnosis.structure.freeform import free_forms
from dlwpredict.infer.held_out import parts_of
from dlwpredict.infer.objective import Fit

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
        families = []
        for item, trace in zip(fitted.data, fitted.traces, strict=True):
            forms = free_forms(item.recording.target, trace.heights_um)
            white = {family: item.white(columns) for family, columns in forms.items()}
            families.append({f: c / np.maximum(np.linalg.norm(c, axis=0), 1e-12) for f, c in white.items()})
        return cls(tuple(families))

    @property
    def every(self) -> list[tuple[int, str]]:
        """All (recording, family)."""
        return [(k, family) for k, families in enumerate(self.families) for family in families]

    @property
    def places(self) -> dict[tuple[int, str], np.ndarray]:
        """Which of all columns belong to each (recording, family)."""
        ends = np.cumsum([0, *(self.families[k][family].shape[1] for k, family in self.every)])
        return {key: np.arange(a, b) for key, a, b in zip(self.every, ends, ends[1:], strict=False)}

    @property
    def blocks(self) -> list[np.ndarray]:
        """Columns of every recording, shape (points, columns)."""
        return [np.column_stack(list(families.values())) for families in self.families]


@dataclass(frozen=True, eq=False)
class Beside:
    """Columns of each recording beside what a fit may move, by the scalar products that tests on parts of them need.

    Parameters
    ----------
    fitted : Fit
    blocks : list of numpy.ndarray, shape (points, columns)
        Columns of every recording, as they are.
    products : numpy.ndarray, shape (columns, columns)
        Beside the fit, all recordings' columns one after the other.
    residual : numpy.ndarray, shape (columns,)
        With the fit's residual.
    draws : numpy.ndarray, shape (columns, draws)
        With the null's draws.
    """

    fitted: Fit
    blocks: list[np.ndarray]
    products: np.ndarray
    residual: np.ndarray
    draws: np.ndarray

    @classmethod
    def of(cls, fitted: Fit, blocks: list[np.ndarray], draws: np.ndarray) -> Beside:
        """Take out of columns what a fit may move: its nuisances, recording by recording, and its tangents.

        Parameters
        ----------
        fitted : Fit
        blocks : list of numpy.ndarray, shape (points, columns)
        draws : numpy.ndarray, shape (rows, draws)
            Of noise, beside the fit.
        """
        rows, tangents = fitted.rows, fitted.tangents
        squares = [x.T @ x - (a := n.T @ x).T @ a for x, n in zip(blocks, fitted.nuisances.above, strict=True)]
        along = [tangents[rows.of(k)].T @ x for k, x in enumerate(blocks)]
        ends = np.cumsum([0, *(x.shape[1] for x in blocks)])
        crossed = np.concatenate(along, axis=1)
        products = -crossed.T @ crossed
        for square, a, b in zip(squares, ends, ends[1:], strict=False):
            products[a:b, a:b] += square
        parts = [(x.T @ fitted.residual[rows.of(k)], x.T.astype(np.float32) @ draws[rows.of(k)])
                 for k, x in enumerate(blocks)]  # fmt: skip
        residual, noise = zip(*parts, strict=True)
        return cls(fitted, blocks, products, np.concatenate(residual), np.concatenate(noise))

    def energy(self, chosen: np.ndarray | slice = slice(None)) -> Energy:
        """Return the energy of the residual along some of the columns.

        Noise alone has there a χ² whose mean and variance are those of the null's draws (Satterthwaite), noise models
        that differ from draw to draw included.
        """
        turn = _directions(self.products[chosen][:, chosen])
        if not turn.shape[1]:
            return Energy(0.0, 1.0)
        energy = float(np.sum((turn.T @ self.residual[chosen]) ** 2))
        nulls = np.sum((turn.T @ self.draws[chosen]) ** 2, axis=0)
        mean, variance = float(nulls.mean()), float(nulls.var(ddof=1))
        p_value = float(special.chdtrc(2 * mean**2 / variance, max(energy * 2 * mean / variance, 0)))
        return Energy(energy - mean, p_value)

    def structure_um(self, noise: np.ndarray) -> float:
        """Return the root mean square of what the columns explain of the residual, less what noise has there, µm.

        By least squares in µm, so that no more can be explained than there is: by generalised ones, structure that is
        shorter than the columns is carried on to longer one, to which correlated noise lends little weight.

        Parameters
        ----------
        noise : numpy.ndarray, shape (rows, draws)
            Beside the fit.
        """
        rows, squares = self.fitted.rows, np.zeros(1 + noise.shape[1])
        for k, (item, columns) in enumerate(zip(self.fitted.data, self.blocks, strict=True)):
            forms = item.whitener.solve(columns)
            forms /= np.maximum(np.linalg.norm(forms, axis=0), 1e-12)
            both = np.column_stack([self.fitted.residual[rows.of(k)], noise[rows.of(k)]])
            along = forms.T @ item.whitener.solve(both)
            squares += np.sum((_directions(forms.T @ forms).T @ along) ** 2, axis=0)
        return float(np.sqrt(max(squares[0] - squares[1:].mean(), 0.0) / rows.data))


def _directions(products: np.ndarray) -> np.ndarray:
    """Return what makes an orthonormal basis of columns with these scalar products, shape (columns, directions)."""
    values, vectors = np.linalg.eigh(products)
    real = values > SMALLEST * values.max(initial=SMALLEST)
    return vectors[:, real] / np.sqrt(values[real])


def agreement(fitted: Fit, draws: np.ndarray) -> Energy | None:
    """Test whether every recording alone would give the same parameters; of one, every block of its map.

    To first order: the energy that parameters free per recording explain beyond the shared ones. None where there is
    one recording of one block.

    Parameters
    ----------
    fitted : Fit
    draws : numpy.ndarray, shape (rows, draws)
        Of noise, beside the fit.
    """
    moves = fitted.jacobian[:, fitted.unbound]
    columns = moves / np.maximum(np.linalg.norm(moves, axis=0), 1e-12)
    own = [columns[fitted.rows.of(k)] for k in range(len(fitted.data))]
    if len(own) == 1:
        parts = parts_of(fitted, 0)
        if len(parts) < 2:
            return None
        own = [np.hstack([own[0] * part[:, None] for part in parts])]
    return Beside.of(fitted, own, draws).energy()

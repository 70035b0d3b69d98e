"""Prediction of data that a fit has not seen: blocks left out, whole recordings left out, to first order about the fit.

A fit without some rows differs from the full one by the solution of a small linear problem; its error on those rows
follows without predicting anything anew. Blocks are wide against the correlation of noise and model error, and points
near the block's border train neither.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dlwpredict.infer.objective import Fit
from dlwpredict.infer.whitened import Whitened

BLOCK_UM, BLOCK_FWHMS = 20.0, 2.5
"""Blocks are at least this wide, and at least so many cross-linking FWHMs ..."""

BUFFER_UM = 3.0
"""... with this much left out of the training around them."""

MOST_ALONG = 3
"""Blocks along an axis that are asked for parameters of their own: as many as tell centre from rim."""

FEWEST = 50
"""Points that a block must have to be scored."""


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Errors on rows that a fit had not seen.

    Parameters
    ----------
    squares_um2 : numpy.ndarray, shape (folds,)
        Sums of squares, µm².
    points : numpy.ndarray, shape (folds,)
    """

    squares_um2: np.ndarray
    points: np.ndarray

    @property
    def rmse_um(self) -> float:
        """Root mean square over all folds, µm."""
        return float(np.sqrt(self.squares_um2.sum() / self.points.sum()))


def block_um(fitted: Fit) -> float:
    """Return the width of the blocks, µm."""
    return max(BLOCK_UM, BLOCK_FWHMS * fitted.parameters.paper.crosslink_fwhm_xy_um)


def cuts(fitted: Fit, least: int = 1, width_um: float | None = None) -> list[tuple[int, int]]:
    """Return into how many blocks every map is cut along x and along y; at least so many."""
    width = width_um or block_um(fitted)
    sizes = [item.recording.target.size_um for item in fitted.data]
    return [(max(int(x / width), least), max(int(y / width), least)) for x, y in sizes]


def blocks(fitted: Fit, least: int = 1, width_um: float | None = None) -> LeftOut | None:
    """Leave out every block of the maps in turn; None where the maps hold fewer than two.

    Fits are compared on the same blocks: of a width that is given, else of the fit's own.
    """
    linear, folds = _Linear.of(fitted), []
    for k, (item, counts) in enumerate(zip(fitted.data, cuts(fitted, least, width_um), strict=True)):
        for inside, near in _block_masks(item, counts):
            test = _rows(fitted, k, inside)
            if test.sum() > FEWEST:
                folds.append(linear.scored(_rows(fitted, k, near), test, k, own_nuisances=False))
    return _together(folds) if len(folds) > 1 else None


def parts_of(fitted: Fit, k: int) -> list[np.ndarray]:
    """Return which points of recording k lie in each of few large blocks of its map, shape (points,) each."""
    item, (across, up) = fitted.data[k], cuts(fitted)[k]
    masks = _block_masks(item, (min(across, MOST_ALONG), min(up, MOST_ALONG)))
    inside = [mask[item.recording.used] for mask, _ in masks]
    return [part for part in inside if part.sum() > FEWEST]


def recordings(fitted: Fit) -> LeftOut | None:
    """Leave out every recording in turn; its own levelling and registration stay free. None with fewer than two."""
    if len(fitted.data) < 2:
        return None
    linear, folds = _Linear.of(fitted), []
    for k in range(len(fitted.data)):
        test = np.zeros(fitted.rows.total, dtype=bool)
        test[fitted.rows.of(k)] = True
        unseen = test.copy()
        unseen[fitted.rows.nuisance_priors(k)] = True
        folds.append(linear.scored(unseen, test, k, own_nuisances=True))
    return _together(folds)


def _together(folds: list[tuple[float, int]]) -> LeftOut:
    return LeftOut(*(np.array(column) for column in zip(*folds, strict=True)))


def _block_masks(item: Whitened, counts: tuple[int, int]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield for each block the mask of its pixels, and of those in or near it."""
    grid = item.recording.target
    if counts == (1, 1):
        return
    x, y = grid.x_um + grid.size_um[0] / 2, grid.y_um + grid.size_um[1] / 2
    for column in range(counts[0]):
        for row in range(counts[1]):
            masks = []
            for extra in (0.0, BUFFER_UM):
                across, up = (
                    (at >= n * size / count - extra) & (at < (n + 1) * size / count + extra)
                    for at, n, size, count in zip((x, y), (column, row), grid.size_um, counts, strict=True)
                )
                masks.append(up[:, None] & across)
            yield masks[0], masks[1]


def _rows(fitted: Fit, k: int, mask: np.ndarray) -> np.ndarray:
    """Return which rows are the masked points of recording k."""
    chosen = np.zeros(fitted.rows.total, dtype=bool)
    chosen[fitted.rows.of(k)] = mask[fitted.data[k].recording.used]
    return chosen


@dataclass(frozen=True, eq=False)
class _Linear:
    """A fit to first order: all that may move, as columns of length 1, with their scalar products."""

    fitted: Fit
    matrix: np.ndarray
    nuisance_columns: tuple[slice, ...]
    products: np.ndarray
    right: np.ndarray

    @classmethod
    def of(cls, fitted: Fit) -> _Linear:
        rows, nuisances, moves = fitted.rows, fitted.nuisances, fitted.jacobian[:, fitted.unbound]
        first = np.cumsum([moves.shape[1], *(above.shape[1] for above in nuisances.above)])
        nuisance_columns = tuple(slice(int(a), int(b)) for a, b in pairwise(first))
        matrix = np.zeros((rows.total, int(first[-1])))
        matrix[:, : first[0]] = moves
        for k, columns in enumerate(nuisance_columns):
            matrix[rows.of(k), columns] = nuisances.above[k]
            matrix[rows.nuisance_priors(k), columns] = nuisances.below[k]
        matrix /= np.maximum(np.linalg.norm(matrix, axis=0), 1e-12)
        return cls(fitted, matrix, nuisance_columns, matrix.T @ matrix, matrix.T @ fitted.residual)

    def scored(self, unseen: np.ndarray, test: np.ndarray, k: int, *, own_nuisances: bool) -> tuple[float, int]:
        """Fit without the unseen rows and score on the test rows of recording k: µm² and points."""
        fitted, out = self.fitted, self.matrix[unseen]
        values, vectors = np.linalg.eigh(self.products - out.T @ out)
        real = values > 1e-6 * values.max(initial=0.0)
        right = self.right - out.T @ fitted.residual[unseen]
        moved = self.matrix @ (vectors[:, real] @ ((vectors[:, real].T @ right) / values[real]))
        if own_nuisances:
            basis = self.matrix[test, self.nuisance_columns[k]]
            moved[test] += basis @ np.linalg.lstsq(basis, (fitted.residual - moved)[test], rcond=1e-6)[0]
        item, rows = fitted.data[k], fitted.rows.of(k)
        micrometres, inside = item.whitener.solve(moved[rows]), test[rows]
        error = (fitted.residual_um(k)[item.recording.used] - micrometres)[inside]
        return float(error @ error), int(inside.sum())

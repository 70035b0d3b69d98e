"""Prediction of data that a fit has not seen: blocks left out, whole recordings left out, to first order about the fit.

A fit without some rows differs from the full one by the solution of a small linear problem; its error on those rows
follows without predicting anything anew. Blocks are wide against the correlation of noise and model error, and points
near the block's border train neither.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dlwpredict.diagnose.evidence import Whitened
from dlwpredict.diagnose.fit import Fit

BLOCK_UM, BLOCK_FWHMS = 20.0, 2.5
"""Blocks are at least this wide, and at least so many cross-linking FWHMs ..."""

BUFFER_UM = 3.0
"""... with this much left out of the training around them."""


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Errors on rows that a fit had not seen.

    Parameters
    ----------
    chi2 : numpy.ndarray, shape (folds,)
        Whitened sums of squares.
    squares_um2 : numpy.ndarray, shape (folds,)
        Sums of squares, µm².
    points : numpy.ndarray, shape (folds,)
    """

    chi2: np.ndarray
    squares_um2: np.ndarray
    points: np.ndarray

    @property
    def rmse_um(self) -> float:
        """Root mean square over all folds, µm."""
        return float(np.sqrt(self.squares_um2.sum() / self.points.sum()))


def blocks(fitted: Fit) -> LeftOut | None:
    """Leave out every block of the maps in turn; None where the maps hold fewer than two."""
    width = max(BLOCK_UM, BLOCK_FWHMS * fitted.parameters.paper.crosslink_fwhm_xy_um)
    folds = []
    for k, item in enumerate(fitted.data):
        for inside, near in _block_masks(item, width):
            test, train = _rows(fitted, k, inside), _rows(fitted, k, ~near)
            others = _rows(fitted, k, np.zeros_like(inside), rest=True)
            if test.sum() > 50:
                folds.append(_scored(fitted, train | others, test, k, own_nuisances=False))
    return _joined(folds) if len(folds) > 1 else None


def recordings(fitted: Fit) -> LeftOut | None:
    """Leave out every recording in turn; its own levelling and registration stay free. None with fewer than two."""
    if len(fitted.data) < 2:
        return None
    folds = []
    for k, item in enumerate(fitted.data):
        nothing = np.zeros(item.recording.used.shape, dtype=bool)
        train = _rows(fitted, k, nothing, rest=True)
        folds.append(_scored(fitted, train, _rows(fitted, k, ~nothing), k, own_nuisances=True))
    return _joined(folds)


def _joined(folds: list[tuple[float, float, int]]) -> LeftOut:
    return LeftOut(*(np.array(column) for column in zip(*folds, strict=True)))


def _block_masks(item: Whitened, width_um: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield for each block the mask of its pixels, and of those in or near it."""
    grid = item.recording.target
    counts = [max(int(size / width_um), 1) for size in grid.size_um]
    if counts == [1, 1]:
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


def _rows(fitted: Fit, k: int, mask: np.ndarray, *, rest: bool = False) -> np.ndarray:
    """Return which rows of the stack are the masked points of recording k; with `rest` also all of the others."""
    parts = [
        mask[item.recording.used] if j == k else np.full(item.recording.points, rest)
        for j, item in enumerate(fitted.data)
    ]
    below = len(fitted.residual) - sum(len(part) for part in parts)
    return np.concatenate([*parts, np.full(below, rest)])


def _scored(
    fitted: Fit, train: np.ndarray, test: np.ndarray, k: int, *, own_nuisances: bool
) -> tuple[float, float, int]:
    """Fit on some rows and score on others of recording k: χ², µm² and points."""
    columns = np.column_stack([fitted.jacobian, fitted.nuisances.toarray()])
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
    matrix = columns / scale
    values, vectors = np.linalg.eigh(matrix[train].T @ matrix[train])
    real = values > 1e-6 * values[-1]
    change = vectors[:, real] @ ((vectors[:, real].T @ (matrix[train].T @ fitted.residual[train])) / values[real])
    moved = matrix @ change
    if own_nuisances:
        own = fitted.nuisances
        left = np.where(test, fitted.residual - moved, 0.0)
        size = (own[test].T @ own[test]).toarray()
        moved = moved + own @ np.linalg.lstsq(size, own.T @ left, rcond=1e-6)[0] * test
    first = sum(item.recording.points for item in fitted.data[:k])
    item = fitted.data[k]
    rows = slice(first, first + item.recording.points)
    micrometres = item.whitener.solve(moved[rows])
    inside = test[rows]
    error = (fitted.residual_um(k)[item.recording.used] - micrometres)[inside]
    white = (fitted.residual - moved)[test]
    return float(white @ white), float(error @ error), int(inside.sum())

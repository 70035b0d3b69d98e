"""How well the fit predicts what it has not seen: spatial blocks left out in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.optimize import lsq_linear

from dlwpredict.calibrate.problem import Point
from dlwpredict.calibrate.recordings import Recording
from dlwpredict.flat import Free
from dlwpredict.noise import Noise

FOLDS = 4
LEAST_BLOCK_UM = 20.0
RANGES = 3.0
"""Blocks span this many ranges of the noise, and as many cross-linking FWHMs, and at least `LEAST_BLOCK_UM` ..."""
BLOCKS_PER_SIDE = 2
"""... but every recording is cut at least this often along each side."""


@dataclass(frozen=True)
class Holdout:
    """Error on blocks that were left out.

    Parameters
    ----------
    rmse_um : float
        Over all blocks, µm.
    folds : int
    block_um : tuple of float
        Side of the blocks of each recording, µm.
    buffer_um : float
        Points this near to a left-out block were left out of the fit too, µm.
    """

    rmse_um: float
    folds: int
    block_um: tuple[float, ...]
    buffer_um: float


def hold_out(
    recordings: Sequence[Recording],
    free: Free,
    point: Point,
    jacobian: Sequence[np.ndarray],
    noises: Sequence[Noise],
) -> Holdout:
    """Leave out a quarter of the blocks at a time, refit, and predict them.

    The refit is linear about the solution (with its bounds), so it costs no prediction; offset, tilt and shift of a
    recording stay those of the whole.
    """
    parameters = free.parameters(point.vector).paper
    reach = max(noise.length_um for noise in noises)
    wanted = max(RANGES * 2 * reach, RANGES * parameters.crosslink_fwhm_xy_um, LEAST_BLOCK_UM)
    blocks = [_blocks(r, wanted) for r in recordings]
    buffer_um = 2 * reach
    squares, points = 0.0, 0
    for fold in range(FOLDS):
        out = [(number + k) % FOLDS == fold for k, (number, _) in enumerate(blocks)]
        step = _refit(
            recordings, free, point, jacobian, [~_grown(o, r, buffer_um) for o, r in zip(out, recordings, strict=True)]
        )
        for r, o, residual, j in zip(recordings, out, point.residuals, jacobian, strict=True):
            seen = o[r.used]
            squares += float(np.sum((residual - j @ step)[seen] ** 2))
            points += int(seen.sum())
    return Holdout(float(np.sqrt(squares / max(points, 1))), FOLDS, tuple(side for _, side in blocks), float(buffer_um))


def _blocks(recording: Recording, wanted_um: float) -> tuple[np.ndarray, float]:
    """Return the number of the block of every pixel, and the side of the blocks."""
    sides = recording.target.size_um
    counts = [max(int(side / wanted_um), BLOCKS_PER_SIDE) for side in sides]
    col, row = (np.arange(n) * c // n for n, c in zip(recording.target.shape[::-1], counts, strict=True))
    return row[:, None] * 2 + col[None, :] + (row[:, None] // 2), float(
        min(s / c for s, c in zip(sides, counts, strict=True))
    )


def _grown(left_out: np.ndarray, recording: Recording, buffer_um: float) -> np.ndarray:
    grid = recording.target
    return ndimage.distance_transform_edt(~left_out, sampling=(grid.dy_um, grid.dx_um)) <= buffer_um


def _refit(
    recordings: Sequence[Recording], free: Free, point: Point, jacobian: Sequence[np.ndarray], keep: list[np.ndarray]
) -> np.ndarray:
    """Return the change of the parameters when only these pixels count."""
    roots = [np.sqrt(w) * k[r.used] for r, w, k in zip(recordings, point.weights, keep, strict=True)]
    matrix = np.concatenate([j * root[:, None] for j, root in zip(jacobian, roots, strict=True)])
    goal = np.concatenate([residual * root for residual, root in zip(point.residuals, roots, strict=True)])
    width = free.high - free.low
    low, high = (free.low - point.vector) / width, (free.high - point.vector) / width
    return lsq_linear(matrix * width, goal, bounds=(np.minimum(low, -1e-9), np.maximum(high, 1e-9))).x * width

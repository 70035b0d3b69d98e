"""What the recordings say about a prediction: residuals, derivatives and nuisances, all whitened, all in one stack.

In whitened space noise is white with variance 1, least squares is maximum likelihood, and rows of priors stand
beside rows of data. Every recording keeps its own nuisances: what levelling, registration and the grid may have done.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import ndimage, sparse

from dlwpredict.calibrate.recordings import Recording
from dlwpredict.heightmap import HeightMap
from dlwpredict.noise import Noise
from dlwpredict.whitening import Neighbourhood

SCALE_PRIOR = 2e-3
"""Standard deviation of a lateral scale that the certificate of a pixel pitch leaves open; the same for shear."""

ROTATION_PRIOR = np.deg2rad(0.1)
"""Standard deviation of the rotation that an alignment leaves, rad."""

DISCRETISATION_PRIOR = 1.0
"""The change of the prediction on pixels of half the size is in the recording to about this multiple."""

SHIFT_PRIOR = 0.1
"""Standard deviation of the shift that an alignment leaves, µm; what a print does to its own edges included."""

FREE = np.inf

NUISANCES = {
    "offset": FREE,
    "tilt_x": FREE,
    "tilt_y": FREE,
    "shift_x": SHIFT_PRIOR,
    "shift_y": SHIFT_PRIOR,
    "rotation": ROTATION_PRIOR,
    "scale_x": SCALE_PRIOR,
    "scale_y": SCALE_PRIOR,
    "shear": SCALE_PRIOR,
    "pixels": DISCRETISATION_PRIOR,
}
"""Nuisances of a recording and the standard deviations of their priors."""


def gradient(heights_um: np.ndarray, pitch_um: float, axis: int) -> np.ndarray:
    """Return the derivative along an axis of the array by the central difference of sixth order.

    It reaches three pixels to either side and no further, so a wall does not ring into points that are used.
    """
    return (
        ndimage.correlate1d(heights_um, np.array([-1, 9, -45, 0, 45, -9, 1]) / 60, axis=axis, mode="nearest") / pitch_um
    )


def bending(heights_um: np.ndarray, pitch_um: float, axis: int) -> np.ndarray:
    """Return the second derivative along an axis of the array, sixth order, three pixels to either side."""
    taps = np.array([2, -27, 270, -490, 270, -27, 2]) / 180
    return ndimage.correlate1d(heights_um, taps, axis=axis, mode="nearest") / pitch_um**2


def shifted(heights_um: np.ndarray, grid: HeightMap, shift_um: Sequence[float]) -> np.ndarray:
    """Return a map moved by a small (x, y), y upwards, to second order."""
    x, y = shift_um
    right, up = gradient(heights_um, grid.dx_um, 1), -gradient(heights_um, grid.dy_um, 0)
    mixed = gradient(up, grid.dx_um, 1)
    second = x**2 * bending(heights_um, grid.dx_um, 1) + y**2 * bending(heights_um, grid.dy_um, 0) + 2 * x * y * mixed
    return heights_um - x * right - y * up + second / 2


@dataclass(frozen=True, eq=False)
class Whitened:
    """One recording in whitened space.

    Parameters
    ----------
    recording : Recording
        Its `used` points are those of the whitener.
    noise : Noise
    matrix : scipy.sparse.csr_array, shape (points, points)
        Turns values at the used points into independent ones of variance 1.
    discretisation_um : numpy.ndarray, shape (rows, cols)
        Change of the prediction on pixels of half the size.
    shift_um : tuple of float
        Registration found so far, about which the shift columns are taken.
    """

    recording: Recording
    noise: Noise
    matrix: sparse.csr_array = field(repr=False)
    discretisation_um: np.ndarray = field(repr=False)
    shift_um: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def of(cls, recording: Recording, noise: Noise, discretisation_um: np.ndarray) -> Whitened:
        """Build the whitener of a recording."""
        grid = recording.target
        neighbours = Neighbourhood(recording.used, grid.dx_um, grid.dy_um)
        return cls(recording, noise, neighbours.whitener(noise), discretisation_um)

    def white(self, maps: np.ndarray) -> np.ndarray:
        """Whiten maps (..., rows, cols), result (points, ...)."""
        values = np.moveaxis(np.asarray(maps)[..., self.recording.used], -1, 0)
        return self.matrix @ values.reshape(len(values), -1) if values.ndim > 1 else self.matrix @ values

    def moved(self, predicted_um: np.ndarray) -> np.ndarray:
        """Return a prediction where registration has put it."""
        return shifted(predicted_um, self.recording.target, self.shift_um) if any(self.shift_um) else predicted_um

    def residual(self, predicted_um: np.ndarray) -> np.ndarray:
        """Whiten recording − prediction, shape (points,)."""
        measured = self.recording.measured.heights_um
        return self.white(np.where(self.recording.used, measured, 0.0) - self.moved(predicted_um))

    def nuisance_maps(self, predicted_um: np.ndarray) -> np.ndarray:
        """Return the nuisance columns as maps (nuisance, rows, cols), in the order of `NUISANCES`.

        The lateral ones are −∇f·u for the displacements u = (1, 0), (0, 1), (−y, x), (x, 0), (0, y), (y, 0).
        """
        grid = self.recording.target
        moved = self.moved(predicted_um)
        right, up = gradient(moved, grid.dx_um, 1), -gradient(moved, grid.dy_um, 0)
        x, y = np.broadcast_to(grid.x_um, grid.shape), np.broadcast_to(grid.y_um[:, None], grid.shape)
        half_x, half_y = (size / 2 for size in grid.size_um)
        return np.stack([
            np.ones(grid.shape), x / half_x, y / half_y, -right, -up, y * right - x * up,
            -x * right, -y * up, -y * right, self.discretisation_um,
        ])  # fmt: skip


def stack(parts: Sequence[np.ndarray], priors: int = 0) -> np.ndarray:
    """Stack the recordings' rows, and as many rows of zeros below as there are rows of priors."""
    rows = np.concatenate(parts)
    return np.concatenate([rows, np.zeros((priors, *rows.shape[1:]))]) if priors else rows


def nuisance_fit(columns: Sequence[np.ndarray], residuals: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Fit every recording's own nuisances, priors included.

    Parameters
    ----------
    columns : sequence of numpy.ndarray, shape (points, nuisances)
        Whitened nuisance columns of each recording.
    residuals : sequence of numpy.ndarray, shape (points,)

    Returns
    -------
    coefficients : numpy.ndarray, shape (recordings, nuisances)
    basis : numpy.ndarray, shape (all points + priors, columns)
        Orthonormal; rows of the priors stand below those of the data, as in `stack`.
    """
    widths = np.array(list(NUISANCES.values()))
    bounded = np.flatnonzero(np.isfinite(widths))
    prior = np.zeros((len(bounded), len(widths)))
    prior[range(len(bounded)), bounded] = 1 / widths[bounded]
    found, bases = [], []
    for own, residual in zip(columns, residuals, strict=True):
        block = np.concatenate([own, prior])
        scale = np.maximum(np.linalg.norm(block, axis=0), 1e-12)
        left, sizes, right = np.linalg.svd(block / scale, full_matrices=False)
        real = sizes > 1e-8 * sizes[0]
        found.append((right[real].T @ (left[: len(residual), real].T @ residual / sizes[real])) / scale)
        bases.append(left[:, real])
    data = sparse.block_diag([b[: len(r)] for b, r in zip(bases, residuals, strict=True)]).toarray()
    below = sparse.block_diag([b[len(r) :] for b, r in zip(bases, residuals, strict=True)]).toarray()
    return np.array(found), np.concatenate([data, below])


def prior_rows(recordings: int) -> int:
    """Return how many rows of priors stand below the data."""
    return recordings * int(np.isfinite(list(NUISANCES.values())).sum())

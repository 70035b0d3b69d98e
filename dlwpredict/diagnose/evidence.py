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
from dlwpredict.parameters import Paper, ParameterSet, declarations
from dlwpredict.uneven import Uneven
from dlwpredict.whitening import Whitener

SCALE_PRIOR = 2e-3
"""Standard deviation of a lateral scale that the certificate of a pixel pitch leaves open; the same for shear."""

ROTATION_PRIOR = np.deg2rad(0.1)
"""Standard deviation of the rotation that an alignment leaves, rad."""

DISCRETISATION_PRIOR = 1.0
"""The change of the prediction on pixels of half the size is in the recording once (a print has no pixels), give or
take this multiple."""

SHIFT_PRIOR = 0.1
"""Standard deviation of the shift that an alignment leaves, µm; what a print does to its own edges included."""

WIDTH_PRIOR = 0.4
"""Standard deviation of the logarithm of every FWHM about the paper's value. Without it a missing dome or edge drives
the exposure's axial FWHM to 10 µm, where signatures are no longer those of the process."""

WIDTHS = {name: default for name, (default, _) in declarations(Paper).items() if "fwhm" in name}
"""The parameters that have this prior, and its centres, µm."""

STEEPEST = 3.0
"""Slope beyond which a pixel's is that of a wall, and says nothing more."""

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

LATERAL = slice(list(NUISANCES).index("shift_x"), list(NUISANCES).index("shear") + 1)
"""Those that displace what is seen."""


def gradient(heights_um: np.ndarray, pitch_um: float, axis: int) -> np.ndarray:
    """Return the derivative along an axis of the array by the central difference of fourth order.

    It reaches two pixels to either side, less than the rim of a wall that does not count: a jump of the map never
    passes for a slope.
    """
    return ndimage.correlate1d(heights_um, np.array([1, -8, 0, 8, -1]) / 12, axis=axis, mode="nearest") / pitch_um


def steepness(heights_um: np.ndarray, grid: HeightMap) -> np.ndarray:
    """Return |∇f| of a map, at most `STEEPEST`, shape (rows, cols)."""
    across, down = gradient(heights_um, grid.dx_um, 1), gradient(heights_um, grid.dy_um, 0)
    return np.minimum(np.hypot(across, down), STEEPEST)


def bending(heights_um: np.ndarray, pitch_um: float, axis: int) -> np.ndarray:
    """Return the second derivative along an axis of the array, fourth order, two pixels to either side."""
    taps = np.array([-1, 16, -30, 16, -1]) / 12
    return ndimage.correlate1d(heights_um, taps, axis=axis, mode="nearest") / pitch_um**2


def shifted(
    heights_um: np.ndarray, grid: HeightMap, shift_um: Sequence[float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return maps (..., rows, cols) moved by a small (x, y), y upwards, to second order, and their slopes.

    f − x·f_x − y·f_y + (x²·f_xx + 2xy·f_xy + y²·f_yy)/2; the slopes, along x and y, are minus its exact derivatives by
    x and y. Differences of the moved map would not be: where features are few pixels wide, registration by them does
    not come to rest.
    """
    x, y = shift_um
    right, up = gradient(heights_um, grid.dx_um, -1), -gradient(heights_um, grid.dy_um, -2)
    if x == 0 and y == 0:
        return heights_um, right, up
    mixed = gradient(up, grid.dx_um, -1)
    slope_x = right - x * bending(heights_um, grid.dx_um, -1) - y * mixed
    slope_y = up - y * bending(heights_um, grid.dy_um, -2) - x * mixed
    return heights_um - (x * (right + slope_x) + y * (up + slope_y)) / 2, slope_x, slope_y


def displacements(grid: HeightMap) -> np.ndarray:
    """Return the fields u of the lateral nuisances: (1, 0), (0, 1), (−y, x), (x, 0), (0, y), (y, 0).

    Returns
    -------
    numpy.ndarray, shape (lateral nuisances, 2, rows, cols)
        Along x and y.
    """
    x, y = np.broadcast_to(grid.x_um, grid.shape), np.broadcast_to(grid.y_um[:, None], grid.shape)
    one, no = np.ones(grid.shape), np.zeros(grid.shape)
    return np.array([(one, no), (no, one), (-y, x), (x, no), (no, y), (y, no)])


@dataclass(frozen=True, eq=False)
class Whitened:
    """One recording in whitened space.

    Parameters
    ----------
    recording : Recording
        Its `used` points are those of the whitener.
    noise : Uneven
    whitener : Whitener
        Turns values at the used points into independent ones of variance 1.
    discretisation_um : numpy.ndarray, shape (rows, cols)
        Change of the prediction on pixels of half the size.
    slope : numpy.ndarray, shape (rows, cols), or 0
        |∇f| of the surface, where the noise hangs on it.
    shift_um : tuple of float
        Registration found so far, about which the shift columns are taken.
    """

    recording: Recording
    noise: Uneven
    whitener: Whitener = field(repr=False)
    discretisation_um: np.ndarray = field(repr=False)
    slope: np.ndarray | float = field(default=0.0, repr=False)
    shift_um: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def of(
        cls, recording: Recording, noise: Uneven, discretisation_um: np.ndarray, slope: np.ndarray | float = 0.0
    ) -> Whitened:
        """Build the whitener of a recording."""
        return cls(recording, noise, Whitener.of(recording.used, noise, slope), discretisation_um, slope)

    def white(self, maps: np.ndarray) -> np.ndarray:
        """Whiten maps (..., rows, cols), result (points, ...)."""
        values = np.moveaxis(np.asarray(maps)[..., self.recording.used], -1, 0)
        return self.whitener @ (values.reshape(len(values), -1) if values.ndim > 1 else values)

    def moved(self, predicted_um: np.ndarray) -> np.ndarray:
        """Return a prediction where registration has put it."""
        return shifted(predicted_um, self.recording.target, self.shift_um)[0] if any(self.shift_um) else predicted_um

    def residual(self, predicted_um: np.ndarray) -> np.ndarray:
        """Whiten recording − prediction, shape (points,)."""
        measured = self.recording.measured.heights_um
        return self.white(np.where(self.recording.used, measured, 0.0) - self.moved(predicted_um))

    def nuisance_maps(self, predicted_um: np.ndarray) -> np.ndarray:
        """Return the nuisance columns as maps (nuisance, rows, cols), in the order of `NUISANCES`.

        The lateral ones are −∇f·u for their displacements u.
        """
        grid = self.recording.target
        _, right, up = shifted(predicted_um, grid, self.shift_um)
        x, y = np.broadcast_to(grid.x_um, grid.shape), np.broadcast_to(grid.y_um[:, None], grid.shape)
        half_x, half_y = (size / 2 for size in grid.size_um)
        lateral = [-across * right - upwards * up for across, upwards in displacements(grid)]
        return np.stack([np.ones(grid.shape), x / half_x, y / half_y, *lateral, self.discretisation_um])

    def registered(self, changes_um: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        """Return changes of the prediction (..., rows, cols) where registration has put what they change.

        f − ∇f·u of the shift found and of the lateral nuisances with their coefficients: linear in f, so that this is
        exactly the change of the prediction with its nuisances, as long as they keep their coefficients.
        """
        grid = self.recording.target
        moved, right, up = shifted(changes_um, grid, self.shift_um)
        across, upwards = np.tensordot(coefficients[LATERAL], displacements(grid), axes=1)
        return moved - across * right - upwards * up


def stack(parts: Sequence[np.ndarray], priors: int = 0) -> np.ndarray:
    """Stack the recordings' rows, and as many rows of zeros below as there are rows of priors."""
    rows = np.concatenate(parts)
    return np.concatenate([rows, np.zeros((priors, *rows.shape[1:]))]) if priors else rows


def unwhitened(data: Sequence[Whitened], columns: np.ndarray) -> list[np.ndarray]:
    """Return what whitened columns (rows, columns) are in µm: for every recording, shape (points, columns)."""
    ends = np.cumsum([item.recording.points for item in data])
    parts = np.split(columns, ends)[: len(data)]
    return [item.whitener.solve(part) for item, part in zip(data, parts, strict=True)]


def nuisance_fit(
    columns: Sequence[np.ndarray], residuals: Sequence[np.ndarray], known: np.ndarray
) -> tuple[np.ndarray, np.ndarray, sparse.csr_array]:
    """Fit every recording's own nuisances, priors included.

    Parameters
    ----------
    columns : sequence of numpy.ndarray, shape (points, nuisances)
        Whitened nuisance columns of each recording.
    residuals : sequence of numpy.ndarray, shape (points,)
    known : numpy.ndarray, shape (recordings, nuisances)
        How much of each nuisance is in the prediction already; the priors hold for the whole.

    Returns
    -------
    coefficients : numpy.ndarray, shape (recordings, nuisances)
        What is to be added.
    residual : numpy.ndarray, shape (all points + priors,)
        Before the fit.
    basis : scipy.sparse.csr_array, shape (all points + priors, columns)
        Orthonormal, each recording's in columns of its own; rows of the priors stand below those of the data, as in
        `stack`.
    """
    widths = np.array(list(NUISANCES.values()))
    bounded = np.flatnonzero(np.isfinite(widths))
    prior = np.zeros((len(bounded), len(widths)))
    prior[range(len(bounded)), bounded] = 1 / widths[bounded]
    found, bases = [], []
    expected = np.array([float(name == "pixels") for name in NUISANCES])
    goals = [prior @ (expected - has) for has in known]
    for own, residual, goal in zip(columns, residuals, goals, strict=True):
        block, target = np.concatenate([own, prior]), np.concatenate([residual, goal])
        scale = np.maximum(np.linalg.norm(block, axis=0), 1e-12)
        block = block / scale
        energies, turn = np.linalg.eigh(block.T @ block)
        real = energies > 1e-12 * energies[-1]
        turn = turn[:, real] / np.sqrt(energies[real])
        bases.append(block @ turn)
        found.append(turn @ (bases[-1].T @ target) / scale)
    residual = np.concatenate([*residuals, *goals, np.zeros(len(WIDTHS))])
    above = [block[: len(own)] for block, own in zip(bases, residuals, strict=True)]
    below = [block[len(own) :] for block, own in zip(bases, residuals, strict=True)]
    return np.array(found), residual, _side_by_side(above, below, len(residual))


def _side_by_side(above: Sequence[np.ndarray], below: Sequence[np.ndarray], rows: int) -> sparse.csr_array:
    """Return a matrix of blocks, each in columns of its own: the parts above first, then those below, then zeros."""
    ends = np.cumsum([block.shape[1] for block in above])
    places = [np.arange(end - block.shape[1], end, dtype=np.int32) for block, end in zip(above, ends, strict=True)]
    blocks = list(zip([*above, *below], [*places, *places], strict=True))
    values = np.concatenate([block.ravel() for block, _ in blocks])
    columns = np.concatenate([np.tile(place, len(block)) for block, place in blocks])
    counts = np.concatenate([np.full(len(block), len(place), dtype=np.int32) for block, place in blocks])
    starts = np.concatenate([[0], np.cumsum(counts), np.full(rows - len(counts), counts.sum())])
    return sparse.csr_array((values, columns, starts), shape=(rows, ends[-1]))


def prior_rows(recordings: int) -> int:
    """Return how many rows of priors stand below the data: those of every recording's nuisances, then of the widths."""
    return recordings * int(np.isfinite(list(NUISANCES.values())).sum()) + len(WIDTHS)


def width_rows(parameters: ParameterSet, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of the widths' priors: residuals (widths,) and derivatives by the named parameters.

    (ln μ − ln w)/σ, as recording − prediction; a width that is not free has no say.
    """
    residual, derivative = np.zeros(len(WIDTHS)), np.zeros((len(WIDTHS), len(names)))
    for row, (name, centre) in enumerate(WIDTHS.items()):
        if name in names:
            width = getattr(parameters.paper, name)
            residual[row] = np.log(centre / width) / WIDTH_PRIOR
            derivative[row, list(names).index(name)] = 1 / (width * WIDTH_PRIOR)
    return residual, derivative

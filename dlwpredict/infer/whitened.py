"""One recording in whitened space: its residual, what its nuisances do, and its registration.

In whitened space noise is white with variance 1, least squares is maximum likelihood, and rows of priors stand beside
rows of data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import ndimage

from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.priors import LATERAL, LEVELLING, SCALES, SHIFTS
from dlwpredict.infer.recording import Recording
from dlwpredict.noise.unevenness import Uneven
from dlwpredict.noise.whitening import Whitener
from dlwpredict.numerics.interpolation import DIFFERENCES, moved_along
from dlwpredict.numerics.smoothing import means_over

STEEPEST = 3.0
"""Slope beyond which a pixel's is that of a wall, and says nothing more."""


def gradient(heights_um: np.ndarray, pitch_um: float, axis: int) -> np.ndarray:
    """Return the derivative along an axis of the array by the central difference of fourth order.

    It reaches two pixels to either side, less than the rim of a wall that does not count: a jump of the map never
    passes for a slope.
    """
    return ndimage.correlate1d(heights_um, DIFFERENCES[6], axis=axis, mode="nearest") / pitch_um


def steepness(heights_um: np.ndarray, grid: HeightMap) -> np.ndarray:
    """Return |∇f| of a map, at most `STEEPEST`, shape (rows, cols)."""
    across, down = gradient(heights_um, grid.dx_um, 1), gradient(heights_um, grid.dy_um, 0)
    return np.minimum(np.hypot(across, down), STEEPEST)


def shifted(
    heights_um: np.ndarray, grid: HeightMap, place: Sequence[float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return maps (..., rows, cols) moved by shift + scale · position, y upwards, and their slopes along x and y.

    The slopes are minus the exact derivatives of the moved maps by that displacement. Differences of the moved map
    would not be: where features are few pixels wide, registration by them does not converge.

    Parameters
    ----------
    heights_um : numpy.ndarray, shape (..., rows, cols)
    grid : HeightMap
    place : sequence of float
        Of `PLACE`: shift along x and y, µm, and scale along x and y.
    """
    right_um, up_um, wider, longer = place
    across = (right_um + wider * grid.x_um if wider else right_um) / grid.dx_um
    up = -(up_um + longer * grid.y_um if longer else up_um) / grid.dy_um
    along, by_row = moved_along(heights_um, up, -2)
    moved, by_column = moved_along(along, across, -1)
    return moved, -by_column / grid.dx_um, moved_along(by_row, across, -1)[0] / grid.dy_um


def displacements(grid: HeightMap) -> np.ndarray:
    """Return the fields u of the lateral nuisances: (1, 0), (0, 1), (−y, x), (x, 0), (0, y), (y, 0).

    Returns
    -------
    numpy.ndarray, shape (lateral nuisances, 2, rows, cols)
        Along x and y.
    """
    x, y = np.broadcast_to(grid.x_um, grid.shape), np.broadcast_to(grid.y_um[:, None], grid.shape)
    ones, zeros = np.ones(grid.shape), np.zeros(grid.shape)
    return np.array([(ones, zeros), (zeros, ones), (-y, x), (x, zeros), (zeros, y), (y, zeros)])


def levels(grid: HeightMap) -> np.ndarray:
    """Return what the nuisances of levelling do, µm at half the map's size, shape (levelling, rows, cols)."""
    half_x, half_y = (size / 2 for size in grid.size_um)
    tilts = np.broadcast_arrays(grid.x_um / half_x, grid.y_um[:, None] / half_y)
    return np.stack([np.ones(grid.shape), *tilts])


PLACE = (*SHIFTS, *SCALES)
"""Nuisances that may be followed along their path."""

UNMOVED = (0.0, 0.0, 0.0, 0.0)
"""Of a recording that lies where its alignment has laid it."""


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
    levelling : numpy.ndarray, shape (points, levelling)
        What levelling does, whitened.
    slope : numpy.ndarray, shape (rows, cols), or 0
        |∇f| of the surface, where the noise hangs on it.
    place : tuple of float
        Registration found so far, about which the columns of what is followed are taken: shift along x and y, µm, and
        scale along x and y.
    """

    recording: Recording
    noise: Uneven
    whitener: Whitener = field(repr=False)
    levelling: np.ndarray = field(repr=False)
    slope: np.ndarray | float = field(default=0.0, repr=False)
    place: tuple[float, float, float, float] = UNMOVED

    @classmethod
    def of(
        cls,
        recording: Recording,
        noise: Uneven,
        slope: np.ndarray | float = 0.0,
    ) -> Whitened:
        """Build the whitener of a recording."""
        whitener = Whitener.of(recording.used, noise, slope)
        return cls(recording, noise, whitener, whitener @ levels(recording.target)[:, recording.used].T, slope)

    @property
    def nuisances(self) -> tuple[str, ...]:
        """Names of the nuisances that are free."""
        return self.recording.nuisances

    @property
    def _levelled(self) -> list[bool]:
        """Which nuisances of levelling are free."""
        return [name in self.nuisances for name in LEVELLING]

    def white(self, maps: np.ndarray) -> np.ndarray:
        """Whiten maps (..., rows, cols), result (points, ...)."""
        values = np.moveaxis(np.asarray(maps)[..., self.recording.used], -1, 0)
        return self.whitener @ (values.reshape(len(values), -1) if values.ndim > 1 else values)

    def moved(self, predicted_um: np.ndarray) -> np.ndarray:
        """Return a prediction as the recording shows it: where registration has put it, as means."""
        if any(self.place):
            return self._shifted(predicted_um)[0]
        return self._means(predicted_um)

    def _means(self, maps_um: np.ndarray) -> np.ndarray:
        """Return maps (..., rows, cols) as means over the squares over which the recording's heights are means."""
        return means_over(maps_um, self.recording.width_px)

    def _shifted(self, maps_um: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return means of maps (..., rows, cols) where registration has put them, and their slopes; no wall is read."""
        maps_um = self.recording.across_walls(self._means(maps_um))
        return shifted(maps_um, self.recording.target, self.place)

    def nuisance_maps(self, predicted_um: np.ndarray) -> np.ndarray:
        """Return the nuisance columns as maps (nuisances, rows, cols), in the order of `nuisances`."""
        levelling = levels(self.recording.target)[self._levelled]
        return np.concatenate([levelling, self.shown(predicted_um)[1]])

    def shown(self, predicted_um: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return a prediction where registration has put it, and what its lateral nuisances do to it there.

        These are −∇f·u for their displacements u; no wall is read.

        Returns
        -------
        numpy.ndarray, shapes (rows, cols) and (lateral nuisances, rows, cols)
        """
        moved, right, up = self._shifted(predicted_um)
        fields = zip(LATERAL, displacements(self.recording.target), strict=True)
        maps = [-across * right - upwards * up for name, (across, upwards) in fields if name in self.nuisances]
        return moved, np.array(maps).reshape(-1, *moved.shape)

    def columns(self, predicted_um: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the whitened residual (points,) and nuisance columns (points, nuisances).

        Those of levelling are the same for every prediction, and are whitened once.
        """
        recording = self.recording
        moved, lateral = self.shown(predicted_um)
        left_um = np.where(recording.used, recording.measured.heights_um, 0.0) - moved
        white = self.white(np.concatenate([left_um[None], lateral]))
        levelling = self.levelling[:, self._levelled]
        return white[:, 0], np.column_stack([levelling, white[:, 1:]])

    def known(self) -> np.ndarray:
        """Return how much of each nuisance is in the prediction already, shape (nuisances,)."""
        has = dict(zip(PLACE, self.place, strict=True))
        return np.array([has.get(name, 0.0) for name in self.nuisances])

    def registered(self, changes_um: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        """Return changes of the prediction (..., rows, cols) where registration has put what they change.

        f − ∇f·u of the place found and of the lateral nuisances with their coefficients: linear in f, so that this is
        exactly the change of the prediction with its nuisances, as long as they keep their coefficients.
        """
        grid = self.recording.target
        values = dict(zip(self.nuisances, coefficients, strict=True))
        moved, right, up = self._shifted(changes_um)
        lateral = np.array([values.get(name, 0.0) for name in LATERAL])
        across, upwards = np.tensordot(lateral, displacements(grid), axes=1)
        return moved - across * right - upwards * up

    @property
    def followed(self) -> tuple[str, ...]:
        """Nuisances that are followed along their path: a scale where it may be far from what was taken out."""
        names = PLACE if self.recording.stretched else SHIFTS
        return tuple(name for name in names if name in self.nuisances)

    @property
    def lever_um(self) -> np.ndarray:
        """By how much a shift and a scale of one move the rim along x and y, shape (4,)."""
        across, up = self.recording.target.size_um
        return np.array([1.0, 1.0, across / 2, up / 2])

    @property
    def moved_um(self) -> np.ndarray:
        """By how much registration has moved the rim, shape (4,)."""
        return np.array(self.place) * self.lever_um

    def step_in(self, coefficients: np.ndarray) -> np.ndarray:
        """Return how far coefficients of what is followed move the rim, µm, shape (4,); 0 where none is free."""
        values = {
            name: value for name, value in zip(self.nuisances, coefficients, strict=True) if name in self.followed
        }
        return np.array([values.get(name, 0.0) for name in PLACE]) * self.lever_um

    def moved_by(self, step_um: np.ndarray) -> Whitened:
        """Return the recording with its registration moved further, the rim by at most a pixel at once."""
        limit = np.tile([self.recording.target.dx_um, self.recording.target.dy_um], 2)
        step = np.clip(step_um, -limit, limit) / self.lever_um
        return replace(self, place=tuple((np.array(self.place) + step).tolist()))

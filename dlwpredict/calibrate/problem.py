"""Residual and Jacobian of one parameter set against several recordings, with the work they took."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dlwpredict.calibrate.loss import Huber, Loss, Square, scale_um
from dlwpredict.calibrate.recordings import Recording, with_nuisances
from dlwpredict.calibrate.trace import Trace, trace
from dlwpredict.flat import Free, fittable
from dlwpredict.model.levels import Levels

STEP_OF_RANGE = 0.003
"""Step of a finite difference, in units of the declared range ..."""
STEP_OF_VALUE = 0.02
"""... or of the value, whichever is larger: large against the 1 nm by which the levels of the fast path may jump."""


@dataclass(frozen=True, eq=False)
class Point:
    """A place in parameter space, with everything that is known there.

    Parameters
    ----------
    vector : numpy.ndarray, shape (parameters,)
    traces : tuple of Trace
        One per recording.
    nuisances : tuple of numpy.ndarray
        Best coefficients of each recording's nuisance columns.
    residuals : tuple of numpy.ndarray
        Recording − prediction − nuisances at the used points, µm.
    weights : tuple of numpy.ndarray
        Weight of each point in the loss.
    cost : float
        The loss, µm² summed over all points.
    """

    vector: np.ndarray
    traces: tuple[Trace, ...]
    nuisances: tuple[np.ndarray, ...]
    residuals: tuple[np.ndarray, ...]
    weights: tuple[np.ndarray, ...]
    cost: float

    @property
    def rmse_um(self) -> float:
        """Root mean square of the residual over all used points, µm."""
        return float(np.sqrt(np.mean(np.concatenate(self.residuals) ** 2)))


@dataclass(eq=False)
class Problem:
    """One parameter set against several recordings.

    Parameters
    ----------
    recordings : tuple of Recording
    free : Free
        What moves.
    loss : Loss
    unit_px : int
        Pixels whose prediction counts as one unit of work: those of the recordings at full resolution.
    work : float
        Predictions of all recordings at full resolution that were spent so far; cheaper ones count by their share.
    watch : function of Point, optional
        Called with every new point.
    known : list
        The last two sets of predictions at which derivatives were taken, each with these, as maps.
    """

    recordings: tuple[Recording, ...]
    free: Free
    loss: Loss = field(default_factory=Square)
    unit_px: int = 0
    work: float = 0.0
    watch: Callable[[Point], None] | None = None
    numerics: Levels = field(default_factory=Levels)
    known: list[tuple[tuple[Trace, ...], list[np.ndarray]]] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        self.unit_px = self.unit_px or sum(r.target.heights_um.size for r in self.recordings)

    def at(self, vector: np.ndarray, known: Point | None = None) -> Point:
        """Predict every recording with these values and compare.

        Parameters
        ----------
        vector : numpy.ndarray, shape (parameters,)
        known : Point, optional
            An earlier point; what the change does not touch is taken over from it.
        """
        parameters = self.free.parameters(vector)
        before = known.traces if known else [None] * len(self.recordings)
        traces = self._traces([(k, parameters, old) for k, old in enumerate(before)])
        point = self.compared(np.array(vector), traces)
        if self.watch:
            self.watch(point)
        return point

    def compared(self, vector: np.ndarray, traces: Sequence[Trace]) -> Point:
        """Compare predictions with the recordings, best nuisances and weights included."""
        found = [
            fit_nuisances(recording.columns, recording.heights_um - t.heights_um[recording.used], self.loss)
            for recording, t in zip(self.recordings, traces, strict=True)
        ]
        nuisances, residuals = zip(*found, strict=True)
        weights = tuple(self.loss.weights(r) for r in residuals)
        cost = sum(self.loss.cost(r) for r in residuals)
        return Point(vector, tuple(traces), nuisances, residuals, weights, cost)

    def jacobian(self, point: Point) -> tuple[np.ndarray, ...]:
        """Differentiate the prediction by every free parameter, by finite differences.

        Returns
        -------
        tuple of numpy.ndarray, shape (points, parameters)
            One per recording; the nuisance columns are projected out with the point's weights.
        """
        found = zip(self.recordings, self.derivatives(point), point.weights, strict=True)
        return tuple(project(r.columns, maps[:, r.used].T, weights) for r, maps, weights in found)

    def derivatives(self, point: Point) -> list[np.ndarray]:
        """Return what `jacobian` is made of: for every recording maps of shape (parameters, rows, cols)."""
        found = next((maps for traces, maps in self.known if traces is point.traces), None)
        if found is None:
            found = self._differences(point)
            self.known = [(point.traces, found), *self.known[:1]]
        return found

    def _differences(self, point: Point) -> list[np.ndarray]:
        steps = [self.step(k, point.vector) for k in range(len(point.vector))]
        jobs, places = [], []
        for k, step in enumerate(steps):
            if step:
                moved = self.free.parameters(point.vector + step * np.eye(len(steps))[k])
                jobs += [(i, moved, old) for i, old in enumerate(point.traces)]
                places += [(i, k) for i in range(len(point.traces))]
        maps = [np.zeros((len(steps), *r.target.shape)) for r in self.recordings]
        for (i, k), new in zip(places, self._traces(jobs), strict=True):
            maps[i][k] = (new.heights_um - point.traces[i].heights_um) / steps[k]
        return maps

    def with_loss_scaled(self, point: Point, *, robust: bool) -> Problem:
        """Return the problem with the scale of the robust loss taken from this point's residuals."""
        loss = Huber(scale_um(np.concatenate(point.residuals))) if robust else Square()
        return self._likewise(loss=loss)

    def with_free_shift(self, point: Point) -> Problem:
        """Return the problem with a lateral shift of every recording free, to first order about this point."""
        pairs = zip(self.recordings, point.traces, strict=True)
        return self._likewise(recordings=tuple(with_nuisances(r, t.heights_um) for r, t in pairs))

    def _likewise(self, **changes: Any) -> Problem:
        """Return the problem with another loss or other nuisances: derivatives of the prediction stay what they are."""
        other = replace(self, **changes)
        other.known = self.known
        return other

    def _traces(self, jobs: list) -> list[Trace]:
        traces = [trace(self.recordings[k].target, process, self.numerics, known) for k, process, known in jobs]
        sizes = [self.recordings[k].target.heights_um.size for k, *_ in jobs]
        self.work += sum(t.work * size for t, size in zip(traces, sizes, strict=True)) / self.unit_px
        return traces

    def step(self, k: int, vector: np.ndarray) -> float:
        """Return a step that stays inside the declared range and keeps κ_min ≤ κ_max; 0 if there is none."""
        name = self.free.names[k]
        declared = fittable(self.free.base)[name]
        low, high = declared.low, declared.high
        size = max(STEP_OF_RANGE * (high - low), STEP_OF_VALUE * abs(vector[k]))
        paper = self.free.parameters(vector).paper
        if name == "shrinkage_min":
            high = paper.shrinkage_max
        if name == "shrinkage_max":
            low = paper.shrinkage_min
        if vector[k] + size <= high:
            return size
        return -size if vector[k] - size >= low else max(high - vector[k], low - vector[k], key=abs)


def fit_nuisances(columns: np.ndarray, values: np.ndarray, loss: Loss) -> tuple[np.ndarray, np.ndarray]:
    """Return the coefficients that cost least, by reweighting, and what they leave of the values."""
    if not columns.shape[1]:
        return np.zeros(0), values
    weights = np.ones_like(values)
    for _ in range(30):
        root = np.sqrt(weights)
        found = np.linalg.lstsq(columns * root[:, None], values * root, rcond=None)[0]
        left = values - columns @ found
        weights, before = loss.weights(left), weights
        if np.abs(weights - before).max() < 1e-4:
            break
    return found, left


def project(columns: np.ndarray, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Remove from every column of values what the nuisance columns explain, by weighted least squares."""
    if not columns.shape[1]:
        return values
    root = np.sqrt(weights)[:, None]
    return values - columns @ np.linalg.lstsq(columns * root, values * root, rcond=None)[0]

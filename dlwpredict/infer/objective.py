"""The objective: −2 ln L of whitened residuals plus declared priors, with everything that a descent needs of it.

Nuisances of a recording are linear, so their best values are found at every place of the parameters (variable
projection; Golub & Pereyra, SIAM J. Numer. Anal. 10, 413, 1973); a shift alone is followed along its own path.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from dlwpredict.infer import priors
from dlwpredict.infer.free import Free, fittable
from dlwpredict.infer.priors import PARAMETERS, Prior
from dlwpredict.infer.registration import registered
from dlwpredict.infer.rows import Rows
from dlwpredict.infer.trace import Trace, trace
from dlwpredict.infer.whitened import Whitened
from dlwpredict.model.levels import Levels
from dlwpredict.parameters import ParameterSet

STEP_OF_RANGE = 0.003
"""Step of a finite difference, in units of the declared range ..."""
STEP_OF_VALUE = 0.02
"""... or of the value, whichever is larger: large against the 1 nm by which the levels of the fast path may jump."""

AT_END = 1e-6
"""Share of its range by which a parameter lies at an end of it."""


def nothing(*_: object) -> None:
    """Do nothing."""


@dataclass(eq=False)
class Work:
    """Predictions of all recordings on their working pixels that were spent; cheaper ones count by their share.

    Parameters
    ----------
    predictions : float
    stop : callable
        Asked before every prediction; what it raises ends the work.
    seen : function of Fit
        Shown every place that is looked at.
    """

    predictions: float = 0.0
    stop: Callable[[], None] = nothing
    seen: Callable[[Fit], None] = nothing


@dataclass(frozen=True, eq=False)
class Nuisances:
    """Orthonormal basis of every recording's whitened nuisances, rows of their priors included.

    Parameters
    ----------
    rows : Rows
    above : tuple of numpy.ndarray, shape (points, columns)
    below : tuple of numpy.ndarray, shape (priors, columns)
    """

    rows: Rows
    above: tuple[np.ndarray, ...]
    below: tuple[np.ndarray, ...]

    def __bool__(self) -> bool:
        """Whether the bases are kept: a light fit has none."""
        return bool(self.above)

    def beside(self, values: np.ndarray) -> np.ndarray:
        """Return values (rows, ...) projected orthogonally to the nuisances."""
        left = np.array(values, dtype=np.result_type(values, np.float32))
        for k, above, below in zip(range(self.rows.recordings), self.above, self.below, strict=True):
            data, prior = self.rows.of(k), self.rows.nuisance_priors(k)
            along = above.T @ values[data] + below.T @ values[prior]
            left[data] -= above @ along
            left[prior] -= below @ along
        return left

    def triangle(self, values: np.ndarray) -> np.ndarray:
        """Return values (rows, columns) beside the nuisances as a triangle with the same scalar products."""
        triangle: np.ndarray = np.linalg.qr(self.beside(values), mode="r")  # type: ignore[assignment]  # NumPy's stub
        return triangle


@dataclass(frozen=True, eq=False)
class Fit:
    """A process and its residuals on whitened recordings, at any parameter values, not only at the minimum.

    Parameters
    ----------
    data : tuple of Whitened
        With the registration found.
    free : Free
        What may move.
    vector : numpy.ndarray, shape (parameters,)
    traces : tuple of Trace
        The prediction of every recording.
    rows : Rows
    residual : numpy.ndarray, shape (rows,)
        Whitened, beside the nuisances.
    nuisances : Nuisances
    coefficients : tuple of numpy.ndarray, shape (nuisances,)
        What each recording's nuisances came out as.
    jacobian : numpy.ndarray, shape (rows, parameters)
        Whitened derivatives of the predictions; zeros where none were taken.
    promise : float
        By how much the next step would lower the cost to first order, where a descent was given up; 0 where it has
        converged or that is not known.
    """

    data: tuple[Whitened, ...]
    free: Free
    vector: np.ndarray
    traces: tuple[Trace, ...]
    rows: Rows
    residual: np.ndarray
    nuisances: Nuisances
    coefficients: tuple[np.ndarray, ...]
    jacobian: np.ndarray
    promise: float = 0.0

    @cached_property
    def cost(self) -> float:
        """−2 ln L plus priors, up to a constant."""
        return float(self.residual @ self.residual)

    @property
    def light(self) -> Fit:
        """The fit without Jacobian, bases of the nuisances and intermediate states: values, residual and cost."""
        traces, jacobian = tuple(trace.bare for trace in self.traces), np.zeros((0, len(self.vector)))
        return replace(self, traces=traces, jacobian=jacobian, nuisances=Nuisances(self.rows, (), ()))

    @cached_property
    def parameters(self) -> ParameterSet:
        """The process as fitted."""
        return self.free.parameters(self.vector)

    @cached_property
    def unbound(self) -> list[int]:
        """Places of the parameters that can answer a small change: those not held at an end of their range.

        Where the objective still falls beyond the end, a parameter stays there (an active bound).
        """
        (down, up), downhill = self.free.reach(self.vector), self.jacobian.T @ self.residual
        least = AT_END * (self.free.high - self.free.low)
        held = ((down > -least) & (downhill < 0)) | ((up < least) & (downhill > 0))
        return np.flatnonzero(~held).tolist()

    @cached_property
    def tangents(self) -> np.ndarray:
        """Orthonormal basis of what can move, projected orthogonally to the nuisances, shape (rows, columns)."""
        beside = self.nuisances.beside(self.jacobian[:, self.unbound])
        scale = np.linalg.norm(beside, axis=0)
        left, sizes, _ = np.linalg.svd(beside / np.where(scale > 0, scale, 1), full_matrices=False)
        return left[:, sizes > 1e-6]

    def beside(self, values: np.ndarray) -> np.ndarray:
        """Return values (rows, ...) projected orthogonally to all that the fit may move: nuisances and parameters."""
        left = self.nuisances.beside(values)
        tangents = self.tangents.astype(left.dtype)
        for _ in range(2):
            left -= tangents @ (tangents.T @ left)
        return left

    def predicted_um(self, k: int) -> np.ndarray:
        """Return the prediction of recording k with its nuisances, as the instrument would show it."""
        item, predicted = self.data[k], self.traces[k].heights_um
        return item.moved(predicted) + np.tensordot(self.coefficients[k], item.nuisance_maps(predicted), axes=1)

    def seen(self, k: int, changes_um: np.ndarray) -> np.ndarray:
        """Whiten changes of the prediction of recording k (..., rows, cols) where registration has put it."""
        return self.data[k].white(self.data[k].registered(changes_um, self.coefficients[k]))

    def seen_in_all(self, changes_um: Sequence[np.ndarray]) -> np.ndarray:
        """Whiten changes of the predictions, one (..., rows, cols) for each recording; shape (rows, ...)."""
        return self.rows.stack([self.seen(k, changes) for k, changes in enumerate(changes_um)])

    def residual_um(self, k: int) -> np.ndarray:
        """Return recording − prediction with nuisances, NaN where a point does not count, shape (rows, cols)."""
        recording = self.data[k].recording
        return np.where(recording.used, recording.measured.heights_um - self.predicted_um(k), np.nan)

    def residuals_um(self) -> list[np.ndarray]:
        """Return the residual of every recording, 0 where a point does not count, shape (rows, cols) each."""
        return [np.nan_to_num(self.residual_um(k)) for k in range(len(self.data))]

    def rmse_um(self) -> float:
        """Root mean square of the residual over all points that count, µm."""
        values = np.concatenate([self.residual_um(k)[item.recording.used] for k, item in enumerate(self.data)])
        return float(np.sqrt(np.mean(values**2)))

    @cached_property
    def estimators(self) -> np.ndarray:
        """What the free parameters answer to whitened values, nuisances marginalised, shape (rows, parameters).

        Their lengths are the standard deviations, where the noise is known.
        """
        beside = self.nuisances.beside(self.jacobian)
        scale = np.maximum(np.linalg.norm(beside, axis=0), 1e-12)
        beside /= scale
        return beside @ np.linalg.pinv(beside.T @ beside, rcond=1e-10, hermitian=True) / scale


@dataclass(eq=False)
class Objective:
    """Whitened recordings and priors, and what they make of a process.

    Parameters
    ----------
    data : tuple of Whitened
    known : mapping of str to Prior
        Priors of parameters.
    work : Work
    numerics : Levels
    explained : float
        2 ln L that some model has beyond another: what models are told apart by goes with it.
    """

    data: tuple[Whitened, ...]
    known: Mapping[str, Prior] = field(default_factory=lambda: PARAMETERS)
    work: Work = field(default_factory=Work)
    numerics: Levels = field(default_factory=Levels)
    explained: float = 0.0

    @cached_property
    def rows(self) -> Rows:
        """The layout of the rows."""
        bounded = [len(priors.bounded(item.nuisances)) for item in self.data]
        return Rows(tuple(item.recording.points for item in self.data), tuple(bounded), len(PARAMETERS))

    def at(self, free: Free, vector: np.ndarray, near: Fit | None = None) -> Fit:
        """Predict every recording, and find its nuisances; there are no derivatives.

        Parameters
        ----------
        free : Free
        vector : numpy.ndarray, shape (parameters,)
        near : Fit, optional
            An earlier fit: what the change does not touch is taken over, and registration begins where it ended.
        """
        vector = np.array(vector)
        process = free.parameters(vector)
        data = near.data if near else self.data
        before = near.traces if near else [None] * len(data)
        traces = self.traces((k, process, old) for k, old in enumerate(before))
        solutions = [registered(item, predicted.heights_um) for item, predicted in zip(data, traces, strict=True)]
        rows, residual = self.rows, np.zeros(self.rows.total)
        for k, solution in enumerate(solutions):
            residual[rows.of(k)], residual[rows.nuisance_priors(k)] = solution.residual, solution.prior
        residual[rows.parameter_priors] = priors.rows(free, vector, self.known)[0]
        nuisances = Nuisances(rows, tuple(s.above for s in solutions), tuple(s.below for s in solutions))
        fit = Fit(
            tuple(solution.item for solution in solutions),
            free,
            vector,
            tuple(traces),
            rows,
            residual,
            nuisances,
            tuple(solution.coefficients for solution in solutions),
            np.zeros((rows.total, len(vector))),
        )
        self.work.seen(fit)
        return fit

    def whole(self, fit: Fit) -> Fit:
        """Return a fit with its predictions and derivatives; itself where it has them."""
        return fit if fit.nuisances else self.differentiated(self.at(fit.free, fit.vector, fit))

    def differentiated(self, now: Fit, known: Fit | None = None) -> Fit:
        """Return the fit with whitened derivatives by its parameters; those that an earlier fit has are taken over."""
        names = now.free.names
        have = dict(zip(known.free.names, known.jacobian.T, strict=True)) if known else {}
        missing = [k for k, name in enumerate(names) if name not in have]
        jacobian = np.zeros((self.rows.total, len(names)))
        for k, name in enumerate(names):
            if name in have:
                jacobian[:, k] = have[name]
        if missing:
            parts = [now.seen(k, maps) for k, maps in enumerate(self.derivatives(now, missing))]
            jacobian[:, missing] = self.rows.stack(parts)
        jacobian[self.rows.parameter_priors] = priors.rows(now.free, now.vector, self.known)[1]
        return replace(now, jacobian=jacobian)

    def derivatives(self, now: Fit, chosen: Sequence[int]) -> list[np.ndarray]:
        """Return derivatives of every recording's prediction by some of the parameters, µm: (chosen, rows, cols)."""
        jobs, places = [], []
        maps = [np.zeros((len(chosen), *item.recording.target.shape)) for item in now.data]
        for row, k in enumerate(chosen):
            size = step(now.free, k, now.vector)
            if size:
                moved = now.free.parameters(now.vector + size * np.eye(len(now.vector))[k])
                jobs += [(i, moved, old) for i, old in enumerate(now.traces)]
                places += [(i, row, size) for i in range(len(now.traces))]
        for (i, row, size), new in zip(places, self.traces(jobs), strict=True):
            maps[i][row] = np.nan_to_num(new.heights_um - now.traces[i].heights_um) / size
        return maps

    def traces(self, jobs: Iterable[tuple[int, ParameterSet, Trace | None]]) -> list[Trace]:
        """Predict recordings with processes, each from an earlier prediction of the same recording."""
        whole, traces = sum(item.recording.target.heights_um.size for item in self.data), []
        for k, process, before in jobs:
            self.work.stop()
            target = self.data[k].recording.target
            traces.append(trace(target, process, self.numerics, before))
            self.work.predictions += traces[-1].work * target.heights_um.size / whole
        return traces


def step(free: Free, k: int, vector: np.ndarray) -> float:
    """Return a step that stays inside the declared range and keeps κ_min ≤ κ_max; 0 if there is none."""
    name = free.names[k]
    declared = fittable(free.base)[name]
    low, high = declared.low, declared.high
    size = max(STEP_OF_RANGE * (high - low), STEP_OF_VALUE * abs(vector[k]))
    paper = free.parameters(vector).paper
    if name == "shrinkage_min":
        high = paper.shrinkage_max
    if name == "shrinkage_max":
        low = paper.shrinkage_min
    if vector[k] + size <= high:
        return size
    return -size if vector[k] - size >= low else max(high - vector[k], low - vector[k], key=abs)

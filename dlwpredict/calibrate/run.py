"""`calibrate`: from pairs of target and recording to parameters with intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from dlwpredict.calibrate.descend import descend
from dlwpredict.calibrate.fast import GAIN, fast
from dlwpredict.calibrate.holdout import Holdout, hold_out
from dlwpredict.calibrate.intervals import Information, inform, linear_interval, noises_of, open_directions
from dlwpredict.calibrate.problem import Point, Problem
from dlwpredict.calibrate.profile import profile_intervals
from dlwpredict.calibrate.recordings import Recording, check_points
from dlwpredict.calibrate.simplex import simplex
from dlwpredict.calibrate.words import WEAK_SHARE, identified, warnings_of
from dlwpredict.flat import Free
from dlwpredict.noise import Noise
from dlwpredict.parameters import ParameterSet

Method = Literal["simplex", "fast"]


@dataclass(frozen=True, eq=False)
class Calibration:
    """Calibrated parameters and how well they are known.

    Parameters
    ----------
    free : Free
        What was fitted, from where, within which bounds.
    problem : Problem
        The recordings, with the loss at the end.
    start, point : Point
        Before and after.
    jacobian : tuple of numpy.ndarray, shape (points, parameters)
        At the end, nuisances projected out.
    information : Information
    noises : list of Noise
        One per recording.
    intervals : numpy.ndarray, shape (parameters, 2)
        95 %.
    profiled : tuple of str
        Parameters whose interval is from the likelihood profile; the others' are linear.
    directions : list of dict
        What the data leave open.
    holdout : Holdout
    warnings : list of str
    work : dict
        Predictions of all recordings at full resolution, spent on the fit and on everything.
    """

    free: Free
    problem: Problem
    start: Point
    point: Point
    jacobian: tuple[np.ndarray, ...]
    information: Information
    noises: list[Noise]
    intervals: np.ndarray
    profiled: tuple[str, ...]
    directions: list[dict[str, float]]
    holdout: Holdout
    warnings: list[str]
    work: dict[str, float]

    @property
    def parameters(self) -> ParameterSet:
        """The calibrated process, with bounds and intervals."""
        found = self.free.parameters([_rounded(v) for v in self.point.vector])
        return replace(
            found,
            bounds=found.bounds | _ranges(self.free.names, np.stack([self.free.low, self.free.high], axis=1)),
            intervals=found.intervals | _ranges(self.free.names, self.intervals),
        )

    @property
    def identified(self) -> dict[str, bool]:
        """Whether the data determine each parameter."""
        known = identified(self.free, self.point.vector, self.intervals)
        return dict(zip(self.free.names, known.tolist(), strict=True))


def calibrate(
    recordings: Sequence[Recording],
    free: Free,
    *,
    method: Method = "fast",
    robust: bool = True,
    free_shift: bool = True,
    profile: bool | None = None,
    seed: int = 0,
    watch: Callable[[Point], None] | None = None,
) -> Calibration:
    """Fit one parameter set to all recordings.

    Parameters
    ----------
    recordings : sequence of Recording
        From `prepare`.
    free : Free
        From `choose`.
    method : {"fast", "simplex"}
        Bounded least squares, or the paper's Downhill Simplex.
    robust : bool
        Huber's loss against spikes, its scale from the residuals; else squares.
    free_shift : bool
        Let each recording be shifted laterally, to first order: what registration leaves must not bend the parameters.
    profile : bool, optional
        Take intervals from the likelihood profile for the parameters that are weakly known or at a bound; None does so
        for the worst one (which widens the others' as it goes).
    seed : int
        Of the further starts and of the drawn noise.
    watch : function of Point, optional
        Called with every point at full resolution.

    Raises
    ------
    ResultError
        Too few points.
    """
    check_points(recordings)
    problem = Problem(tuple(recordings), free, watch=watch)
    start = problem.at(free.start)
    problem, point = _fitted(problem, start, method, robust, free_shift, seed)
    fit_work = problem.work
    jacobian = problem.jacobian(point)
    found = noises_of(problem.recordings, point)
    information, noises = inform(problem.recordings, free, point, jacobian, found, seed=seed)
    intervals = linear_interval(free, point.vector, information)
    profiled = _to_profile(free, point.vector, intervals, profile)
    intervals = profile_intervals(problem, point, jacobian, information, noises, chosen=profiled, linear=intervals)
    directions = open_directions(free, information)
    return Calibration(
        free,
        problem,
        problem.compared(start.vector, start.traces),
        point,
        jacobian,
        information,
        noises,
        intervals,
        tuple(free.names[k] for k in profiled),
        directions,
        hold_out(problem.recordings, free, point, jacobian, noises),
        warnings_of(free, problem.recordings, point, intervals, directions),
        {"fit": fit_work, "all": problem.work},
    )


def _fitted(
    problem: Problem, start: Point, method: Method, robust: bool, free_shift: bool, seed: int
) -> tuple[Problem, Point]:
    """Fit; then once more from there, with the loss scaled by what was left and the shifts freed about it.

    The second loss is not the first: where the start costs less in it, the start it is.
    """
    problem = problem.with_loss_scaled(start, robust=robust)
    point = problem.compared(start.vector, start.traces)
    point = simplex(problem, point) if method == "simplex" else fast(problem, point, seed=seed)
    if robust or free_shift:
        problem = problem.with_loss_scaled(point, robust=robust)
        if free_shift:
            problem = problem.with_free_shift(point)
        point = problem.compared(point.vector, point.traces)
        point = simplex(problem, point) if method == "simplex" else descend(problem, point, gain=GAIN, iterations=40)
    return problem, min(point, problem.compared(start.vector, start.traces), key=lambda place: place.cost)


def _to_profile(free: Free, vector: np.ndarray, intervals: np.ndarray, profile: bool | None) -> list[int]:
    """Return the parameters whose linear interval cannot be trusted, the worst first."""
    if profile is False:
        return []
    reach = np.abs(intervals - vector[:, None]).max(axis=1) / np.maximum(np.abs(vector), 1e-9)
    edge = 1e-3 * (free.high - free.low)
    reach[(vector - free.low < edge) | (free.high - vector < edge)] = np.inf
    worst = [int(k) for k in np.argsort(-reach, kind="stable") if reach[k] > WEAK_SHARE]
    return worst if profile else worst[:1]


def _ranges(names: Sequence[str], ranges: np.ndarray) -> dict[str, tuple[float, float]]:
    return {name: (_rounded(low), _rounded(high)) for name, (low, high) in zip(names, ranges, strict=True)}


def _rounded(value: Any) -> float:
    """Return nine significant digits, so that a last bit of arithmetic does not show in a file."""
    return float(f"{float(value):.9g}")

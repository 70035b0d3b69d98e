"""`calibrate`: from pairs of target and recording to parameters with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from dlwpredict.calibration.simplex import simplex
from dlwpredict.calibration.words import identified, warnings_of
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer import held_out
from dlwpredict.infer.baseline import derivatives_um, fitter_of, rewhitened, rough
from dlwpredict.infer.fitter import Start
from dlwpredict.infer.free import Free
from dlwpredict.infer.intervals import NORMAL, Intervals, curved
from dlwpredict.infer.intervals import intervals as intervals_of
from dlwpredict.infer.noises import noises, plane
from dlwpredict.infer.null import Null
from dlwpredict.infer.objective import Fit, Objective, Work
from dlwpredict.infer.priors import PARAMETERS
from dlwpredict.infer.recording import Recording, check_points
from dlwpredict.infer.whitened import steepness
from dlwpredict.noise.estimate import NoiseEstimate
from dlwpredict.parameters import ParameterSet

Method = Literal["simplex", "fast"]

BLOCKS_A_SIDE = 2
"""Every map is cut at least so often along each side, small or not, to be predicted block by block."""

OPEN_SHARE = 0.1
"""A direction is open where its 95 % interval is longer than this share of the bounds either way."""

OPEN_WIDTHS = 1e3
"""Standard deviation, in widths of the bounds, of what nothing tells: as good as infinite."""


@dataclass(frozen=True)
class Holdout:
    """Error on blocks that were left out.

    Parameters
    ----------
    rmse_um : float
        Over all blocks, µm; NaN where too few points are left for two.
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

    @classmethod
    def of(cls, fitted: Fit) -> Holdout:
        """Leave out every block in turn."""
        left_out, counts = held_out.blocks(fitted, BLOCKS_A_SIDE), held_out.cuts(fitted, BLOCKS_A_SIDE)
        sizes = [item.recording.target.size_um for item in fitted.data]
        sides = tuple(float(min(np.divide(size, count))) for size, count in zip(sizes, counts, strict=True))
        rmse_um, folds = (left_out.rmse_um, len(left_out.points)) if left_out else (np.nan, 0)
        return cls(rmse_um, folds, sides, held_out.BUFFER_UM)


@dataclass(frozen=True, eq=False)
class Calibration:
    """Calibrated parameters and how well they are known.

    Parameters
    ----------
    free : Free
        What was fitted, from where, within which bounds.
    recordings : tuple of Recording
        Without spikes, where these were left out.
    noises : tuple of NoiseEstimate
        One per recording.
    start, end : Fit
        Before and after, both beside these noises.
    intervals : Intervals
        95 %.
    correlation : numpy.ndarray, shape (parameters, parameters)
        Of the estimates.
    directions : list of dict
        What is left open.
    identified : dict
        Whether the data determine each parameter.
    holdout : Holdout
    warnings : list of str
    work : dict
        Predictions of all recordings, spent on the fit and on everything.
    """

    free: Free
    recordings: tuple[Recording, ...]
    noises: tuple[NoiseEstimate, ...]
    start: Fit
    end: Fit
    intervals: Intervals
    correlation: np.ndarray
    directions: list[dict[str, float]]
    identified: dict[str, bool]
    holdout: Holdout
    warnings: list[str]
    work: dict[str, float]

    def maps(self, k: int) -> tuple[HeightMap, HeightMap, np.ndarray]:
        """Return recording k, what is free about its height taken off, its prediction, and the residual, µm.

        The residual, shape (rows, cols), is NaN where a point does not count.
        """
        recording, residual_um = self.recordings[k], self.end.residual_um(k)
        predicted, measured = recording.target.with_heights(self.end.traces[k].heights_um), recording.measured
        offset_um = np.median((measured.heights_um - predicted.heights_um - residual_um)[recording.used])
        return measured.with_heights(measured.heights_um - offset_um), predicted, residual_um

    def summary(self) -> str:
        """Say the errors before and after, and every parameter with its interval, a line each."""
        left_out = f"left-out blocks {self.holdout.rmse_um:.4f} µm" if self.holdout.folds else "no blocks to leave out"
        errors = f"rmse {self.start.rmse_um():.4f} -> {self.end.rmse_um():.4f} µm ({left_out})"
        lines = [f"{errors}, {self.work['fit']:.0f} predictions' worth of work"]
        for name, value, (low, high) in zip(self.free.names, self.end.vector, self.intervals.ends, strict=True):
            known = f"95 % {low:.4f} to {high:.4f}" if high > low else "at its bound"
            lines.append(f"  {name:<24} {value:8.4f}  {known}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"Calibration: {self.summary()}"

    @property
    def parameters(self) -> ParameterSet:
        """The calibrated process, with bounds and intervals."""
        rounded = np.array([_rounded(v) for v in self.end.vector])
        process, names = self.free.parameters(self.free.allowed(rounded)), self.free.names
        bounds = zip(self.free.low, self.free.high, strict=True)
        return replace(
            process,
            bounds=process.bounds | _ranges(dict(zip(names, bounds, strict=True))),
            intervals=process.intervals | _ranges(self.intervals.as_dict()),
        )


def calibrate(
    recordings: Sequence[Recording],
    free: Free,
    *,
    method: Method = "fast",
    robust: bool = True,
    priors: bool = True,
    profile: bool | None = None,
    seed: int = 0,
    work: Work | None = None,
) -> Calibration:
    """Fit one parameter set to all recordings.

    A fit as if noise were white; noise and model error from what it leaves; then the likelihood, with priors.

    Parameters
    ----------
    recordings : sequence of Recording
        From `prepare`.
    free : Free
        From `choose`.
    method : {"fast", "simplex"}
        By the likelihood, or the paper's: lowest root mean square error by Downhill Simplex, without priors.
    robust : bool
        Leave out spikes.
    priors : bool
        Use what is known of parameters beforehand.
    profile : bool, optional
        Take intervals from the likelihood profile wherever a straight line will not do; None does so for the worst one.
    seed : int
        Of the drawn noise.
    work : Work, optional
        Counts the predictions, and is shown every place that is looked at.

    Raises
    ------
    ResultError
        Too few points.
    """
    check_points(recordings)
    known, work = PARAMETERS if priors and method == "fast" else {}, work or Work()
    if method == "simplex":
        recordings, first = simplex(recordings, free, work, spikes=robust)
    else:
        recordings, first = rough(recordings, free, known, work, spikes=robust)
    slopes = [steepness(trace.heights_um, r.target) for trace, r in zip(first.traces, recordings, strict=True)]
    noise = noises(recordings, first.residuals_um(), _absorbed(first), slopes=slopes, seed=seed)
    models = [estimate.model for estimate in noise]
    fitter = fitter_of(recordings, models, slopes, first, Objective(first.data, known, work))
    objective = fitter.objective
    start, end = objective.at(free, free.start), rewhitened(first, objective)
    if method == "fast":
        begun = end if end.cost <= start.cost else objective.differentiated(start)
        end = fitter.best(Start(begun.parameters, begun))
    spent, later = work.predictions, Work()
    null = Null.of(end.data, objective.rows, noise, seed)
    intervals = _intervals(end, null, replace(objective, work=later), profile)
    correlation = _correlation(end)
    directions = _open_directions(free, intervals.sd, correlation)
    determined = identified(free, end.vector, intervals, known)
    return Calibration(
        free,
        tuple(recordings),
        tuple(noise),
        start,
        end,
        intervals,
        correlation,
        directions,
        dict(zip(free.names, determined.tolist(), strict=True)),
        Holdout.of(end),
        warnings_of(end, intervals, determined, directions),
        {"fit": spent, "all": spent + later.predictions},
    )


def _absorbed(first: Fit) -> list[np.ndarray]:
    """Return what a fit takes from each recording's residual, shape (columns, rows, cols); all else is noise.

    What the model has wrong is noise of a long correlation.
    """
    designs = []
    for item, trace, derivatives in zip(first.data, first.traces, derivatives_um(first), strict=True):
        nuisances = item.nuisance_maps(trace.heights_um)
        designs.append(np.concatenate([plane(item.recording.target), derivatives, nuisances]))
    return designs


def _intervals(end: Fit, null: Null, objective: Objective, profile: bool | None) -> Intervals:
    """Return the intervals, those of the parameters that need it, or of the worst of them, from the profile."""
    straight = intervals_of(end, null)
    if profile is False:
        return straight
    worst = sorted(curved(end, straight.sd), key=lambda k: -straight.sd[k] / max(abs(end.vector[k]), 1e-9))
    return intervals_of(end, null, objective, [end.free.names[k] for k in (worst if profile else worst[:1])])


def _correlation(end: Fit) -> np.ndarray:
    """Return how the estimates go together; one that nothing tells goes with no other."""
    products = end.estimators.T @ end.estimators
    lengths = np.sqrt(np.diag(products))
    scale = np.where(lengths > 0, lengths, 1)
    return np.where(np.eye(len(lengths), dtype=bool), 1.0, products / np.outer(scale, scale))


def _open_directions(free: Free, sd: np.ndarray, correlation: np.ndarray) -> list[dict[str, float]]:
    """Return the directions that are left open, the widest first.

    Each is a change of parameters, name to µm or 1, one 95 % reach long; parameters that take little part are left
    out. They are the eigenvectors of the covariance in units of the bounds, which stand in it as a wide prior.
    """
    width = free.high - free.low
    spread = np.minimum(sd / width, OPEN_WIDTHS)
    covariance = correlation * np.outer(spread, spread)
    values, vectors = np.linalg.eigh(covariance)
    values = values / (1 + np.maximum(values, 0))
    directions = []
    for value, vector in zip(values[::-1], vectors.T[::-1], strict=True):
        reach = NORMAL * np.sqrt(max(value, 0))
        if reach < OPEN_SHARE:
            break
        sign = np.sign(vector[np.argmax(np.abs(vector))])
        part = np.abs(vector) > 0.15 * np.abs(vector).max()
        directions.append({free.names[k]: float(sign * vector[k] * reach * width[k]) for k in np.flatnonzero(part)})
    return directions


def _ranges(ranges: dict[str, tuple[Any, Any]]) -> dict[str, tuple[float, float]]:
    return {name: (_rounded(low), _rounded(high)) for name, (low, high) in ranges.items()}


def _rounded(value: Any) -> float:
    """Return nine significant digits, so that a last bit of arithmetic does not show in a file."""
    return float(f"{float(value):.9g}")

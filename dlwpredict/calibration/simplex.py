"""The paper's way down: the simplex of Nelder and Mead on the root mean square error, with bounds and restarts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from dlwpredict.infer.baseline import inliers
from dlwpredict.infer.free import Free
from dlwpredict.infer.noises import white
from dlwpredict.infer.objective import Fit, Objective, Work
from dlwpredict.infer.priors import LEVELLING, SHIFTS
from dlwpredict.infer.recording import Recording
from dlwpredict.infer.whitened import Whitened

QUIET_UM = 1e-3
"""White noise so weak that priors of nuisances have no say: they are fitted by plain least squares."""

TOLERANCE = 1e-4
"""A run ends when all corners agree to this in rmse (µm) and in every parameter (units of its start value, or of a
hundredth of its range where that is larger): the defaults of MATLAB's fminsearch, since the paper states no rule."""

EVALUATIONS_PER_PARAMETER = 200
"""Most predictions per run and parameter, as in fminsearch."""

MOST_RUNS = 4
"""Runs from the best place so far; the next one starts only if the last one gained more than `TOLERANCE` in rmse."""


def simplex(
    recordings: Sequence[Recording], free: Free, work: Work, *, spikes: bool = True
) -> tuple[tuple[Recording, ...], Fit]:
    """Minimise the root mean square error; offset, tilt and shift, where they are free, are fitted at every place.

    Parameters
    ----------
    recordings : sequence of Recording
    free : Free
    work : Work
    spikes : bool
        Leave out what stands out of the residual, lone points and scars of a scan, and fit again.

    Returns
    -------
    tuple of Recording
        Without their spikes and scars.
    Fit
        With derivatives.
    """
    objective = _plain(recordings, work)
    best = _restarted(objective, objective.at(free, free.start))
    if spikes:
        recordings = inliers(best)
        objective = _plain(recordings, work)
        best = _restarted(objective, objective.at(free, best.vector))
    return tuple(recordings), objective.differentiated(best)


def _plain(recordings: Sequence[Recording], work: Work) -> Objective:
    """Return the sum of squares of the residual, in units of `QUIET_UM`²."""
    few = [replace(r, nuisances=tuple(n for n in r.nuisances if n in (*LEVELLING, *SHIFTS))) for r in recordings]
    return Objective(tuple(Whitened.of(r, white(r, QUIET_UM)) for r in few), {}, work)


def _restarted(objective: Objective, best: Fit) -> Fit:
    for _ in range(MOST_RUNS):
        before, best = best, _run(objective, best)
        if _rmse_um(before) - _rmse_um(best) < TOLERANCE:
            break
    return best


def _run(objective: Objective, start: Fit) -> Fit:
    """Return the best place of one run; corners lie 5 % off the start, inside the bounds."""
    free, best = start.free, start
    unit = np.maximum(np.abs(start.vector), 0.01 * (free.high - free.low))

    def cost(scaled: np.ndarray) -> float:
        nonlocal best
        vector = scaled * unit
        inside = free.allowed(vector)
        place = objective.at(free, inside, best)
        best = min(best, place, key=lambda fit: fit.cost)
        return _rmse_um(place) + float(np.abs((inside - vector) / unit).sum())

    corners = [start.vector]
    for step in 0.05 * np.diag(unit):
        up = start.vector + step
        corners.append(up if np.array_equal(free.allowed(up), up) else free.allowed(start.vector - step))
    minimize(
        cost,
        corners[0] / unit,
        method="Nelder-Mead",
        bounds=list(zip(free.low / unit, free.high / unit, strict=True)),
        options={
            "initial_simplex": np.array(corners) / unit,
            "xatol": TOLERANCE,
            "fatol": TOLERANCE,
            "maxfev": EVALUATIONS_PER_PARAMETER * len(unit),
        },
    )
    return best


def _rmse_um(fit: Fit) -> float:
    return QUIET_UM * float(np.sqrt(fit.cost / fit.rows.data))

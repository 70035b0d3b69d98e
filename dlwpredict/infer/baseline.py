"""The first fit: before noise is known, as if it were white; and the same once it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dlwpredict.infer.descend import descend
from dlwpredict.infer.fitter import Fitter
from dlwpredict.infer.free import Free
from dlwpredict.infer.noises import scale_um, white
from dlwpredict.infer.objective import Fit, Objective, Work
from dlwpredict.infer.priors import Prior, rows
from dlwpredict.infer.recording import Recording, coarser, keeps_most, without_outliers
from dlwpredict.infer.trace import whole
from dlwpredict.infer.whitened import Whitened
from dlwpredict.noise.unevenness import Uneven
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import predict

COARSE_UM, FEWEST_PX = 1.0, 40
"""The first descent is on pixels of at most this width, unless that leaves a map fewer pixels a side."""

GAIN = 1e-3
"""A rough descent ends when a step promises less than this share of the cost: the noise is not known any better."""


def rough(
    recordings: Sequence[Recording],
    free: Free,
    known: Mapping[str, Prior],
    work: Work,
    *,
    spikes: bool = True,
) -> tuple[tuple[Recording, ...], Fit]:
    """Fit as if noise were white: first on coarse pixels, then on those of the recordings, without spikes.

    Coarse pixels are left out where most of what counts would be lost: between many walls.

    Parameters
    ----------
    recordings : sequence of Recording
    free : Free
    known : mapping of str to Prior
    work : Work
    spikes : bool
        Leave out what stands out of the residual: lone points, and scars of a scan.

    Returns
    -------
    tuple of Recording
        Without their spikes and scars.
    Fit
        With derivatives.
    """
    start, factor = free.base, _factor(recordings)
    predicted = [predict(r.target, whole(start), as_measured=True).heights_um for r in recordings]
    work.predictions += 1
    left = [(r.measured.heights_um - p)[r.used] for r, p in zip(recordings, predicted, strict=True)]
    sigmas, coarse_work = [scale_um(values - np.median(values)) for values in left], Work(stop=work.stop)
    coarse = [coarser(r, factor) for r in recordings]
    if factor > 1 and all(keeps_most(r, wide, factor) for r, wide in zip(recordings, coarse, strict=True)):
        for _ in range(2):
            fit = _white(coarse, sigmas, start, free, known, coarse_work)
            start, sigmas = fit.parameters, _left(fit)
        work.predictions += coarse_work.predictions / factor**2
    fit = _white(recordings, sigmas, start, free, known, work)
    if spikes:
        kept = inliers(fit)
        if any(a.points != b.points for a, b in zip(recordings, kept, strict=True)):
            recordings = kept
    objective = Objective(_whitened(recordings, _left(fit)), known, work)
    return tuple(recordings), descend(objective, rewhitened(fit, objective), gain=GAIN * objective.rows.data)


def inliers(fit: Fit) -> list[Recording]:
    """Return the recordings of a fit without spikes and scars, judged by what it leaves of them."""
    pairs = enumerate(zip(fit.data, fit.residuals_um(), strict=True))
    return [without_outliers(item.recording, residual, fit.predicted_um(k)) for k, (item, residual) in pairs]


def unsaid(start: ParameterSet) -> ParameterSet:
    """Return a process whose pixels may be points or squares, unless the file says squares.

    A focus of 0.6 µm on pixels of 0.5 µm is 0.7 µm wide if they are points. Which they are changes a print by 0.1 nm,
    which no recording shows, and the strength of what acts on the focus by a third.
    """
    readings = start.readings
    return replace(start, readings=replace(readings, pixels="either")) if readings.pixels == "points" else start


def fitter_of(
    recordings: Sequence[Recording],
    models: Sequence[Uneven],
    slopes: Sequence[np.ndarray | float],
    before: Fit,
    objective: Objective,
    **knobs: Any,
) -> Fitter:
    """Return a fitter with these noise models, whose registration is that of an earlier fit.

    Parameters
    ----------
    recordings : sequence of Recording
    models : sequence of Uneven
    slopes : sequence of numpy.ndarray, shape (rows, cols), or 0
        |∇f| of each recording, on which its noise may hang.
    before : Fit
    objective : Objective
        Has the priors, and counts the work.
    **knobs
        Of `Fitter`.
    """
    data = tuple(
        replace(Whitened.of(recording, noise, slope), place=item.place)
        for recording, noise, slope, item in zip(recordings, models, slopes, before.data, strict=True)
    )
    return Fitter(replace(objective, data=data), before.free, **knobs)


def derivatives_um(fit: Fit) -> list[np.ndarray]:
    """Return the derivatives of every recording where it is used, µm, shape (parameters, rows, cols); 0 elsewhere."""
    pairs = zip(fit.data, fit.rows.split(fit.jacobian), strict=True)
    return [item.recording.on_map(item.whitener.solve(columns).T) for item, columns in pairs]


def rewhitened(fit: Fit, objective: Objective) -> Fit:
    """Return a fit at its place beside other whiteners of the same points or of some of them, with its derivatives."""
    now = objective.at(fit.free, fit.vector, replace(fit, data=objective.data))
    pairs = zip(now.data, derivatives_um(fit), strict=True)
    jacobian = objective.rows.stack([item.white(maps) for item, maps in pairs])
    jacobian[objective.rows.parameter_priors] = rows(fit.free, fit.vector, objective.known)[1]
    return replace(now, jacobian=jacobian)


def beside_white(fit: Fit) -> Fit:
    """Return a fit with its derivatives beside white noise, as strong in every recording as what it leaves there."""
    return rewhitened(fit, Objective(_whitened([item.recording for item in fit.data], _left(fit))))


def _white(
    recordings: Sequence[Recording],
    sigmas: Sequence[float],
    start: ParameterSet,
    free: Free,
    known: Mapping[str, Prior],
    work: Work,
) -> Fit:
    """Fit roughly with white noise of these strengths."""
    objective = Objective(_whitened(recordings, sigmas), known, work)
    now = objective.differentiated(objective.at(free, free.values(start)))
    return descend(objective, now, gain=GAIN * objective.rows.data)


def _whitened(recordings: Sequence[Recording], sigmas: Sequence[float]) -> tuple[Whitened, ...]:
    return tuple(Whitened.of(r, white(r, s)) for r, s in zip(recordings, sigmas, strict=True))


def _left(fit: Fit) -> list[float]:
    """Return the strength of what a fit leaves of each recording, µm."""
    pairs = zip(fit.data, fit.residuals_um(), strict=True)
    return [scale_um(residual[item.recording.used]) for item, residual in pairs]


def _factor(recordings: Sequence[Recording]) -> int:
    """Return how many pixels to average for the first descent."""
    pitch = max(max(r.target.dx_um, r.target.dy_um) for r in recordings)
    side = min(min(r.target.shape) for r in recordings)
    return max(min(int(COARSE_UM / pitch), side // FEWEST_PX), 1)

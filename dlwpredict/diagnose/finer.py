"""What a prediction changes on finer pixels: held while a fit moves, or moving along with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dlwpredict.calibrate.recordings import Recording
from dlwpredict.diagnose.baseline import discretisations_um, finer
from dlwpredict.diagnose.evidence import NUISANCES, prior_rows, stack
from dlwpredict.diagnose.fit import TO_REST, Fit, descended, differentiated, placed, problem_of
from dlwpredict.parallel import ALONE, Workers
from dlwpredict.parameters import ParameterSet

GAIN = 1.0
"""The change is taken anew at the fitted process where it differs by this energy in units of the noise."""

PIXELS = list(NUISANCES).index("pixels")


def with_own_change(fitted: Fit, workers: Workers = ALONE) -> Fit:
    """Return the fit, where it is, with the change taken there."""
    recordings = [item.recording for item in fitted.data]
    changes = discretisations_um(recordings, fitted.parameters, fitted.point.traces, workers)
    data = [replace(item, discretisation_um=change) for item, change in zip(fitted.data, changes, strict=True)]
    return placed(data, fitted.free, fitted.point.vector, fitted.point)


def on_own_pixels(fitted: Fit, workers: Workers = ALONE, better: Fit | None = None) -> Fit:
    """Return the fit with the change of the place where it is, not of that where it began.

    What a finer grid changes hangs on the focus width, and the width on what the grid is held to change: begun far from
    the truth, one wrong holds the other, with an interval much too narrow. Two places are compared each with the change
    of its own: with that of another, either may seem the better one. The derivatives are those with the change held.

    Parameters
    ----------
    fitted : Fit
    workers : Workers
    better : Fit, optional
        One with more effects: where pixels cannot make up for its lead, the fit stays as it is.
    """
    now = with_own_change(fitted, workers)
    energy, lead = _changed(fitted, now), (fitted.chi2 - better.chi2 if better else 0.0)
    if energy < GAIN or 2 * np.sqrt(fitted.chi2 * energy) < lead:  # |r − d|² ≥ |r|² − 2|r||d|, the process where it is
        return fitted
    return differentiated(problem_of(now.data, now.free), _at_rest(now, workers))


def _changed(fitted: Fit, now: Fit) -> float:
    """Return the energy of the difference between two fits' changes on finer pixels, in units of the noise."""
    pairs = zip(fitted.data, now.data, strict=True)
    return float(sum(np.sum(a.white(b.discretisation_um - a.discretisation_um) ** 2) for a, b in pairs))


def polished(fitted: Fit, workers: Workers = ALONE) -> Fit:
    """Return the fit at rest while the change moves along, with the derivatives of both.

    Where pixels are about as wide as the focus, the change hangs on the focus nearly as much as the prediction: held,
    it leaves a fit beside the lowest place, and derivatives without it give intervals up to a third too narrow.
    """
    return _at_rest(with_own_change(fitted, workers), workers)


def _at_rest(now: Fit, workers: Workers) -> Fit:
    """Descend from a fit that has the change of its place."""

    def place(vector: np.ndarray, near: Fit) -> Fit:
        return with_own_change(_moved(near, vector), workers)

    def derive(now: Fit) -> Fit:
        return _informed(now, workers)

    return descended(derive(now), place, derive, iterations=TO_REST)


def _moved(fitted: Fit, vector: np.ndarray) -> Fit:
    return placed(fitted.data, fitted.free, vector, fitted.point)


def _informed(now: Fit, workers: Workers) -> Fit:
    """Return the fit with derivatives of the prediction and of its change on finer pixels."""
    problem, vector = problem_of(now.data, now.free), now.point.vector
    sizes = [problem.step(k, vector) for k in range(len(vector))]
    moved = [now.free.parameters(place) for place in vector + np.diag(sizes)]
    risen = workers.each(_risen, [(item.recording, now.parameters, moved, sizes) for item in now.data])
    found, own, shares = differentiated(problem, now), problem.derivatives(now.point), now.coefficients[:, PIXELS]
    parts = [
        share * item.white(np.nan_to_num(fine - coarse))
        for item, share, fine, coarse in zip(now.data, shares, risen, own, strict=True)
    ]
    return replace(found, jacobian=found.jacobian + stack(parts, prior_rows(len(now.data))))


def _risen(
    recording: Recording, parameters: ParameterSet, moved: Sequence[ParameterSet], sizes: Sequence[float]
) -> np.ndarray:
    """Return derivatives of the prediction on finer pixels, shape (parameters, rows, cols)."""
    here, known = finer(recording, parameters)
    rises = [(finer(recording, one, known)[0] - here) / (size or 1) for one, size in zip(moved, sizes, strict=True)]
    return np.stack(rises)

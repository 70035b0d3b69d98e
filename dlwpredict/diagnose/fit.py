"""Maximum likelihood of parameters and nuisances together, in whitened space."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import sparse
from scipy.optimize import lsq_linear

from dlwpredict.calibrate.problem import Point, Problem
from dlwpredict.calibrate.recordings import Recording
from dlwpredict.calibrate.straight import bending, bent, straight, straight_bounds
from dlwpredict.diagnose.evidence import (
    NUISANCES,
    WIDTH_PRIOR,
    WIDTHS,
    Whitened,
    nuisance_fit,
    prior_rows,
    stack,
    width_rows,
)
from dlwpredict.flat import Free
from dlwpredict.parallel import ALONE, Workers
from dlwpredict.parameters import Paper, ParameterSet, declarations

GAIN = 0.05
"""A descent ends when the next step promises less than this in χ²."""

TRUSTED = 0.8
"""Share of the promised gain that must come true for derivatives to be updated by the secant, not computed anew."""

ITERATIONS = 8
"""Steps of a descent, at most, unless told otherwise."""

TO_REST = 4 * ITERATIONS
"""Steps of a descent that is brought to rest, at most: few need so many, along valleys that bend."""

REGISTRATIONS, REGISTERED_UM = 8, 5e-4
"""Registration is repeated at most so often, until it moves by less."""

DISTINCT = 1.0
"""Fits that differ by less than this energy, in units of the noise, have come to the same place."""

SHIFT = list(NUISANCES).index("shift_x")


@dataclass(frozen=True, eq=False)
class Fit:
    """A process fitted to whitened recordings.

    Parameters
    ----------
    data : tuple of Whitened
        With the registration found.
    free : Free
        What moved.
    point : Point
        Where it came to rest: values, and every prediction.
    jacobian : numpy.ndarray, shape (rows, parameters)
        Whitened derivatives of the predictions, rows of all recordings and of the priors.
    residual : numpy.ndarray, shape (rows,)
        Whitened residual beside the nuisances.
    nuisances : scipy.sparse.csr_array, shape (rows, nuisances)
        Orthonormal basis of the whitened nuisances.
    coefficients : numpy.ndarray, shape (recordings, nuisances)
        What the nuisances came out as.
    """

    data: tuple[Whitened, ...]
    free: Free
    point: Point
    jacobian: np.ndarray
    residual: np.ndarray
    nuisances: sparse.csr_array
    coefficients: np.ndarray

    @property
    def chi2(self) -> float:
        """Return −2 ln L up to a constant."""
        return float(self.residual @ self.residual)

    @property
    def parameters(self) -> ParameterSet:
        """The process as fitted."""
        return self.free.parameters(self.point.vector)

    @property
    def basis(self) -> np.ndarray:
        """Orthonormal basis of everything the fit may move: nuisances and parameters, shape (rows, columns)."""
        beside = self.jacobian - self.nuisances @ (self.nuisances.T @ self.jacobian)
        scale = np.linalg.norm(beside, axis=0)
        left, sizes, _ = np.linalg.svd(beside / np.where(scale > 0, scale, 1), full_matrices=False)
        return np.column_stack([self.nuisances.toarray(), left[:, sizes > 1e-6]])

    def predicted_um(self, k: int) -> np.ndarray:
        """Return the prediction of recording k with its nuisances, as the instrument would show it."""
        item, predicted = self.data[k], self.point.traces[k].heights_um
        return item.moved(predicted) + np.tensordot(self.coefficients[k], item.nuisance_maps(predicted), axes=1)

    def seen(self, k: int, changes_um: np.ndarray) -> np.ndarray:
        """Whiten changes of the prediction of recording k (..., rows, cols) where registration has put it."""
        return self.data[k].white(self.data[k].registered(changes_um, self.coefficients[k]))

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

    @property
    def estimators(self) -> np.ndarray:
        """What the free parameters answer to whitened values, nuisances marginalised, shape (rows, parameters).

        Their lengths are the standard deviations, where the noise is known.
        """
        beside = self.jacobian - self.nuisances @ (self.nuisances.T @ self.jacobian)
        scale = np.maximum(np.linalg.norm(beside, axis=0), 1e-12)
        beside /= scale
        return beside @ np.linalg.pinv(beside.T @ beside, rcond=1e-10, hermitian=True) / scale


def placed(data: Sequence[Whitened], free: Free, vector: np.ndarray, known: Point | None = None) -> Fit:
    """Predict recordings with given parameters; only nuisances are fitted, and there are no derivatives."""
    return _at(problem_of(data, free), data, vector, known)


def valleys(data: Sequence[Whitened], free: Free, starts: Sequence[np.ndarray], workers: Workers = ALONE) -> list[Fit]:
    """Fit from every start; every valley that was found once, the lowest first."""
    found = sorted(workers.each(_fit_at, [(data, free, start) for start in starts]), key=lambda one: one.chi2)
    distinct: list[Fit] = []
    for one in found:
        if all(np.sum((one.residual - lower.residual) ** 2) >= DISTINCT for lower in distinct):
            distinct.append(sharing(one, data))
    return distinct


def doubled(free: Free, vector: np.ndarray) -> list[np.ndarray]:
    """Return a place, and where a width is far from its prior, its double with the seven where the prior has them.

    Focus, threshold, cross-linking and κ act together. A model that lacks an effect may have its lowest place in
    another valley than the one that has it, and refits begin there.
    """
    seven = {name: default for name, (default, _) in declarations(Paper).items() if name in free.names}
    widths = [(vector[free.index(name)], centre) for name, centre in WIDTHS.items() if name in seven]
    if all(abs(np.log(width / centre)) < WIDTH_PRIOR for width, centre in widths):
        return [vector]
    other = vector.copy()
    other[[free.index(name) for name in seven]] = list(seven.values())
    return [vector, free.allowed(other)]


def sharing(found: Fit, data: Sequence[Whitened]) -> Fit:
    """Return a fit that another process has made with the recordings of this one, in place of copies of its own."""
    return replace(found, data=tuple(replace(a, shift_um=b.shift_um) for a, b in zip(data, found.data, strict=True)))


def _fit_at(data: Sequence[Whitened], free: Free, start: np.ndarray) -> Fit:
    return fit(data, free, start=start)


def bare(recording: Recording) -> Recording:
    """Return the recording without nuisance columns of its own: the evidence has them."""
    return replace(recording, columns=np.zeros((recording.points, 0)), column_names=())


def fit(
    data: Sequence[Whitened],
    free: Free,
    *,
    start: np.ndarray | None = None,
    known: Fit | None = None,
    iterations: int = ITERATIONS,
    secant: bool = False,
) -> Fit:
    """Follow the likelihood down with bounded, damped Gauss–Newton steps, in the coordinates of `straight`.

    Where it ends before its steps run out, derivatives taken there promise no more than `GAIN`, or no step keeps it.

    Parameters
    ----------
    data : sequence of Whitened
    free : Free
    start : numpy.ndarray, optional
        Start values; default those in `free`.
    known : Fit, optional
        An earlier fit whose predictions and derivatives are taken over where they still hold.
    iterations : int
        Most steps.
    secant : bool
        Take the derivatives that `known` has from it, and never compute them anew, even where a step does not keep
        its promise. Much cheaper, and enough to rank candidates.
    """
    problem = problem_of(data, free)
    vector = free.allowed(np.array(free.start if start is None else start))
    now = differentiated(problem, _at(problem, data, vector, known.point if known else None), known if secant else None)

    def place(vector: np.ndarray, near: Fit) -> Fit:
        return _at(problem, near.data, vector, near.point)

    return descended(now, place, partial(differentiated, problem), iterations=iterations, secant=secant)


def problem_of(data: Sequence[Whitened], free: Free) -> Problem:
    """Return what predicts and differentiates, without nuisances."""
    return Problem(tuple(bare(item.recording) for item in data), free)


def descended(
    now: Fit,
    place: Callable[[np.ndarray, Fit], Fit],
    derive: Callable[[Fit], Fit],
    *,
    iterations: int = ITERATIONS,
    secant: bool = False,
) -> Fit:
    """Descend from a fit that has derivatives.

    Parameters
    ----------
    now : Fit
    place : function of (vector, Fit)
        Returns the fit at a vector, without derivatives, from one near by.
    derive : function of Fit
        Returns the fit with derivatives.
    iterations, secant
        As in `fit`.
    """
    damping, fresh = 1e-6, not secant
    for _ in range(iterations):
        vector, promised = _step(now, damping)
        trial = _lower(place, now, vector, damping) if promised >= GAIN else None
        if trial is None and not (fresh or secant):
            now, fresh = derive(now), True
        elif trial is None:
            damping = max(100 * damping, 1e-3)
            if promised < GAIN or damping > 1e3:
                break
        else:
            fresh = not (secant or now.chi2 - trial.chi2 > TRUSTED * promised)
            moved = trial.point.vector - now.point.vector
            now = derive(trial) if fresh else replace(trial, jacobian=_secant(now, trial, moved))
            damping /= 10
    return now


def _lower(place: Callable[[np.ndarray, Fit], Fit], now: Fit, vector: np.ndarray, damping: float) -> Fit | None:
    """Return the fit at a place, or one step on from there, None where both are higher than now.

    A long step along a valley that bends ends on its flank: by the same derivatives it is a step to its floor.
    """
    trial = place(vector, now)
    if trial.chi2 >= now.chi2:
        onward, _ = _step(replace(trial, jacobian=now.jacobian), damping)
        trial = place(onward, trial)
    return trial if trial.chi2 < now.chi2 else None


def _at(problem: Problem, data: Sequence[Whitened], vector: np.ndarray, known: Point | None) -> Fit:
    """Predict, find the nuisances, and move the registration along with them."""
    point = problem.at(vector, known)
    predicted = [t.heights_um for t in point.traces]
    for _ in range(REGISTRATIONS):
        residuals = [d.residual(p) for d, p in zip(data, predicted, strict=True)]
        columns = [d.white(d.nuisance_maps(p)) for d, p in zip(data, predicted, strict=True)]
        known = np.zeros((len(data), len(NUISANCES)))
        known[:, SHIFT : SHIFT + 2] = [d.shift_um for d in data]
        coefficients, residual, basis = nuisance_fit(columns, residuals, known)
        shifts = coefficients[:, SHIFT : SHIFT + 2]
        if np.abs(shifts).max() < REGISTERED_UM:
            break
        data = [_shifted(item, shift) for item, shift in zip(data, shifts, strict=True)]
    residual[-len(WIDTHS) :] = width_rows(problem.free.parameters(point.vector), problem.free.names)[0]
    return Fit(tuple(data), problem.free, point, np.zeros((len(residual), len(vector))),
               residual - basis @ (basis.T @ residual), basis, coefficients)  # fmt: skip


def _shifted(item: Whitened, shift: np.ndarray) -> Whitened:
    """Return the recording with its registration moved, by at most a pixel in all."""
    grid = item.recording.target
    limit = np.array([grid.dx_um, grid.dy_um])
    return replace(item, shift_um=tuple(np.clip(np.array(item.shift_um) + shift, -limit, limit)))


def differentiated(problem: Problem, now: Fit, known: Fit | None = None) -> Fit:
    """Return the fit with whitened derivatives by its parameters; those that an earlier fit has are taken over."""
    names = problem.free.names
    have = {name: k for k, name in enumerate(known.free.names)} if known else {}
    missing = [k for k, name in enumerate(names) if name not in have]
    jacobian = np.zeros((len(now.residual), len(names)))
    for k, name in enumerate(names):
        if name in have:
            jacobian[:, k] = known.jacobian[:, have[name]]
    if missing:
        parts = [now.seen(k, maps) for k, maps in enumerate(_derivatives(problem, now, missing))]
        jacobian[:, missing] = stack(parts, prior_rows(len(now.data)))
    jacobian[-len(WIDTHS) :] = width_rows(problem.free.parameters(now.point.vector), names)[1]
    return replace(now, jacobian=jacobian)


def _derivatives(problem: Problem, now: Fit, chosen: Sequence[int]) -> list[np.ndarray]:
    """Return derivatives of every recording's prediction by some of the parameters: maps (chosen, rows, cols)."""
    free = problem.free
    if len(chosen) == len(free.names):
        return problem.derivatives(now.point)
    names = tuple(free.names[k] for k in chosen)
    part = replace(free, base=now.parameters, names=names, low=free.low[chosen], high=free.high[chosen])
    return replace(problem, free=part).derivatives(replace(now.point, vector=now.point.vector[chosen]))


def _beside(now: Fit, values: np.ndarray) -> np.ndarray:
    return values - now.nuisances @ (now.nuisances.T @ values)


def _step(now: Fit, damping: float) -> tuple[np.ndarray, float]:
    """Return where the damped least-squares step inside the bounds leads, and what it promises in χ²."""
    free, vector = now.free, now.point.vector
    here, (low, high) = straight(free, vector), straight_bounds(free, vector)
    width = high - low
    matrix = _beside(now, now.jacobian @ bending(free, vector)) * width
    sizes = np.linalg.norm(matrix, axis=0)
    triangle = np.linalg.qr(np.column_stack([matrix, now.residual]), mode="r")
    columns = matrix.shape[1]
    whole, goal = triangle[:columns, :columns], triangle[:columns, columns]
    ridge = np.diag(np.sqrt(damping) * np.maximum(sizes, 1e-6 * sizes.max(initial=1e-12)))
    reach = np.minimum((low - here) / width, -1e-12), np.maximum((high - here) / width, 1e-12)
    target = np.concatenate([goal, np.zeros(columns)])
    step = lsq_linear(np.vstack([whole, ridge]), target, bounds=reach, method="bvls").x
    return bent(free, here + step * width), float(goal @ goal - np.sum((goal - whole @ step) ** 2))


def _secant(now: Fit, trial: Fit, step: np.ndarray) -> np.ndarray:
    """Return Broyden's update of the derivatives; steps are measured in the widths of the bounds."""
    scale = 1 / (now.free.high - now.free.low) ** 2
    along = step * scale / (step @ (step * scale))
    moved = _beside(now, now.residual) - _beside(trial, trial.residual)
    return now.jacobian + np.outer(moved - _beside(now, now.jacobian @ step), along)

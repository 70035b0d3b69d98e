"""The descent: bounded, damped Gauss–Newton in coordinates in which the model is nearly linear.

Looked at first: `scipy.optimize.least_squares` (trf, dogbox) and lmfit, which stands on it or on MINPACK. They take a
Jacobian after every accepted step; here one costs as much as five to ten predictions, and Broyden's update of it
(Math. Comput. 19, 577, 1965) halves the work of a fit. They bound a box, and κ_min ≤ κ_max is none. So the steps are
SciPy's (`lsq_linear`) and the rule that strings them together is ours.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import lsq_linear

from dlwpredict.infer.free import Free
from dlwpredict.infer.objective import Fit, Objective
from dlwpredict.infer.straight import bending, bent, straight, straight_bounds

GAIN = 0.1
"""A descent has converged when the next step promises less than this in the objective: a tenth of what one standard
deviation of one parameter costs."""

MISFIT = 1e-3
"""... or than this share of what the residual exceeds its noise by, or of what another model has explained: one that
lacks something need not be known to a standard deviation, and models are told apart by no less than fifty times this
share (`diagnosis.policy.FORM_ERROR`)."""

STALLED = 1.0
"""... or has come true by less, with a Jacobian computed there, though it promised up to so much: finite differences
are no more exact where a valley is flat."""

TRUSTED = 0.8
"""Share of the promised gain that must come true for the Jacobian to be updated by the secant, not computed anew."""

STEPS = 24
"""Steps at most: few descents need so many, along valleys that bend."""

LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e3
"""Marquardt's damping where a step has failed first, and where no smaller step is tried."""


def descend(objective: Objective, now: Fit, *, secant: bool = False, steps: int = STEPS, gain: float = GAIN) -> Fit:
    """Follow the objective down from a fit that has derivatives, until a step promises less than the tolerance.

    A descent that has converged was found so by a Jacobian computed there, unless only the secant is wanted.

    Parameters
    ----------
    objective : Objective
    now : Fit
    secant : bool
        Never compute the Jacobian anew, even where a step does not keep its promise. Much cheaper, and enough to rank
        models and to find where a descent should begin.
    steps : int
    gain : float
    """
    damping, fresh = 1e-6, not secant
    for _ in range(steps):
        vector, promised = _step(now, damping)
        least = tolerance(objective, now, gain)
        trial = _lower(objective, now, vector, damping) if promised >= least else None
        if trial is None and not (fresh or secant):
            now, fresh = objective.differentiated(now), True
        elif trial is None:
            damping = max(100 * damping, LEAST_DAMPING)
            if promised < least or damping > MOST_DAMPING:
                break
        elif fresh and promised < STALLED and now.cost - trial.cost < least:
            break
        else:
            fresh = not (secant or now.cost - trial.cost > TRUSTED * promised)
            now = objective.differentiated(trial) if fresh else replace(trial, jacobian=_broyden(now, trial))
            damping /= 10
    return now


def tolerance(objective: Objective, now: Fit, gain: float) -> float:
    """Return what a step must promise to be worth taking: a gain, or a share of what a model is or was wrong by."""
    return max(gain, MISFIT * max(now.cost - now.rows.data, objective.explained))


def promised(now: Fit) -> float:
    """Return by how much the next step of a descent would lower the objective if its derivatives held all the way."""
    return _step(now, LEAST_DAMPING)[1]


def _lower(objective: Objective, now: Fit, vector: np.ndarray, damping: float) -> Fit | None:
    """Return the fit at a place, or where the bend that it shows leads; None where both are higher, or it is the same.

    Correlated parameters form a curved valley. A long step overshoots onto its flank; before it is rejected, the step
    that follows the bend is tried (geodesic acceleration: Transtrum & Sethna, arXiv:1201.5885).
    """
    if np.array_equal(vector, now.vector):
        return None
    trial = objective.at(now.free, vector, now)
    if trial.cost >= now.cost:
        trial = objective.at(now.free, _along_bend(now, trial, damping), trial)
    return trial if trial.cost < now.cost and not np.array_equal(trial.vector, now.vector) else None


def _along_bend(now: Fit, trial: Fit, damping: float) -> np.ndarray:
    """Return the lowest place on the parabola that residuals follow to second order.

    From r at now and r' at the step d, r(t) = r − t·Jd + t²·q with q = r' − r + Jd. Correcting by t²·c with c = J⁺q, of
    the bend only what J cannot follow remains.
    """
    free = now.free
    here, there = straight(free, now.vector), straight(free, trial.vector)
    matrix = now.nuisances.beside(now.jacobian @ bending(free, now.vector))
    sizes = np.maximum(np.linalg.norm(matrix, axis=0), 1e-12)
    along = matrix @ (there - here)
    bend = trial.residual - now.residual + along
    ridge = np.diag(np.full(len(sizes), np.sqrt(damping)))
    goal = np.concatenate([bend, np.zeros(len(sizes))])
    correction = np.linalg.lstsq(np.vstack([matrix / sizes, ridge]), goal, rcond=None)[0] / sizes
    left = bend - matrix @ correction
    share = np.linspace(0.02, 1, 50)[:, None]
    powers = np.hstack([np.ones_like(share), -share, share**2])
    parts = np.stack([now.residual, along, left])
    costs = np.sum((powers @ (parts @ parts.T)) * powers, axis=1)
    t = float(share[np.argmin(costs), 0])
    return bent(free, here + t * (there - here) + t**2 * correction)


def _step(now: Fit, damping: float) -> tuple[np.ndarray, float]:
    """Return where the damped least-squares step inside the bounds leads, and what it promises."""
    free, vector = now.free, now.vector
    here, (low, high) = straight(free, vector), straight_bounds(free, vector)
    width = high - low
    matrix = now.nuisances.beside(now.jacobian @ (bending(free, vector) * width))
    sizes = np.linalg.norm(matrix, axis=0)
    stacked = np.column_stack([matrix, now.residual])
    triangle: np.ndarray = np.linalg.qr(stacked, mode="r")  # type: ignore[assignment]  # NumPy's stub has no modes
    columns = matrix.shape[1]
    whole, goal = triangle[:columns, :columns], triangle[:columns, columns]
    ridge = np.diag(np.sqrt(damping) * np.maximum(sizes, 1e-6 * sizes.max(initial=1e-12)))
    reach = np.minimum((low - here) / width, -1e-12), np.maximum((high - here) / width, 1e-12)
    change = _ordered(free, (here, width), np.vstack([whole, ridge]), np.concatenate([goal, np.zeros(columns)]), reach)
    return bent(free, here + change * width), float(goal @ goal - np.sum((goal - whole @ change) ** 2))


def _inside(matrix: np.ndarray, goal: np.ndarray, reach: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    return lsq_linear(matrix, goal, bounds=reach, method="bvls").x


def _ordered(
    free: Free,
    place: tuple[np.ndarray, np.ndarray],
    matrix: np.ndarray,
    goal: np.ndarray,
    reach: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """Return the best change that does not lift κ_min above κ_max, from a place and in the widths of the bounds there.

    Where the best of all would, the two meet, and κ_max is eliminated: it goes where κ_min goes. A step that is only
    shortened to there can promise less than nothing, as if a descent had converged.
    """
    change, (here, width) = _inside(matrix, goal, reach), place
    a, b = free.index("shrinkage_min"), free.index("shrinkage_max")
    if a is None or b is None or change[a] * width[a] - change[b] * width[b] <= here[b] - here[a]:
        return change
    ratio, gap = width[a] / width[b], (here[a] - here[b]) / width[b]  # change[b] = gap + ratio · change[a]
    merged = matrix.copy()
    merged[:, a] += ratio * matrix[:, b]
    low, high = (ends.copy() for ends in reach)
    low[a], high[a] = max(low[a], (low[b] - gap) / ratio), min(high[a], (high[b] - gap) / ratio)
    high[a] = max(high[a], low[a] + 1e-12)
    others = np.arange(len(change)) != b
    change[others] = _inside(merged[:, others], goal - gap * matrix[:, b], (low[others], high[others]))
    change[b] = gap + ratio * change[a]
    return change


def _broyden(now: Fit, trial: Fit) -> np.ndarray:
    """Return Broyden's update of the derivatives; steps are measured in the widths of the bounds."""
    step = trial.vector - now.vector
    scale = 1 / (now.free.high - now.free.low) ** 2
    along = step * scale / (step @ (step * scale))
    moved = now.nuisances.beside(now.residual) - trial.nuisances.beside(trial.residual)
    return now.jacobian + np.outer(moved - now.nuisances.beside(now.jacobian @ step), along)

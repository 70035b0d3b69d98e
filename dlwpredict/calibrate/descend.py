"""Levenberg–Marquardt with bounds: the derivative-based way down."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import lsq_linear

from dlwpredict.calibrate.problem import Point, Problem
from dlwpredict.calibrate.straight import bending, bent, straight, straight_bounds
from dlwpredict.flat import Free

MOST_TRIALS = 8
"""Damped steps tried from one place before it is taken as the lowest."""

TRUSTED = 0.5
"""Share of the promised gain that must come true for a Jacobian to be updated instead of computed anew."""

FLANK = 1.1
"""Cost, in units of that where a step began, up to which its end counts as the flank of the same valley."""


def descend(
    problem: Problem,
    start: Point,
    *,
    gain: float,
    iterations: int,
    jacobian: Sequence[np.ndarray] | None = None,
) -> Point:
    """Follow the Jacobian down until the next step promises less than ``gain`` of the cost.

    Each step solves the linearised problem inside the bounds (scipy's ``lsq_linear``), damped by Marquardt's rule,
    in the coordinates of `straight`.
    Between steps the Jacobian is updated by Broyden's secant, which costs nothing; it is computed anew when a step
    with an updated one fails or promises too little. So the place where it stops was judged by a fresh Jacobian.

    Parameters
    ----------
    problem : Problem
    start : Point
    gain : float
        Relative gain in cost below which the descent stops.
    iterations : int
        Most accepted steps.
    jacobian : sequence of numpy.ndarray, optional
        A Jacobian by the coordinates of `straight` from nearby, taken as if it were fresh.
    """
    point, fresh, damping = start, jacobian is not None, 1e-4
    for _ in range(iterations):
        while True:
            if jacobian is None:
                jacobian, fresh = _fresh(problem, point), True
            found, kept, damped = _step(
                problem, point, jacobian, damping, gain=gain, trials=MOST_TRIALS if fresh else 1
            )
            if found is not None or fresh:
                break
            jacobian = None  # the fault may be the update's: the fresh one is not damped for it
        damping = damped
        if found is None:
            return point
        jacobian, fresh = (_secant(problem.free, jacobian, point, found) if kept > TRUSTED else None), False
        point = found
    return point


def _step(
    problem: Problem, point: Point, jacobian: Sequence[np.ndarray], damping: float, *, gain: float, trials: int
) -> tuple[Point | None, float, float]:
    """Take the first damped step that lowers the cost.

    Returns
    -------
    point : Point or None
        None: no step lowers the cost by as much as is asked.
    kept : float
        Share of the promised gain that came true.
    damping : float
    """
    root = normal_root(jacobian, point)
    for trial_number in range(trials):
        vector, promised = _proposed(problem.free, point, root, damping)
        if promised < gain * point.cost:
            return None, 0.0, damping
        trial = problem.at(vector, point)
        if trial.cost >= point.cost:
            trial = _back(problem, point, trial, jacobian, damping, anew=trials > 1 and trial_number == 0)
        if trial.cost < point.cost:
            kept = (point.cost - trial.cost) / promised
            return trial, kept, damping / 10 if kept > TRUSTED else damping
        damping = max(damping * 10, 1e-4)
    return None, 0.0, damping


def _proposed(
    free: Free, point: Point, root: tuple[np.ndarray, np.ndarray], damping: float
) -> tuple[np.ndarray, float]:
    """Return where the linearised problem of this `normal_root` is lowest, and by how much it is lower there."""
    matrix, right = root
    here = straight(free, point.vector)
    change = bounded_step(free, here, straight_bounds(free, point.vector), matrix, right, damping)
    return bent(free, here + change), right @ right - np.sum((right - matrix @ change) ** 2)


def _back(
    problem: Problem, point: Point, trial: Point, jacobian: Sequence[np.ndarray], damping: float, *, anew: bool
) -> Point:
    """Return to the floor of a valley: a long step along one that bends ends on its flank, but nearer to its end.

    Once by the same Jacobian; then, with ``anew``, by one taken there. What is refused here would have to be crawled.
    """

    def onward(place: Point, derivatives: Sequence[np.ndarray]) -> Point:
        return problem.at(_proposed(problem.free, place, normal_root(derivatives, place), damping)[0], place)

    found = onward(trial, jacobian)
    if anew and point.cost <= found.cost < FLANK * point.cost:
        found = onward(found, _fresh(problem, found))
    return found


def _fresh(problem: Problem, point: Point) -> list[np.ndarray]:
    """Differentiate by the coordinates of `straight`."""
    turn = bending(problem.free, point.vector)
    return [j @ turn for j in problem.jacobian(point)]


def normal_root(jacobian: Sequence[np.ndarray], point: Point) -> tuple[np.ndarray, np.ndarray]:
    """Return a small (R, b) with ‖R·d − b‖² = ‖√w(J·d − r)‖² up to a constant, all recordings together."""
    columns = jacobian[0].shape[1]
    stacked = np.concatenate(
        [
            np.sqrt(w)[:, None] * np.column_stack([j, r])
            for j, r, w in zip(jacobian, point.residuals, point.weights, strict=True)
        ]
    )
    triangle = np.linalg.qr(stacked, mode="r")
    return triangle[:columns, :columns], triangle[:columns, columns]


def bounded_step(
    free: Free,
    here: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    matrix: np.ndarray,
    right: np.ndarray,
    damping: float,
) -> np.ndarray:
    """Return the damped least-squares step that stays inside the bounds and keeps κ_min ≤ κ_max."""
    low, high = bounds
    width = high - low
    sizes = np.maximum(np.linalg.norm(matrix, axis=0), 1e-6 * np.linalg.norm(matrix * width) / width)
    full = np.vstack([matrix, np.sqrt(damping) * np.diag(sizes)])
    goal = np.concatenate([right, np.zeros(len(here))])
    step = _inside(full, goal, here, low, high)
    a, b = free.index("shrinkage_min"), free.index("shrinkage_max")
    if a is not None and b is not None and here[a] + step[a] > here[b] + step[b]:
        return _tied(full, goal, here, low, high, a, b)
    return step


def _inside(matrix: np.ndarray, goal: np.ndarray, vector: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the bounded least-squares step; steps are scaled by the widths of the bounds."""
    width = high - low
    reach = np.minimum((low - vector) / width, -1e-12), np.maximum((high - vector) / width, 1e-12)
    return lsq_linear(matrix * width, goal, bounds=reach, method="bvls").x * width


def _tied(
    matrix: np.ndarray, goal: np.ndarray, vector: np.ndarray, low: np.ndarray, high: np.ndarray, a: int, b: int
) -> np.ndarray:
    """Return the step on the border κ_min = κ_max, where both move as one."""
    gap = np.zeros(len(vector))
    gap[a] = vector[b] - vector[a]  # from here on both start at κ_max
    merged = np.delete(matrix, a, axis=1)
    merged[:, b - (a < b)] += matrix[:, a]
    keep = [k for k in range(len(vector)) if k != a]
    low, high = low.copy(), high.copy()
    low[b], high[b] = max(low[a], low[b]), min(high[a], high[b])
    start = np.clip(vector[keep], low[keep], high[keep])
    step = np.zeros(len(vector))
    step[keep] = _inside(merged, goal - matrix @ gap, start, low[keep], high[keep]) + start - vector[keep]
    step[a] = gap[a] + step[b]
    return step


def _secant(free: Free, jacobian: Sequence[np.ndarray], old: Point, new: Point) -> list[np.ndarray]:
    """Return Broyden's update: the smallest change of J that explains how the residuals moved."""
    start, end = straight(free, old.vector), straight(free, new.vector)
    step, width = end - start, free.high - free.low
    along = step / width**2 / np.sum((step / width) ** 2)
    return [
        j + np.outer(before - after - j @ step, along)
        for j, before, after in zip(jacobian, old.residuals, new.residuals, strict=True)
    ]

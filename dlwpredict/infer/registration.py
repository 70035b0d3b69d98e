"""Registration: what a recording's own nuisances come out as, and where a shift lays the prediction on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.infer import priors
from dlwpredict.infer.priors import NUISANCES
from dlwpredict.infer.whitened import Whitened

REGISTRATIONS, REGISTERED_UM = 8, 5e-4
"""Registration is repeated at most so often, until it moves by less: a thousandth of a pixel."""

LONGER = 0.5, 2.0
"""Factors on a step of it."""


@dataclass(frozen=True, eq=False)
class Registered:
    """A recording where registration has put it, its nuisances fitted."""

    item: Whitened
    residual: np.ndarray
    prior: np.ndarray
    above: np.ndarray
    below: np.ndarray
    coefficients: np.ndarray


def registered(item: Whitened, predicted_um: np.ndarray) -> Registered:
    """Fit a recording's own nuisances, priors included, and move its registration along with them.

    A step is linear, and the residual bends what it goes along: the second and later ones are as much longer or shorter
    as the step before has shown (secant).
    """
    before, moved, factor = np.zeros(2), np.zeros(2), 1.0
    for _ in range(REGISTRATIONS):
        solution = _nuisances_fitted(item, predicted_um)
        step = item.shift_in(solution.coefficients)
        if along := float((before - step) @ moved):
            factor = float(np.clip(moved @ moved / along, *LONGER)) if along > 0 else 1.0
        further = item.shifted_by(factor * step)
        before, moved = step, np.subtract(further.shift_um, item.shift_um)
        if np.abs(moved).max() < REGISTERED_UM:
            break
        item = further
    return solution


def _nuisances_fitted(item: Whitened, predicted_um: np.ndarray) -> Registered:
    measured = np.where(item.recording.used, item.recording.measured.heights_um, 0.0) - item.moved(predicted_um)
    white = item.white(np.concatenate([measured[None], item.nuisance_maps(predicted_um)]))
    residual, columns = white[:, 0], white[:, 1:]
    mean, sd = np.array([NUISANCES[name] for name in item.nuisances]).reshape(-1, 2).T
    bounded = priors.bounded(item.nuisances)
    prior = np.zeros((len(bounded), len(mean)))
    prior[range(len(bounded)), bounded] = 1 / sd[bounded]
    goal = prior @ (mean - item.known())
    scale = np.maximum(np.sqrt(np.sum(columns**2, axis=0) + np.sum(prior**2, axis=0)), 1e-12)
    columns, prior = columns / scale, prior / scale
    energies, turn = np.linalg.eigh(columns.T @ columns + prior.T @ prior)
    real = energies > 1e-12 * energies.max(initial=1.0)
    turn = turn[:, real] / np.sqrt(energies[real])
    above, below = columns @ turn, prior @ turn
    along = above.T @ residual + below.T @ goal
    left, short = residual - above @ along, goal - below @ along
    return Registered(item, left, short, above, below, turn @ along / scale)

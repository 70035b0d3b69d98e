"""Registration: what a recording's own nuisances come out as, and where they lay the prediction on it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dlwpredict.infer import priors
from dlwpredict.infer.whitened import Whitened

REGISTRATIONS, REGISTERED_UM = 8, 5e-4
"""Registration is repeated at most so often, until it moves by less: a thousandth of a pixel."""

LONGER, SHORTER = (0.5, 2.0), 0.25
"""Factors on a step of it: as the step before has shown, and where one has led uphill."""


@dataclass(frozen=True, eq=False)
class Registered:
    """A recording where registration has put it, its nuisances fitted.

    Parameters
    ----------
    item : Whitened
    residual, prior : numpy.ndarray, shapes (points,), (priors,)
        Whitened, beside the nuisances.
    above, below : numpy.ndarray, shapes (points, columns), (priors, columns)
        Orthonormal basis of the whitened nuisances, rows of their priors below.
    coefficients : numpy.ndarray, shape (nuisances,)
    spread : numpy.ndarray, shape (nuisances, columns)
        From coordinates in that basis to coefficients.
    """

    item: Whitened
    residual: np.ndarray
    prior: np.ndarray
    above: np.ndarray
    below: np.ndarray
    coefficients: np.ndarray
    spread: np.ndarray

    @cached_property
    def step_um(self) -> np.ndarray:
        """By how much the recording is still to be moved: shifts, scales at the rim."""
        return self.item.step_in(self.coefficients)

    @cached_property
    def cost(self) -> float:
        """−2 ln L and priors where the recording lies, all else fitted: no promise of the next step is counted."""
        names = self.item.nuisances
        rows = [names.index(name) for name in self.item.followed]
        back = np.linalg.pinv(self.spread[rows]) @ self.coefficients[rows]
        return float(self.residual @ self.residual + self.prior @ self.prior + back @ back)


def registered(item: Whitened, predicted_um: np.ndarray) -> Registered:
    """Fit a recording's own nuisances, priors included, and move its registration along with them, never uphill.

    A step is linear, and the residual bends what it goes along: the second and later ones are as much longer or shorter
    as the step before has shown (secant). Where little of a structure counts, a shift is hardly known, and its linear
    step may lead onto a wall: it is shortened.
    """
    now, factor = nuisances_fitted(item, predicted_um), 1.0
    for _ in range(REGISTRATIONS):
        further = now.item.moved_by(factor * now.step_um)
        moved = further.moved_um - now.item.moved_um
        if np.abs(moved).max() < REGISTERED_UM:
            break
        then = nuisances_fitted(further, predicted_um)
        if then.cost > now.cost:
            factor *= SHORTER
            continue
        along = float((now.step_um - then.step_um) @ moved)
        factor = float(np.clip(moved @ moved / along, *LONGER)) if along > 0 else 1.0
        now = then
    return now


def nuisances_fitted(item: Whitened, predicted_um: np.ndarray) -> Registered:
    """Fit a recording's own nuisances, priors included, linearly about where it lies."""
    residual, columns = item.columns(predicted_um)
    bounded = priors.bounded(item.nuisances)
    prior = np.zeros((len(bounded), len(item.nuisances)))
    prior[range(len(bounded)), bounded] = 1 / item.recording.left_open[bounded]
    goal = -prior @ item.known()
    scale = np.maximum(np.sqrt(np.sum(columns**2, axis=0) + np.sum(prior**2, axis=0)), 1e-12)
    columns, prior = columns / scale, prior / scale
    energies, turn = np.linalg.eigh(columns.T @ columns + prior.T @ prior)
    real = energies > 1e-12 * energies.max(initial=1.0)
    turn = turn[:, real] / np.sqrt(energies[real])
    above, below = columns @ turn, prior @ turn
    along = above.T @ residual + below.T @ goal
    left, short = residual - above @ along, goal - below @ along
    spread = turn / scale[:, None]
    return Registered(item, left, short, above, below, spread @ along, spread)

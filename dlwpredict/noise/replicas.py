"""The bootstrap: how far estimates from maps that are drawn of a noise model lie from it, and how they scatter."""

from __future__ import annotations

import numpy as np

from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.evened import Evened
from dlwpredict.noise.kinds import NINE, PARABOLA, STEPS, lowest_of
from dlwpredict.noise.likelihood import Likelihood, model_at

RECENTRED = 4
"""Times at most that the estimate starts again from where it has led."""

REPLICATES = 24
"""Maps drawn from an estimate on which it is repeated, to learn its error."""


def repeated(
    likelihood: Likelihood, used: np.ndarray, even: Evened, model: Noise, place: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return the places of the values themselves and of maps drawn from a model near them, and the model's own, (3,).

    For every map a quadratic in (share, length), through nine places around the model's own, stands for its deviance.
    """
    low, high = likelihood.bounds(model.pitch_um)
    step = STEPS[-1]
    for _ in range(RECENTRED):
        before = place
        ((*lowest, scale),), bend = _parabolic(likelihood, model, place, step)
        place = np.clip(lowest, low, high)
        step = np.clip(1.5 / np.sqrt(np.maximum(bend, 1e-12)), STEPS[-1] / 4, 5 * STEPS[-1])
        if np.abs(place - before).max() < STEPS[-1].min():
            break
    centre = np.array([*place, scale])
    drawn = model_at(model, centre).simulate_many(used.shape, rng, REPLICATES)[:, used].T
    places, _ = _parabolic(likelihood.beside(even.beside_lines(drawn)), model, place, step)
    return places, centre


def _parabolic(
    likelihood: Likelihood, model: Noise, place: np.ndarray, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the most likely place of every map (maps, 3), and how its −2 ln L bends along share and length."""
    deviances, scales = likelihood.profiled([(model, place + step * node) for node in NINE])
    terms = PARABOLA @ deviances
    moves = np.array([lowest_of(parabola, 3.0) for parabola in terms.T])
    u, v = moves.T
    heights = np.sum(np.stack([np.ones(len(u)), u, v, u**2 / 2, u * v, v**2 / 2]) * (PARABOLA @ scales), axis=0)
    return np.column_stack([place + step * moves, heights]), terms[[3, 5]].mean(axis=1) / step**2 / 2

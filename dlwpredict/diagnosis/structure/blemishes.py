"""Blemishes: spots that stand out of a fit more than any name promises to explain; their points say nothing of physics.

A particle, a bubble or a torn place is on most prints. A fit that has to follow it bends its parameters, and takes up
names that follow it a little. Where one spot explains more than the best further name, it is believed to be one, and
its points are left out of everything; it stays a place, and structure without a name.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.structure.spots import Bumps, Spot, mismatch, patch
from dlwpredict.diagnosis.structure.test import SINGLE, Model
from dlwpredict.infer.recording import Recording


@dataclass(frozen=True, eq=False)
class Blemish(Spot):
    """A spot with the points that are left out for it.

    Parameters
    ----------
    points : numpy.ndarray of bool, shape (rows, cols)
    """

    points: np.ndarray

    def left_out_of(self, recording: Recording) -> Recording:
        """Return its recording without its points."""
        return replace(recording, used=recording.used & ~self.points)


def suspected(model: Model) -> bool:
    """Tell whether a fit leaves a spot that is more than noise."""
    return model.spot.p_value < SINGLE


def blemish(model: Model, bumps: Bumps, promised: float) -> Blemish | None:
    """Return the spot that a fit leaves, with its points, where it is a blemish.

    Parameters
    ----------
    model : Model
    bumps : Bumps
        Of the recording that has the spot.
    promised : float
        2 ln L that the best further name brings.
    """
    lone, fit = model.spot, model.fit
    if not suspected(model) or lone.excess <= promised:
        return None
    score, used = bumps.scores(fit.residual[fit.rows.of(lone.pair)]), bumps.item.recording.used
    scale, row, col = np.unravel_index(np.argmax(np.abs(score)), score.shape)
    if np.max(score[1:] ** 2) < policy.HALF * np.max(score**2):  # no wider than a pixel: a spike, or left of a corner
        return None
    seen = score[: max(int(scale), 1) + 1]  # wider bumps would see it farther away
    points = patch(mismatch(seen, used), int(row), int(col))
    return None if (points & used).sum() > policy.LOCAL * used.sum() else Blemish(**vars(lone), points=points)

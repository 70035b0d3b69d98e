"""What the residual itself says of the scatter along a direction, whatever the noise model says.

Along a unit column u the noise model says that u·r has a variance of 1. The sums of u·r over blocks that are wide
against the noise are independent; the sum of their squares is the variance along u that the residual shows, with all
that no model has (a sandwich: White, Econometrica 48, 817, 1980).
"""

from __future__ import annotations

import numpy as np

from dlwpredict.infer.objective import Fit

BLOCKS = 7
"""Blocks along each side of a map: wide against the noise, and enough of them to know a variance."""


def sandwich(fitted: Fit, unit: np.ndarray) -> np.ndarray:
    """Return the variance that the blocks of a fit's residual show along columns of length 1.

    Parameters
    ----------
    fitted : Fit
    unit : numpy.ndarray, shape (rows, columns)
        Whitened.

    Returns
    -------
    numpy.ndarray, shape (columns,)
    """
    variances = np.zeros(unit.shape[1])
    for item, part, residual in zip(
        fitted.data, fitted.rows.split(unit), fitted.rows.split(fitted.residual), strict=True
    ):
        used = item.recording.used
        row, col = (
            np.minimum(place * BLOCKS // n, BLOCKS - 1) for place, n in zip(np.nonzero(used), used.shape, strict=True)
        )
        sums = np.zeros((BLOCKS**2, unit.shape[1]))
        np.add.at(sums, row * BLOCKS + col, part * residual[:, None])
        variances += np.sum(sums**2, axis=0)
    return variances

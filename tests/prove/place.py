"""Whether a diagnosis points at the right place: of interest for physics that sits in one spot of the print."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

NEAR_UM, SMALL = 2.0, 0.25
"""A place is right where its box, this much wider, holds the spot, and is no larger than this share of the map."""


def points_at(spot: Mapping[str, float], locations: Sequence[Mapping], side_um: float) -> bool:
    """Tell whether the first place named is the spot's.

    Parameters
    ----------
    spot : mapping
        `x_um` and `y_um` from the middle of the map.
    locations : sequence of mapping
        Of the diagnosis: boxes `x_um`, `y_um`, the strongest first.
    side_um : float
        Of the square map.
    """
    if not locations:
        return False
    box = locations[0]
    inside = all(box[axis][0] - NEAR_UM <= spot[axis] <= box[axis][1] + NEAR_UM for axis in ("x_um", "y_um"))
    return bool(inside and np.ptp(box["x_um"]) * np.ptp(box["y_um"]) <= SMALL * side_um**2)

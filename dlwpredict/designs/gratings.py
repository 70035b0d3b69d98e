"""Lines repeated along one direction."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from dlwpredict.designs.base import Base, Footprint, Relief, design, number, um
from dlwpredict.parameters import Declaration

Period = Annotated[float, um(0.01, 1000.0, "period")]
Angle = Annotated[
    float, Declaration("deg", -180.0, 180.0, "direction across the lines, counter-clockwise from x; 0 = lines along y")
]


@design("line grating, binary or sinusoidal", size_um=50.0)
def grating(
    at: Footprint,
    *,
    base_um: Base = 3.0,
    height_um: Relief = 1.0,
    period_um: Period = 5.0,
    duty: Annotated[float, number(0.01, 0.99, "fraction of the period that is high (binary grating)")] = 0.5,
    sinus: Annotated[bool, number(0, 1, "sinusoidal instead of binary")] = False,
    angle_deg: Angle = 0.0,
) -> np.ndarray:
    """Lines with a ridge at the centre; binary (high where |u| < duty/2) or height/2·(1 + cos 2πu), u in periods.

    Raises
    ------
    InputError
        The period, or one of its two parts, is below two pixels or one pixel.
    """
    at.require_resolved("period_um", period_um)
    periods = at.along_um(angle_deg) / period_um
    if sinus:
        return base_um + height_um / 2 * (1 + np.cos(2 * np.pi * periods))
    at.require_resolved("duty: half of the narrower part", 2 * period_um * min(duty, 1 - duty))
    return base_um + height_um * (fraction(periods + duty / 2) < duty)


@design("blazed grating: a sawtooth that rises with x", size_um=50.0)
def blaze(
    at: Footprint,
    *,
    base_um: Base = 3.0,
    height_um: Relief = 1.0,
    period_um: Period = 5.0,
    angle_deg: Angle = 0.0,
) -> np.ndarray:
    """Sawtooth height·frac(u): slow rise, sudden fall; at 0° the first tooth starts at the left edge.

    Raises
    ------
    InputError
        The period is below two pixels.
    """
    at.require_resolved("period_um", period_um)
    return base_um + height_um * fraction((at.along_um(angle_deg) + at.width_um / 2) / period_um)


def fraction(periods: np.ndarray) -> np.ndarray:
    """Return the part after the point, rounded first, so that pixels on an edge fall on one side throughout."""
    return np.round(periods, 9) % 1

"""The radially chirped calibration structure."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from dlwpredict.designs.base import Base, Footprint, Relief, design, um
from dlwpredict.errors import InputError


@design("radially chirped smooth waves (CIN): transfer function, resolution", size_um=50.0)
def cin(
    at: Footprint,
    *,
    base_um: Base = 9.0,
    height_um: Relief = 2.0,
    period_min_um: Annotated[float, um(0.01, 1000.0, "period at the centre")] = 3.0,
    period_max_um: Annotated[float, um(0.01, 1000.0, "period at half the footprint's side")] = 14.0,
) -> np.ndarray:
    """Waves whose period grows linearly with the distance r from the centre.

    λ(r) = λ₀ + (λ₁ − λ₀)·r/R with R half the side; z = base + height/2·(1 + cos φ), φ(r) = ∫ 2π/λ dr
    = 2πR/(λ₁ − λ₀)·ln(λ(r)/λ₀). The law goes on into the corners. At the defaults 10 ± 1 µm, as in Lang et al. 2022.

    Raises
    ------
    InputError
        ``period_max_um`` is below ``period_min_um``, or that is below two pixels.
    """
    if period_max_um < period_min_um:
        raise InputError(
            f"found {period_max_um:g}", key="period_max_um", allowed=f"at least period_min_um = {period_min_um:g}"
        )
    at.require_resolved("period_min_um", period_min_um)
    growth = (period_max_um - period_min_um) / (at.side_um / 2)  # dλ/dr
    periods = at.radius_um / period_min_um
    if growth > 0:
        periods = np.log1p(growth * periods) / growth
    return base_um + height_um / 2 * (1 + np.cos(2 * np.pi * periods))

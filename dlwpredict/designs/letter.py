"""An F: the shortest way to see whether a map was turned or mirrored."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from dlwpredict.designs.base import Base, Footprint, design, um

STROKES = (
    (0.20, 0.36, 0.0, 1.0),
    (0.20, 0.80, 0.84, 1.0),
    (0.20, 0.66, 0.44, 0.60),
)  # x from, to; y from, to; of the side


@design("letter F for orientation", size_um=30.0)
def f(
    at: Footprint,
    *,
    base_um: Base = 0.0,
    height_um: Annotated[float, um(0.0, 500.0, "height of the letter")] = 5.0,
) -> np.ndarray:
    """Letter F, as high as the footprint and 0.6 of it wide; no turn and no mirror maps it onto itself."""
    right = np.round(at.x_um / at.width_um + 0.5, 9)
    up = np.round(at.y_um / at.depth_um + 0.5, 9)
    strokes = [(x0 <= right) & (right < x1) & (y0 <= up) & (up < y1) for x0, x1, y0, y1 in STROKES]
    return base_um + height_um * np.any(strokes, axis=0)

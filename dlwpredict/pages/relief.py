"""Height maps for the view that can be turned: few points, 16-bit levels, as text within a page."""

from __future__ import annotations

import base64
from typing import Any

import matplotlib
import numpy as np

from dlwpredict.heightmap import HeightMap
from dlwpredict.pages.pictures import coarser
from dlwpredict.plots.panels import HEIGHT_COLOURS

LEVELS = 65534
"""Of a relief's own range of heights; the level above the last stands for a point that was not measured."""

LARGEST_RELIEF, MOST_POINTS = 14_400, 600_000
"""Points of one relief, 120 × 120, and of all reliefs of a page together; each takes 2.7 bytes."""


def relief(structure: str, name: str, height_map: HeightMap, limits_um: tuple[float, float], points: int) -> dict:
    """Return a height map as `relief.js` reads it: sizes and heights in µm, row 0 on top.

    Parameters
    ----------
    structure, name : str
    height_map : HeightMap
    limits_um : tuple of float
        Heights of the first and the last colour.
    points : int
        At most so many.
    """
    few = coarser(height_map, height_map.heights_um, points)
    known = np.isfinite(few.heights_um)
    bottom, top = (float(end(few.heights_um[known])) if known.any() else 0.0 for end in (np.min, np.max))
    share = (np.where(known, few.heights_um, bottom) - bottom) / (top - bottom or 1.0)
    levels = np.where(known, np.round(LEVELS * share), LEVELS + 1).astype("<u2")
    rows, cols = few.shape
    width, depth = few.size_um
    return {
        "structure": structure,
        "name": name,
        "rows": rows,
        "cols": cols,
        "width": width,
        "depth": depth,
        "bottom": bottom,
        "top": top,
        "low": limits_um[0],
        "high": limits_um[1],
        "levels": base64.b64encode(levels.tobytes()).decode("ascii"),
    }


def colours() -> list[list[int]]:
    """Return the colours of heights, low to high, as red, green, blue from 0 to 255."""
    return [[round(255 * part) for part in matplotlib.colormaps[HEIGHT_COLOURS](k / 31)[:3]] for k in range(32)]


def view(reliefs: list[dict[str, Any]]) -> dict[str, Any]:
    """Return what `relief.js` takes: all reliefs and the colours they share."""
    return {"colours": colours(), "reliefs": reliefs}

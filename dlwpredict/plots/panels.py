"""Drawing into given axes: maps, differences, profiles; true proportions, row 0 on top, safe for the colour-blind."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from scipy import ndimage

from dlwpredict.heightmap import HeightMap

HEIGHT_COLOURS, DIFFERENCE_COLOURS, CERTAINTY_COLOURS = "cividis", "RdBu_r", "Purples"
NOT_MEASURED, BELOW = "0.8", "k"

Style = dict[str, Any]
"""Keywords of matplotlib."""

REFERENCE_LINE: Style = {"color": "0.25", "lw": 1.6}
TEST_LINE: Style = {"color": "#D55E00", "lw": 1.1}  # vermilion of Okabe and Ito
THIRD_LINE: Style = {"color": "#0072B2", "lw": 1.1, "ls": (0, (4, 2))}  # their blue
FOURTH_LINE: Style = {"color": "#009E73", "lw": 1.1, "ls": (0, (1, 1))}  # their green
LINES = (REFERENCE_LINE, TEST_LINE, THIRD_LINE, FOURTH_LINE)

WALL = 0.3
"""A wall is a change of height by this share of the whole range ..."""
NEAR_WALL = 0.01
"""... within this share of the map's shorter side, at least two pixels."""

TINY_UM = 1e-3
"""Ticks of heights below this are written with their own exponents."""


def difference_um(test: HeightMap, reference: HeightMap) -> np.ndarray:
    """Return test − reference on one grid, µm, shape (rows, cols); the mean is taken off where heights are relative."""
    values = test.heights_um - reference.heights_um
    if "relative" in (test.height_reference, reference.height_reference) and not np.isnan(values).all():
        values = values - np.nanmean(values)
    return values


def inside(height_map: HeightMap) -> np.ndarray:
    """Return where the part is, away from walls, shape (rows, cols); all measured points where that leaves too few.

    Colour ranges are taken there: a wall a hair out of place differs by its whole height and would hide all else, and
    the bare substrate (0) around a relief on a tall block would take most of the colours.
    """
    heights = height_map.heights_um
    known = ~np.isnan(heights)
    if not known.any():
        return known
    low, high = heights[known].min(), heights[known].max()
    relative = low < -0.05 * high  # no substrate at 0: relative heights, a difference
    part = known & (relative | (heights > 0.05 * high))
    size = 2 * max(2, round(NEAR_WALL * min(heights.shape))) + 1
    highest = ndimage.maximum_filter(np.where(known, heights, -np.inf), size)
    lowest = ndimage.minimum_filter(np.where(known, heights, np.inf), size)
    flat = part & (highest - lowest < WALL * (high - low))
    for chosen in (flat, part):
        if chosen.sum() > 0.2 * part.sum():
            return chosen
    return known


def height_limits(*maps: HeightMap) -> tuple[float, float]:
    """Return the colour range that shows the relief, µm: the central 99 % inside the part, the substrate if near."""
    heights = np.concatenate([height_map.heights_um[inside(height_map)] for height_map in maps])
    if heights.size == 0:
        return 0.0, 1.0
    low, high = np.percentile(heights, (0.5, 99.5))
    if 0 < low < 0.5 * high or high - low < 0.05 * abs(high):
        low = min(
            low, *(np.nanpercentile(height_map.heights_um, 0.5) for height_map in maps if inside(height_map).any())
        )
    return float(low), float(high if high > low else low + 1e-3)


def difference_limit(*differences: np.ndarray) -> float:
    """Return the limit c of a colour range −c to c: the 98th percentile of the absolute values, µm."""
    values = np.concatenate([abs(difference[~np.isnan(difference)]).ravel() for difference in differences])
    limit = float(np.percentile(values, 98)) if values.size else 0.0
    return limit or float(values.max(initial=0.0)) or 1e-3


def show_map(
    axes: Axes,
    height_map: HeightMap,
    *,
    title: str = "",
    limits_um: tuple[float, float] | None = None,
    colours: str = HEIGHT_COLOURS,
    label: str = "height / µm",
    bar_um: float | None = None,
) -> AxesImage:
    """Draw a height map with colour bar and scale bar; x and y in µm from its centre, points not measured in grey.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    height_map : HeightMap
    title, label : str
        Above the map, and beside the colour bar.
    limits_um : tuple of float, optional
        Heights of the first and last colour; `height_limits` if not given.
    colours : str
        Name of a matplotlib colour map.
    bar_um : float, optional
        Length of the scale bar; a round one that suits the map if not given.
    """
    low, high = limits_um or height_limits(height_map)
    width, depth = height_map.size_um
    image = axes.imshow(
        height_map.heights_um,
        extent=(-width / 2, width / 2, -depth / 2, depth / 2),
        origin="upper",
        aspect="equal",
        interpolation="none",
        cmap=matplotlib.colormaps[colours].with_extremes(under=BELOW if colours == HEIGHT_COLOURS else None),
        vmin=low,
        vmax=high,
    )
    axes.set_facecolor(NOT_MEASURED)
    axes.set(xlabel="x / µm", ylabel="y / µm")
    axes.set_title(title, loc="left", pad=16)
    known = height_map.heights_um[~np.isnan(height_map.heights_um)]
    below, above = bool((known < low).any()), bool((known > high).any())
    extend = "both" if below and above else "min" if below else "max" if above else "neither"
    beside = axes.inset_axes((1.04, 0, 0.05, 1))
    tiny = "%g" if max(abs(low), abs(high)) < TINY_UM else None  # else a power of ten lies over the scale bar
    bar = axes.figure.colorbar(image, cax=beside, label=label, extend=extend, extendfrac=0.04, format=tiny)
    bar.outline.set_linewidth(0.6)
    show_scale_bar(axes, width, bar_um or round_length(0.3 * width))
    return image


def show_scale_bar(axes: Axes, width_um: float, length_um: float) -> None:
    """Draw a bar of a length above the upper right corner of a map of a width, so that it hides nothing."""
    start, end = width_um / 2 - length_um, width_um / 2
    place: Style = {"transform": axes.get_xaxis_transform(), "clip_on": False}
    axes.plot((start, end), (1.045, 1.045), color="k", lw=2.2, solid_capstyle="butt", scalex=False, **place)
    size = 0.8 * matplotlib.rcParams["font.size"]
    axes.text(start, 1.045, f"{length_um:g} µm ", ha="right", va="center_baseline", fontsize=size, **place)


def round_length(most: float) -> float:
    """Return the largest 1, 2 or 5 times a power of ten that is not above this.

    >>> round_length(0.3), round_length(19.9), round_length(50)
    (0.2, 10.0, 50.0)
    """
    power = math.floor(math.log10(most * (1 + 1e-9)))
    step = max(step for step in (1, 2, 5) if step <= most * (1 + 1e-9) / 10.0**power)
    return float(f"{step}e{power}")


def show_difference(
    axes: Axes,
    difference: HeightMap,
    *,
    title: str = "",
    limit_um: float | None = None,
    label: str = "difference / µm",
    bar_um: float | None = None,
) -> AxesImage:
    """Draw a difference of heights: white at 0, red above, blue below, up to ± ``limit_um`` (`difference_limit`)."""
    limit = limit_um or difference_limit(difference.heights_um)
    limits = -limit, limit
    return show_map(
        axes, difference, title=title, limits_um=limits, colours=DIFFERENCE_COLOURS, label=label, bar_um=bar_um
    )


def show_profiles(axes: Axes, maps: Sequence[HeightMap], *, axis: str, names: Sequence[str]) -> None:
    """Draw the heights along x or y through the centre of up to four maps; what lies between the first two is shaded.

    Parameters
    ----------
    maps, names : sequence
        The reference first.
    axis : {"x", "y"}
    """
    for height_map, name, line in zip(maps, names, LINES, strict=False):
        axes.plot(*profile(height_map, axis), label=name, **line)
    if len(maps) > 1:
        (along, reference), (_, test) = (profile(height_map, axis) for height_map in maps[:2])
        axes.fill_between(along, reference, test, color=TEST_LINE["color"], alpha=0.15, lw=0)
    axes.set(xlabel=f"{axis} / µm", ylabel="height / µm")
    axes.margins(x=0)
    axes.grid(color="0.9", lw=0.6)
    axes.spines[["top", "right"]].set_visible(False)


def profile(height_map: HeightMap, axis: str) -> tuple[np.ndarray, np.ndarray]:
    """Return position and height along x or y through the centre, µm, rising.

    An even number of rows (columns) has no middle one: the one just below (right of) the centre is taken.
    """
    rows, cols = height_map.shape
    if axis == "x":
        return height_map.x_um, height_map.heights_um[rows // 2]
    return height_map.y_um[::-1], height_map.heights_um[::-1, cols // 2]

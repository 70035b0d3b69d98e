"""Pictures of a diagnosed pair, as data URIs: maps on one colour range, profiles through the worst place."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from scipy import ndimage

from dlwpredict.heightmap import HeightMap
from dlwpredict.noise.spectrum import Spectrum
from dlwpredict.plots import drawn
from dlwpredict.plots.panels import (
    CERTAINTY_COLOURS,
    REFERENCE_LINE,
    TEST_LINE,
    THIRD_LINE,
    Style,
    difference_limit,
    show_difference,
    show_map,
)

BASELINE_LINE = THIRD_LINE
MAP_INCHES, PROFILE_INCHES = (3.1, 2.44), (4.7, 3.5)

MOST_PIXELS = 360_000
"""Pixels of all maps of a page together; at about four bytes each, the page stays below 3 MB."""

LARGEST_MAP = 90_000
"""Pixels of one map, 300 × 300: more than its place on the page can show."""

SMOOTH_PX = 2.0
"""Standard deviation of the smoothing by which the worst place is found, so that no single spike is."""

SPIKES = 2.0
"""Profiles of differences end at this multiple of the maps' colour range: walls a hair apart differ by their height."""


@dataclass(frozen=True, eq=False)
class PairMaps:
    """What a diagnosis shows of one pair, all in µm and of shape (rows, cols).

    Parameters
    ----------
    name : str
        File name of the recording.
    target, measured : HeightMap
        On one grid; NaN in the recording does not count.
    before_um, after_um : numpy.ndarray
        Baseline and extended prediction as the instrument would show them.
    residual_um, explained_um, remainder_um : numpy.ndarray
        Recording − baseline prediction; what named effects add; recording − extended prediction. NaN: does not count.
    mismatch : numpy.ndarray
        0 to 1: how surely this place differs beyond noise.
    spectra : pair of Spectrum, optional
        Of the remainder, along x and y.
    """

    name: str
    target: HeightMap
    measured: HeightMap
    before_um: np.ndarray
    after_um: np.ndarray
    residual_um: np.ndarray
    explained_um: np.ndarray
    remainder_um: np.ndarray
    mismatch: np.ndarray
    spectra: tuple[Spectrum, Spectrum] | None = None


@dataclass(frozen=True)
class Picture:
    """An image with its caption.

    Parameters
    ----------
    source : str
        Data URI.
    title, text : str
        What it shows, and how to read it.
    """

    source: str
    title: str
    text: str


def page_style() -> AbstractContextManager[None]:
    """Set matplotlib up for pictures on a page."""
    return matplotlib.rc_context({"font.size": 8.0, "axes.linewidth": 0.6, "svg.fonttype": "path"})


def pictures(
    pair: PairMaps, locations: Sequence[Mapping[str, Any]], *, noise_um: float, pixels: int, named: bool
) -> tuple[list[Picture], list[Picture]]:
    """Return maps and profiles of a pair; what named effects add is left out where none was named.

    Parameters
    ----------
    pair : PairMaps
    locations : sequence of mapping
        Of this pair, as in diagnosis.yaml; numbered from 1, framed on the mismatch.
    noise_um : float
    pixels : int
        A map with more is drawn on coarser pixels.
    named : bool
        Whether an effect was named.
    """
    with page_style():
        return _maps(pair, locations, pixels, named), _profiles(pair, noise_um, named)


def _maps(pair: PairMaps, locations: Sequence[Mapping[str, Any]], pixels: int, named: bool) -> list[Picture]:
    """Return residual, mismatch, explained and remainder."""
    limit = difference_limit(pair.residual_um)
    unknown = np.isnan(pair.residual_um)
    differences = [("Residual", "recording − baseline prediction", pair.residual_um)]
    if named:
        differences += [
            ("Explained", "what the named effects add", np.where(unknown, np.nan, pair.explained_um)),
            ("Remainder", "recording − extended prediction", pair.remainder_um),
        ]
    shown = []
    for title, text, values in differences:
        figure, axes = map_axes()
        show_difference(axes, coarser(pair.target, values, pixels), limit_um=limit)
        if title == "Residual":
            _cross(axes, pair)
        shown.append(Picture(uri(figure), title, text))
    figure, axes = map_axes()
    certain = coarser(pair.target, np.where(unknown, np.nan, pair.mismatch), pixels)
    show_map(axes, certain, limits_um=(0, 1), colours=CERTAINTY_COLOURS, label="mismatch")
    _frames(axes, locations)
    shown.insert(
        1,
        Picture(uri(figure), "Mismatch", "0: within noise; 1: surely beyond it"),
    )
    return shown


def _profiles(pair: PairMaps, noise_um: float, named: bool) -> list[Picture]:
    """Return profiles along x and y through the worst place: heights above, differences below, ± noise shaded."""
    row, col = worst_place(pair.residual_um)
    x, y = pair.target.x_um, pair.target.y_um[::-1]
    across, up = (row, slice(None)), (slice(None, None, -1), col)
    return [
        _profile(pair, across, "x", x, x[col], f"along x at y = {y[-1 - row]:.3g} µm", noise_um, named),
        _profile(pair, up, "y", y, y[-1 - row], f"along y at x = {x[col]:.3g} µm", noise_um, named),
    ]


def worst_place(residual_um: np.ndarray) -> tuple[int, int]:
    """Return row and column of the largest absolute smoothed residual among the points that count."""
    smooth = np.abs(ndimage.gaussian_filter(np.nan_to_num(residual_um), SMOOTH_PX))
    row, col = np.unravel_index(np.argmax(np.where(np.isnan(residual_um), -1.0, smooth)), smooth.shape)
    return int(row), int(col)


def coarser(grid: HeightMap, values: np.ndarray, pixels: int) -> HeightMap:
    """Return values on at most so many pixels of the same area: means over what each pixel covers, NaN left out.

    Parameters
    ----------
    grid : HeightMap
        Gives the pitch.
    values : numpy.ndarray, shape (rows, cols)
    pixels : int
    """
    factor = np.sqrt(values.size / pixels)
    if factor <= 1:
        return HeightMap(values, grid.dx_um, grid.dy_um)
    down, across = (_shares(n, max(int(n / factor), 2)) for n in values.shape)
    known = down @ np.isfinite(values) @ across.T
    sums = down @ np.nan_to_num(values) @ across.T
    means = np.where(known > 0.5 * known.max(), sums / np.maximum(known, 1e-12), np.nan)
    return HeightMap(means, grid.size_um[0] / means.shape[1], grid.size_um[1] / means.shape[0])


def _shares(fine: int, coarse: int) -> np.ndarray:
    """Return the lengths by which coarse pixels overlap fine ones, in fine pixels, shape (coarse, fine)."""
    edges, cells = np.linspace(0, fine, coarse + 1), np.arange(fine)
    overlap = np.minimum(edges[1:, None], cells + 1) - np.maximum(edges[:-1, None], cells)
    return np.maximum(overlap, 0)


def map_axes() -> tuple[Figure, Axes]:
    """Return axes at a fixed place, so that all maps stand alike beside each other."""
    figure = Figure(figsize=MAP_INCHES)
    return figure, figure.add_axes((0.17, 0.16, 0.55, 0.76))


def uri(figure: Figure) -> str:
    """Return a figure as the address of a picture within the page."""
    return "data:image/svg+xml;base64," + base64.b64encode(drawn(figure, "svg", dpi=96)).decode("ascii")


def _cross(axes: Axes, pair: PairMaps) -> None:
    """Mark row and column of the worst place."""
    row, col = worst_place(pair.residual_um)
    line: Style = {"color": "0.15", "lw": 0.7, "ls": (0, (5, 4)), "alpha": 0.8}
    axes.axhline(pair.target.y_um[row], **line)
    axes.axvline(pair.target.x_um[col], **line)


def _frames(axes: Axes, locations: Sequence[Mapping[str, Any]]) -> None:
    """Frame and number the places."""
    left, right = axes.get_xlim()
    for number, place in enumerate(locations, start=1):
        (x, x_end), (y, y_end) = place["x_um"], place["y_um"]
        axes.add_patch(Rectangle((x, y), x_end - x, y_end - y, fill=False, ec="k", lw=0.9, ls=(0, (4, 2))))
        box = {"boxstyle": "circle,pad=0.15", "fc": "w", "ec": "k", "lw": 0.7}
        inset = 0.04 * (right - left)
        axes.text(x + inset, y_end - inset, str(number), ha="center", va="center", fontsize=7, bbox=box, clip_on=True)
    axes.set_xlim(left, right)


def _profile(
    pair: PairMaps, line: tuple, axis: str, at: np.ndarray, worst: float, title: str, noise_um: float, named: bool
) -> Picture:
    """Return one profile: the points of a line, their coordinates on its axis, and the worst place there, µm."""
    figure = Figure(figsize=PROFILE_INCHES, layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(1.25, 1))
    above.plot(at, pair.measured.heights_um[line], label="recording", **REFERENCE_LINE)
    above.plot(at, pair.before_um[line], label="baseline", **BASELINE_LINE)
    below.axhspan(-noise_um, noise_um, color="0.88", lw=0, label="± noise")
    below.axhline(0, color="0.6", lw=0.6)
    below.plot(at, pair.residual_um[line], label="recording − baseline", **BASELINE_LINE)
    if named:
        above.plot(at, pair.after_um[line], label="extended", **TEST_LINE)
        below.plot(at, pair.remainder_um[line], label="recording − extended", **TEST_LINE)
    limit = max(SPIKES * difference_limit(pair.residual_um), 3 * noise_um)
    below.set_ylim(*np.clip(below.get_ylim(), -limit, limit))
    above.set_ylabel("height / µm")
    below.set(xlabel=f"{axis} / µm", ylabel="difference / µm")
    for axes in (above, below):
        axes.axvline(worst, color="0.15", lw=0.7, ls=(0, (5, 4)), alpha=0.8)
        axes.margins(x=0)
        axes.grid(color="0.92", lw=0.6)
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, ncols=3, loc="lower left", bbox_to_anchor=(0, 0.98), borderaxespad=0, fontsize=7)
    return Picture(uri(figure), f"Profile {title}", "dashed: the worst place, as on the residual; spikes are cut")

"""Whole figures of height maps: maps that are compared share one colour range, and profiles stand below them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure, SubFigure

from dlwpredict.heightmap import HeightMap, require_same_grid
from dlwpredict.plots.panels import (
    CERTAINTY_COLOURS,
    Style,
    difference_limit,
    difference_um,
    height_limits,
    inside,
    show_difference,
    show_map,
    show_profiles,
)

PANEL_INCHES = 3.65, 3.6
"""Width and height of a map with its title, axes and colour bar."""


def overview(height_map: HeightMap, *, name: str, caption: str = "") -> Figure:
    """Draw one map with its x- and y-profiles through the centre."""
    return _sheet([(name, height_map)], caption=caption)


def comparison(
    reference: HeightMap, test: HeightMap, *, names: tuple[str, str] = ("target", "test"), caption: str = ""
) -> Figure:
    """Draw reference, test, their difference (test − reference), and x- and y-profiles through the centre.

    Raises
    ------
    InputError
        The grids differ.
    """
    require_same_grid(reference, test, names)
    return _sheet(list(zip(names, (reference, test), strict=True)), caption=caption)


def correction(
    target: HeightMap, corrected: HeightMap, predicted: HeightMap, reachable: np.ndarray, *, caption: str = ""
) -> Figure:
    """Draw target, the print predicted of the corrected design, that design, the error left, and profiles of all three.

    Parameters
    ----------
    target, corrected, predicted : HeightMap
        On one grid.
    reachable : numpy.ndarray of bool, shape (rows, cols)
        Where the print answers to what is written; elsewhere the error is not shown.
    caption : str
    """
    maps = [("target", target), ("predicted print", predicted), ("corrected design", corrected)]
    return _sheet(maps, caption=caption, judged=reachable, where=" in reach")


def calibration(
    rows: Sequence[tuple[str, HeightMap, HeightMap, HeightMap, np.ndarray]], *, caption: str = ""
) -> Figure:
    """Draw target, recording, prediction and residual of every recording, one row for each.

    Parameters
    ----------
    rows : sequence of (name, target, recording, prediction, residual_um)
        On one grid each; the residual is NaN where a point did not count.
    caption : str
    """
    figure, strips = _strips([row[0] for row in rows], caption)
    limit = difference_limit(*(row[-1] for row in rows))
    for panels, (_, *maps, residual) in zip(strips, rows, strict=True):
        limits = height_limits(*maps)
        for axes, height_map, title in zip(panels, maps, ("target", "recording", "prediction"), strict=False):
            show_map(axes, height_map, title=title, limits_um=limits)
        show_difference(panels[3], maps[0].with_heights(residual), title="recording − prediction", limit_um=limit)
    return figure


def diagnosis(
    rows: Sequence[tuple[str, HeightMap, np.ndarray, np.ndarray, np.ndarray, np.ndarray]], *, caption: str = ""
) -> Figure:
    """Draw residual, mismatch, what named effects explain and the remainder of every recording, one row for each.

    Parameters
    ----------
    rows : sequence of (name, target, residual_um, mismatch, explained_um, remainder_um)
        On one grid each; NaN where a point did not count.
    caption : str
    """
    figure, strips = _strips([row[0] for row in rows], caption)
    limit = difference_limit(*(row[2] for row in rows))
    for panels, (_, target, residual, mismatch, explained, remainder) in zip(strips, rows, strict=True):
        shown = {"recording − prediction": residual, "explained by the named": explained, "remainder": remainder}
        for axes, (title, values) in zip(panels[[0, 2, 3]], shown.items(), strict=True):
            show_difference(axes, target.with_heights(values), title=title, limit_um=limit)
        show_map(
            panels[1], target.with_heights(mismatch), title="beyond noise: how surely", limits_um=(0, 1),
            colours=CERTAINTY_COLOURS, label="1 − p",
        )  # fmt: skip
    return figure


def _strips(names: Sequence[str], caption: str) -> tuple[Figure, list[np.ndarray]]:
    """Return a figure with a named row of four panels for each of the names, and the panels."""
    width, height = PANEL_INCHES
    figure = Figure(figsize=(4 * width, len(names) * (height - 0.4) + 0.4), layout="constrained")
    parts = figure.subfigures(len(names), 1, squeeze=False)[:, 0]
    for part, name in zip(parts, names, strict=True):
        part.suptitle(name, fontsize=11, x=0.01, ha="left")
    figure.suptitle(caption, fontsize=10)
    return figure, [part.subplots(1, 4) for part in parts]


def _sheet(
    maps: Sequence[tuple[str, HeightMap]], *, caption: str, judged: np.ndarray | bool = True, where: str = ""
) -> Figure:
    """Draw maps on one colour range, second − first where there are two, and profiles through the centre of all.

    The difference is shown where it is judged; `where` says so.
    """
    names, shown = zip(*maps, strict=True)
    columns = len(maps) + (len(maps) > 1)
    above, below = _halves(columns)
    panels = above.subplots(1, columns, squeeze=False)[0]
    limits = height_limits(*shown)
    for letter, axes, name, height_map in zip("abcd", panels, names, shown, strict=False):
        show_map(axes, height_map, title=f"({letter}) {name}" if columns > 1 else name, limits_um=limits)
    if len(maps) > 1:
        change = np.where(judged, difference_um(shown[1], shown[0]), np.nan)
        limit = difference_limit(np.where(inside(shown[0]), change, np.nan))
        title = f"({'abcd'[columns - 1]}) difference (b) − (a){where}"
        show_difference(panels[-1], shown[0].with_heights(change), title=title, limit_um=limit)
    for axes in panels:
        cross: Style = {
            "color": "0.4" if axes is panels[-1] and columns > 1 else "w",
            "lw": 0.6,
            "ls": (0, (6, 6)),
            "alpha": 0.8,
        }
        axes.axhline(0, **cross)
        axes.axvline(0, **cross)
    first, second = below.subplots(*((2, 1) if columns == 1 else (1, 2)), sharey=True)
    for axes, axis in ((first, "x"), (second, "y")):
        show_profiles(axes, shown, axis=axis, names=names)
        axes.set_title(f"{axis}-profile", loc="left")
    if len(maps) > 1:
        second.set_ylabel("")
        second.legend(frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1, 0.98), borderaxespad=0)
    if caption:
        first.figure.figure.suptitle(caption, fontsize=10)
    return first.figure.figure


def _halves(columns: int) -> tuple[SubFigure, SubFigure]:
    """Return a place for the maps and one for the profiles: side by side for a single map, else one above the other."""
    width, height = PANEL_INCHES
    if columns == 1:
        figure = Figure(figsize=(2.6 * width, height + 0.4), layout="constrained")
        left, right = figure.subfigures(1, 2, squeeze=False, width_ratios=(1, 1.35))[0]
        return left, right
    figure = Figure(figsize=(columns * width, height + 2.8), layout="constrained")
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=(height, 2.6))[:, 0]
    return above, below

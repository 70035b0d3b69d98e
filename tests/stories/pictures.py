"""The pictures of the stories: rows of maps, and bars."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from dlwpredict.heightmap import HeightMap
from dlwpredict.plots import save
from dlwpredict.plots.panels import (
    LINES,
    difference_limit,
    height_limits,
    inside,
    show_difference,
    show_map,
)
from dlwpredict.plots.sheets import PANEL_INCHES

COLOURS = ("0.6", "#0072B2", "#D55E00", "#009E73")
"""Of the bars: grey, then blue, vermilion and green of Okabe and Ito."""


def maps(path: Path, shown: Mapping[str, HeightMap], differences: Mapping[str, HeightMap]) -> None:
    """Draw height maps and then differences side by side; each kind shares one colour range."""
    count, (width, height) = len(shown) + len(differences), PANEL_INCHES
    figure = Figure(figsize=(count * width, height), layout="constrained")
    panels = figure.subplots(1, count, squeeze=False)[0]
    heights = height_limits(*shown.values()) if shown else None
    for axes, (title, one) in zip(panels, shown.items(), strict=False):
        show_map(axes, one, title=title, limits_um=heights)
    limit = difference_limit(*(one.heights_um for one in differences.values())) if differences else None
    for axes, (title, one) in zip(panels[len(shown) :], differences.items(), strict=True):
        show_difference(axes, one, title=title, limit_um=limit)
    save(path, figure, dpi=100)


def bars(
    path: Path, groups: Sequence[str], series: Mapping[str, Sequence[float]], *, noise_um: float | None = None
) -> None:
    """Draw errors in nm as bars, one group per recording, with the noise as a line if given."""
    figure = Figure(figsize=(1.6 + 1.7 * len(groups), 3.4), layout="constrained")
    axes, wide = figure.subplots(), 0.8 / len(series)
    for k, ((name, values), colour) in enumerate(zip(series.items(), COLOURS, strict=False)):
        places = np.arange(len(groups)) + (k - (len(series) - 1) / 2) * wide
        drawn = axes.bar(places, 1e3 * np.asarray(values), 0.94 * wide, color=colour, label=name)
        axes.bar_label(drawn, fmt="%.1f", fontsize=8)
    if noise_um is not None:
        axes.axhline(1e3 * noise_um, color="k", lw=0.8, ls="--", label="noise")
    axes.set_xticks(range(len(groups)), groups)
    axes.set(ylabel="rmse / nm")
    axes.margins(y=0.15)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1, 1))
    save(path, figure, dpi=100)


def profiles(path: Path, shown: Mapping[str, Mapping[str, tuple[np.ndarray, np.ndarray]]]) -> None:
    """Draw curves (position in µm, error in µm) by panel and name."""
    figure = Figure(figsize=(4.6 * len(shown), 3.2), layout="constrained")
    panels = figure.subplots(1, len(shown), squeeze=False, sharey=True)[0]
    for axes, (title, curves) in zip(panels, shown.items(), strict=True):
        for (name, (place, height)), line in zip(curves.items(), LINES, strict=False):
            axes.plot(place, 1e3 * height, label=name, **line)
        axes.set_title(title, loc="left")
        axes.set(xlabel="place / µm")
        axes.grid(color="0.9", lw=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("recording − prediction / nm")
    panels[-1].legend(frameon=False, fontsize=8)
    save(path, figure, dpi=100)


def error(reference: HeightMap, test: HeightMap) -> HeightMap:
    """Return test − reference inside the reference's part, away from its walls; NaN elsewhere."""
    return within(reference, reference.with_heights(test.heights_um - reference.heights_um))


def within(part: HeightMap, shown: HeightMap) -> HeightMap:
    """Return a map inside a part, away from its walls; NaN elsewhere."""
    return shown.with_heights(np.where(inside(part), shown.heights_um, np.nan))


def along(one: HeightMap, axis: str) -> tuple[np.ndarray, np.ndarray]:
    """Return position and mean height of a map along x or y; positions without a value are left out."""
    known = ~np.isnan(one.heights_um)
    across = 0 if axis == "x" else 1
    counts = known.sum(axis=across)
    place, means = one.x_um if axis == "x" else one.y_um, np.nansum(one.heights_um, axis=across)
    kept = counts > 0.25 * counts.max()
    order = np.argsort(place[kept])
    return place[kept][order], (means[kept] / counts[kept])[order]

"""Pictures of height maps for papers and reports: row 0 on top, true proportions, µm, safe for the colour-blind.

`show_map`, `show_difference` and `show_profile` draw into given axes; `comparison` puts them together. Only the object
interface of matplotlib is used: no global state, no display.
"""

from __future__ import annotations

import io
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from dlwpredict.files.atomic import replacing
from dlwpredict.heightmap import HeightMap, require_same_grid

HEIGHT_COLOURS, DIFFERENCE_COLOURS = "cividis", "RdBu_r"
NOT_MEASURED = "0.8"
REFERENCE_LINE = {"color": "0.25", "lw": 1.6}
TEST_LINE = {"color": "#D55E00", "lw": 1.1}  # vermilion of Okabe and Ito


def height_limits(*maps: HeightMap) -> tuple[float, float]:
    """Return the colour range that shows the relief, µm: the central 99 % of the part, from 0 if the part starts low.

    Where the relief stands on a tall block, the bare substrate (0) around it would take most of the colours.
    """
    heights = np.concatenate([one.heights_um[~np.isnan(one.heights_um)] for one in maps])
    if heights.size == 0:
        return 0.0, 1.0
    part = heights[heights > 0.05 * heights.max()]
    if part.size == 0 or heights.min() < -0.05 * heights.max():  # no substrate at 0: relative heights, a difference
        part = heights
    low, high = np.percentile(part, (0.5, 99.5))
    if 0 < low < 0.5 * high or high - low < 0.05 * abs(high):
        low = min(0.0, low)
    return float(low), float(high if high > low else low + 1e-3)


def difference_limit(*differences: np.ndarray) -> float:
    """Return the limit c of a colour range −c to c: the 98th percentile of the absolute values, µm."""
    values = np.concatenate([abs(one[~np.isnan(one)]).ravel() for one in differences])
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
) -> AxesImage:
    """Draw a height map with its colour bar; x and y in µm from the map's centre, points not measured in grey.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        On a figure with constrained layout.
    height_map : HeightMap
    title, label : str
        Above the map, and beside the colour bar.
    limits_um : tuple of float, optional
        Heights of the first and last colour; `height_limits` if not given.
    colours : str
        Name of a matplotlib colour map.
    """
    low, high = limits_um or height_limits(height_map)
    width, depth = height_map.size_um
    image = axes.imshow(
        height_map.heights_um,
        extent=(-width / 2, width / 2, -depth / 2, depth / 2),
        origin="upper",
        aspect="equal",
        interpolation="none",
        cmap=colours,
        vmin=low,
        vmax=high,
    )
    axes.set_facecolor(NOT_MEASURED)
    axes.set(title=title, xlabel="x / µm", ylabel="y / µm")
    known = height_map.heights_um[~np.isnan(height_map.heights_um)]
    below, above = bool((known < low).any()), bool((known > high).any())
    extend = "both" if below and above else "min" if below else "max" if above else "neither"
    beside = axes.inset_axes((1.04, 0, 0.05, 1))
    axes.figure.colorbar(image, cax=beside, label=label, extend=extend, extendfrac=0.04).outline.set_linewidth(0.6)
    return image


def show_difference(
    axes: Axes, difference: HeightMap, *, title: str = "", limit_um: float | None = None, label: str = "difference / µm"
) -> AxesImage:
    """Draw a difference of heights: white at 0, red above, blue below, up to ± ``limit_um`` (`difference_limit`)."""
    limit = limit_um or difference_limit(difference.heights_um)
    return show_map(axes, difference, title=title, limits_um=(-limit, limit), colours=DIFFERENCE_COLOURS, label=label)


def show_profile(axes: Axes, maps: tuple[HeightMap, HeightMap], *, axis: str, names: tuple[str, str]) -> None:
    """Draw the heights along x or y through the centre of reference and test, what lies between them shaded.

    Parameters
    ----------
    maps, names : tuple
        Reference, then test.
    axis : {"x", "y"}
    """
    (along, reference), (_, test) = (profile(one, axis) for one in maps)
    axes.fill_between(along, reference, test, color=TEST_LINE["color"], alpha=0.15, lw=0)
    axes.plot(along, reference, label=names[0], **REFERENCE_LINE)
    axes.plot(along, test, label=names[1], **TEST_LINE)
    axes.set(xlabel=f"{axis} / µm", ylabel="height / µm")
    axes.set_title(f"{axis}-profile through the centre", loc="left")
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
    difference = test.with_heights(test.heights_um - reference.heights_um)
    figure = Figure(figsize=(11, 6.2), layout="constrained")
    rows = figure.subfigures(2, 1, height_ratios=(1.35, 1))
    first, second, third = rows[0].subplots(1, 3)
    limits = height_limits(reference, test)
    show_map(first, reference, title=f"(a) {names[0]}", limits_um=limits)
    show_map(second, test, title=f"(b) {names[1]}", limits_um=limits)
    show_difference(third, difference, title="(c) difference (b) − (a)")
    for axes in (first, second, third):
        cross = {"color": "0.4" if axes is third else "w", "lw": 0.6, "ls": (0, (6, 6)), "alpha": 0.8}
        axes.axhline(0, **cross)
        axes.axvline(0, **cross)
    left, right = rows[1].subplots(1, 2, sharey=True)
    show_profile(left, (reference, test), axis="x", names=names)
    show_profile(right, (reference, test), axis="y", names=names)
    right.set_ylabel("")
    left.legend(frameon=False, ncols=2, loc="lower right", bbox_to_anchor=(1, 0.98), borderaxespad=0)
    if caption:
        figure.suptitle(caption, fontsize=10)
    return figure


def save(path: Path | str, figure: Figure, *, dpi: float = 200) -> None:
    """Write a figure whole or not at all; the same figure gives the same bytes."""
    with replacing(path) as temporary:
        temporary.write_bytes(drawn(figure, Path(path).suffix.lower().lstrip("."), dpi=dpi))


def drawn(figure: Figure, kind: str, *, dpi: float = 200) -> bytes:
    """Return a figure as png, pdf or svg; the same figure gives the same bytes (no date, no program name)."""
    silent = {
        "png": {"Software": None},
        "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
        "svg": {"Date": None, "Creator": None},
    }
    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "dlwpredict"}):
        figure.savefig(buffer, format=kind, dpi=dpi, metadata=silent.get(kind))
    return buffer.getvalue()

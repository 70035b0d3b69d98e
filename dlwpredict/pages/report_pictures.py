"""Pictures of a structure and its prints: maps on shared colour ranges, profiles through the centre."""

from __future__ import annotations

from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from dlwpredict.heightmap import HeightMap
from dlwpredict.pages.pictures import PROFILE_INCHES, STYLE, Picture, coarser, map_axes, uri
from dlwpredict.pages.run_folder import DESIGNS, Print, Structure
from dlwpredict.plots.panels import (
    LINES,
    difference_limit,
    difference_um,
    height_limits,
    inside,
    round_length,
    show_difference,
    show_map,
    show_profiles,
)

SURFACES = {
    "target": "target",
    "written": "design written",
    "aligned": "print",
    "predicted": "predicted print",
    "corrected": "corrected design",
    "reprinted": "print of the corrected design",
}
"""Maps whose heights count from the same zero."""


@dataclass(frozen=True)
class Ranges:
    """What all maps of a structure share, µm: colours of heights, print − target, print − prediction; scale bar."""

    heights: tuple[float, float]
    error: float
    surprise: float
    bar: float


@dataclass(frozen=True, eq=False)
class Surface:
    """A map of a structure with its name; designs are coloured by their own range, all others by the shared one."""

    name: str
    role: str
    height_map: HeightMap

    def limits(self, shared: Ranges) -> tuple[float, float]:
        """Return the heights of the first and the last colour."""
        return height_limits(self.height_map) if self.role in DESIGNS else shared.heights


def surfaces(structure: Structure) -> list[Surface]:
    """Return every map whose heights count from the same zero, the target first; a design equal to it is left out."""
    found = [Surface("target", "target", structure.target)] if structure.target else []
    for one in structure.prints:
        for role, name in SURFACES.items():
            height_map = one.maps.get(role)
            if height_map and not (role == "written" and _equal(height_map, structure.target)):
                found.append(Surface(f"{name} {one.name}".strip(), role, height_map))
    return found


def ranges(structure: Structure) -> Ranges:
    """Return the colour ranges that all prints of a structure share."""
    target, found = structure.target, surfaces(structure)
    maps = [one.height_map for one in found if one.role not in DESIGNS] or [one.height_map for one in found]
    widths = [
        one.size_um[0] for one in (*maps, *(p.maps["recording"] for p in structure.prints if "recording" in p.maps))
    ]
    pairs = [(one.maps.get(role), target) for one in structure.prints for role in ("aligned", "reprinted")]
    errors = _differences(pairs, target)
    surprises = _differences([(one.maps.get("aligned"), one.maps.get("predicted")) for one in structure.prints], target)
    return Ranges(
        height_limits(*maps) if maps else (0.0, 1.0),
        difference_limit(*errors),
        difference_limit(*surprises),
        round_length(0.3 * min(widths, default=1.0)),
    )


def pictures(structure: Structure, pixels: int) -> tuple[list[tuple[str, list[Picture]]], list[Picture]]:
    """Return maps, grouped by print, and profiles.

    Parameters
    ----------
    structure : Structure
    pixels : int
        A map with more is drawn on coarser pixels.
    """
    shared = ranges(structure)
    with matplotlib.rc_context(STYLE):
        groups = [(one.name, _maps(one, structure.target, shared, pixels)) for one in structure.prints]
        if structure.target:
            first = _map(structure.target, "Target", "what the print shall be", shared.heights, shared.bar, pixels)
            groups = [(name, [first, *found] if k == 0 else found) for k, (name, found) in enumerate(groups)] or [
                ("", [first])
            ]
        return groups, _profiles(structure, shared)


def lead(structure: Structure, pixels: int) -> list[Picture]:
    """Return what a structure comes to, on one colour range: its target, its first print, its last print.

    The last is that of a corrected design, or of a later generation; the corrected design stands there until it is
    printed.
    """
    shared, target, prints = ranges(structure), structure.target, structure.prints
    shown = [("Target", "what the print shall be", target)]
    shown += [("Print", "as it came out first", one.maps["aligned"]) for one in prints if "aligned" in one.maps][:1]
    again = [one.maps["reprinted"] for one in prints if "reprinted" in one.maps]
    later = [one.maps["aligned"] for one in prints if "aligned" in one.maps][1:]
    planned = [one.maps["corrected"] for one in prints if "corrected" in one.maps]
    if again or later:
        shown.append(("Corrected print", "printed again from the corrected design", (again or later)[-1]))
    elif planned:
        shown.append(("Corrected design", "to be printed next", planned[-1]))
    with matplotlib.rc_context(STYLE):
        return [_map(one, title, text, shared.heights, shared.bar, pixels) for title, text, one in shown if one]


def _maps(one: Print, target: HeightMap | None, shared: Ranges, pixels: int) -> list[Picture]:
    """Return the maps of one print, in the order in which they come about."""
    maps, found = one.maps, []
    if "recording" in maps:
        raw = maps["recording"]
        found.append(
            _map(raw, "Recording", "as the microscope gave it; own colours", height_limits(raw), shared.bar, pixels)
        )
    for role, title, text in (
        ("written", "Design written", "for this print; own colours"),
        ("aligned", "Print", "recording aligned to the target"),
        ("predicted", "Predicted print", "by the parameters"),
        ("corrected", "Corrected design", "for the next print; own colours"),
        ("reprinted", "Print", "of the corrected design"),
    ):
        if role not in maps or (role == "written" and _equal(maps[role], target)):
            continue
        limits = Surface(title, role, maps[role]).limits(shared)
        found.append(_map(maps[role], title, text, limits, shared.bar, pixels))
        if role == "reprinted" and "unreachable" in maps:
            within = reachable(maps[role], maps["unreachable"])
            title = "Print − target; grey: out of reach"
            found += _difference(within, target, title, shared.error, shared.bar, pixels)
        elif role in ("aligned", "reprinted"):
            found += _difference(maps[role], target, "Print − target", shared.error, shared.bar, pixels)
        elif role == "corrected" and "unreachable" in maps:
            found += _missing(maps["unreachable"], shared.error, shared.bar, pixels)
        if role == "predicted":
            found += _difference(
                maps.get("aligned"), maps[role], "Print − prediction", shared.surprise, shared.bar, pixels
            )
    return found


def reachable(height_map: HeightMap, unreachable: HeightMap) -> HeightMap:
    """Return a map without the points that no correction reaches (`unreachable`: the height missing there, else 0)."""
    if not height_map.same_grid(unreachable):
        return height_map
    return height_map.with_heights(np.where(unreachable.heights_um == 0, height_map.heights_um, np.nan))


def _missing(unreachable: HeightMap, limit: float, bar: float, pixels: int) -> list[Picture]:
    """Return the map of what a correction must leave missing; none where it reaches everything."""
    if not unreachable.heights_um.any():
        return []
    figure, axes = map_axes()
    show_difference(axes, coarser(unreachable, -unreachable.heights_um, pixels), limit_um=limit, bar_um=bar)
    return [Picture(uri(figure), "Out of reach", "print − target that no correction mends: walls, fine detail")]


def _map(height_map: HeightMap, title: str, text: str, limits: tuple[float, float], bar: float, pixels: int) -> Picture:
    figure, axes = map_axes()
    show_map(axes, coarser(height_map, height_map.heights_um, pixels), limits_um=limits, bar_um=bar)
    return Picture(uri(figure), title, text)


def _difference(
    test: HeightMap | None, reference: HeightMap | None, title: str, limit: float, bar: float, pixels: int
) -> list[Picture]:
    """Return the map of test − reference; none where one is missing or on another grid."""
    values = difference(test, reference)
    if values is None:
        return []
    figure, axes = map_axes()
    show_difference(axes, coarser(reference, values, pixels), limit_um=limit, bar_um=bar)
    free = "relative" in (test.height_reference, reference.height_reference)
    return [
        Picture(uri(figure), title, "without the mean: relative heights" if free else "same colours for all prints")
    ]


def difference(test: HeightMap | None, reference: HeightMap | None) -> np.ndarray | None:
    """Return test − reference, µm, by `difference_um`; None where they do not compare."""
    if test is None or reference is None or not test.same_grid(reference):
        return None
    return difference_um(test, reference)


def _differences(pairs: list[tuple[HeightMap | None, HeightMap | None]], target: HeightMap | None) -> list[np.ndarray]:
    """Return the differences by which a colour range is chosen: away from walls; something in any case."""
    found = [(values, reference) for test, reference in pairs if (values := difference(test, reference)) is not None]
    away = [np.where(inside(target if target and target.same_grid(on) else on), values, np.nan) for values, on in found]
    return away or [np.zeros(1)]


def _profiles(structure: Structure, shared: Ranges) -> list[Picture]:
    """Return profiles along x and y through the centre: target, prints, then the rest, as many as there are lines.

    Heights reach over the colours of all maps shown, the designs' own included.
    """
    maps = surfaces(structure)
    prints = [one for one in maps if one.role in ("aligned", "reprinted")]
    target = [one for one in maps if one.role == "target"]
    rest = [one for one in maps if one not in prints and one not in target]
    chosen = (target + prints[:1] + prints[1:][-2:] + rest)[: len(LINES)]
    chosen = [one for one in chosen if one.height_map.same_grid(chosen[0].height_map)]
    if not chosen:
        return []
    names, lines = [one.name for one in chosen], [one.height_map for one in chosen]
    found, limits = [], [one.limits(shared) for one in chosen]
    low, high = min(one[0] for one in limits), max(one[1] for one in limits)
    for axis in "xy":
        figure = Figure(figsize=(PROFILE_INCHES[0], 2.5), layout="constrained")
        axes = figure.subplots()
        show_profiles(axes, lines, axis=axis, names=names)
        axes.set_ylim(low - 0.2 * (high - low), high + 0.2 * (high - low))
        axes.legend(frameon=False, ncols=2, loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0, fontsize=7)
        found.append(
            Picture(uri(figure), f"Profile along {axis} through the centre", "over the colour range of the maps")
        )
    return found


def _equal(one: HeightMap, other: HeightMap | None) -> bool:
    return (
        other is not None and one.same_grid(other) and np.array_equal(one.heights_um, other.heights_um, equal_nan=True)
    )

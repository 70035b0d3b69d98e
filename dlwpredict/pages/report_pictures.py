"""Pictures of a structure and its prints: maps on shared colour ranges, profiles through the centre."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from dlwpredict.heightmap import HeightMap
from dlwpredict.pages.pictures import PROFILE_INCHES, Picture, coarser, map_axes, page_style, uri
from dlwpredict.pages.run_folder import DESIGNS, PRINTS, Print, Structure
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
    "next": "predicted print of the corrected design",
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
    shown = [Surface("target", "target", structure.target)] if structure.target else []
    for printed in structure.prints:
        for role, name in SURFACES.items():
            height_map = printed.maps.get(role)
            if height_map and not (role == "written" and _equal(height_map, structure.target)):
                shown.append(Surface(f"{name} {printed.name}".strip(), role, height_map))
    return shown


def ranges(structure: Structure) -> Ranges:
    """Return the colour ranges that all prints of a structure share."""
    target, shown = structure.target, surfaces(structure)
    maps = [surface.height_map for surface in shown if surface.role not in DESIGNS]
    maps = maps or [surface.height_map for surface in shown]
    recordings = [printed.maps["recording"] for printed in structure.prints if "recording" in printed.maps]
    widths = [height_map.size_um[0] for height_map in (*maps, *recordings)]
    prints = [printed.maps for printed in structure.prints]
    errors = _differences([(known.get(role), target) for known in prints for role in PRINTS], target)
    surprises = _differences([(known.get("aligned"), known.get("predicted")) for known in prints], target)
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
    with page_style():
        groups = [(printed.name, _maps(printed, structure.target, shared, pixels)) for printed in structure.prints]
        if structure.target:
            first = _map(structure.target, "Target", "what the print shall be", shared.heights, shared.bar, pixels)
            groups = [(name, [first, *maps] if k == 0 else maps) for k, (name, maps) in enumerate(groups)] or [
                ("", [first])
            ]
        return groups, _profiles(structure, shared)


def lead(structure: Structure, pixels: int) -> list[Picture]:
    """Return what a structure comes to, on one colour range: its target, its first print, its last print.

    The last is that of a corrected design, or of a later generation; the corrected design stands there until it is
    printed.
    """
    shared, prints = ranges(structure), structure.prints
    aligned, again, planned = (
        [printed.maps[role] for printed in prints if role in printed.maps]
        for role in ("aligned", "reprinted", "corrected")
    )
    shown = [("Target", "what the print shall be", structure.target)] if structure.target else []
    shown += [("Print", "as it came out first", first) for first in aligned[:1]]
    if again or aligned[1:]:
        shown.append(("Corrected print", "printed again from the corrected design", (again or aligned)[-1]))
    elif planned:
        shown.append(("Corrected design", "to be printed next", planned[-1]))
    with page_style():
        return [_map(height_map, title, text, shared.heights, shared.bar, pixels) for title, text, height_map in shown]


def _maps(printed: Print, target: HeightMap | None, shared: Ranges, pixels: int) -> list[Picture]:
    """Return the maps of one print, in the order in which they come about."""
    maps, shown = printed.maps, []
    if "recording" in maps:
        raw = maps["recording"]
        shown.append(
            _map(raw, "Recording", "as the microscope gave it; own colours", height_limits(raw), shared.bar, pixels)
        )
    for role, title, text in (
        ("written", "Design written", "for this print; own colours"),
        ("aligned", "Print", "recording aligned to the target"),
        ("predicted", "Predicted print", "by the parameters"),
        ("corrected", "Corrected design", "for the next print; own colours"),
        ("next", "Next print", "of the corrected design, predicted"),
        ("reprinted", "Print", "of the corrected design"),
    ):
        if role not in maps or (role == "written" and _equal(maps[role], target)):
            continue
        limits = Surface(title, role, maps[role]).limits(shared)
        shown.append(_map(maps[role], title, text, limits, shared.bar, pixels))
        if role in PRINTS:
            out = maps.get("unreachable") if role != "aligned" else None
            within = reachable(maps[role], out) if out is not None else maps[role]
            title = (
                f"{'Prediction' if role == 'next' else 'Print'} − target{'' if out is None else '; grey: out of reach'}"
            )
            shown += _difference(within, target, title, shared.error, shared.bar, pixels)
        elif role == "corrected" and "unreachable" in maps:
            shown += _missing(maps["unreachable"], shared.error, shared.bar, pixels)
        if role == "predicted":
            shown += _difference(
                maps.get("aligned"), maps[role], "Print − prediction", shared.surprise, shared.bar, pixels
            )
    return shown


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
    if test is None or reference is None or (values := difference(test, reference)) is None:
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
    compared = [
        (values, reference)
        for test, reference in pairs
        if reference is not None and (values := difference(test, reference)) is not None
    ]
    away = [
        np.where(inside(target if target and target.same_grid(on) else on), values, np.nan) for values, on in compared
    ]
    return away or [np.zeros(1)]


def _profiles(structure: Structure, shared: Ranges) -> list[Picture]:
    """Return profiles along x and y through the centre: target, prints, then the rest, as many as there are lines.

    Heights reach over the colours of all maps shown, the designs' own included.
    """
    maps = surfaces(structure)
    prints = [surface for surface in maps if surface.role in PRINTS]
    target = [surface for surface in maps if surface.role == "target"]
    further = [surface for surface in maps if surface not in prints and surface not in target]
    chosen = (target + prints[:1] + prints[1:][-2:] + further)[: len(LINES)]
    chosen = [surface for surface in chosen if surface.height_map.same_grid(chosen[0].height_map)]
    if not chosen:
        return []
    names, lines = [surface.name for surface in chosen], [surface.height_map for surface in chosen]
    profiles, limits = [], [surface.limits(shared) for surface in chosen]
    low, high = min(low for low, _ in limits), max(high for _, high in limits)
    for axis in "xy":
        figure = Figure(figsize=(PROFILE_INCHES[0], 2.5), layout="constrained")
        axes = figure.subplots()
        show_profiles(axes, lines, axis=axis, names=names)
        axes.set_ylim(low - 0.2 * (high - low), high + 0.2 * (high - low))
        axes.legend(frameon=False, ncols=2, loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0, fontsize=7)
        profiles.append(
            Picture(uri(figure), f"Profile along {axis} through the centre", "over the colour range of the maps")
        )
    return profiles


def _equal(first: HeightMap, second: HeightMap | None) -> bool:
    return (
        second is not None
        and first.same_grid(second)
        and np.array_equal(first.heights_um, second.heights_um, equal_nan=True)
    )

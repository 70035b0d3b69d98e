"""A class of look-alikes that a re-print turned by 90° resolves.

Lines written just before raise the dose of the next ones, along the hatch. Across a narrow bar that is nothing but a
tilt, as a wedge under the print would make it. The same bar turned lies along the hatch: a tilt goes on to its far end,
the memory fills up. The design is turned, the printer is not.
"""

from __future__ import annotations

import numpy as np

from tests.stories import pictures
from tests.stories.bench import Bench
from tests.stories.story import Claim, Told, besides, first_class, verdict

TITLE = "A class of look-alikes that a re-print turned by 90° resolves"
MEMORY = {"name": "dose-memory", "gain": 0.04, "length_um": 8.0}
WIDTH_UM = 13.0
PARTS = ("bar", "turned")


def tell(bench: Bench) -> Told:
    """Run the story."""
    plate = bench.map(bench.design("air", "plate", base_um=5.0, height_um=1.5, correlation_um=4.0, seed=2))
    bar = np.where(abs(plate.x_um)[None, :] < WIDTH_UM / 2, plate.heights_um, 0.0)
    bench.formula("bar", plate.with_heights(bar))
    bench.formula("turned", plate.with_heights(np.rot90(bar).copy()))
    press = bench.settings("press.yaml", effects=[MEMORY])
    pairs = {}
    for seed, part in enumerate(PARTS, start=1):
        printed = bench.printed(f"{part}.tif", press, part)
        pairs[part] = f"{part}.tif", bench.recorded(printed, f"{part}_recording", seed=seed)
    before = bench.diagnosed("before", [pairs["bar"]])
    after = bench.diagnosed("after", [*pairs.values()], "--no-advice", "--maps", "after_maps")
    draw(bench)
    return told(before, after)


def told(before: dict, after: dict) -> Told:
    """Put the story into words."""
    name = MEMORY["name"]
    found = after["findings"][0]["parameters"].get(name, {}) if after["findings"] else {}
    sizes = {key: found[key] for key in MEMORY if key in found}
    rows = "\n".join(
        f"| `{name}.{key}` | {MEMORY[key]:g} | {one['value']:.3g} | {one['low']:.3g} to {one['high']:.3g} |"
        for key, one in sizes.items()
    )
    advised = before["findings"][0].get("separate_by") if before["findings"] else None
    text = f"""
A bar, {WIDTH_UM:g} µm wide and long along the lines, is printed and recorded. `diagnose` says: *{verdict(before)}*.
Its own advice on what would tell them apart: {advised or "none"}

The same design is turned by 90° and printed again by the same press, so that the bar is long along the hatch. On both
recordings `diagnose` says: *{verdict(after)}*.{besides(after, name)}

| | printed with | found | 95 % interval |
|---|---|---|---|
{rows}
"""
    covered = bool(sizes) and all(one["low"] <= MEMORY[key] <= one["high"] for key, one in sizes.items())
    claims = (
        Claim("one bar leaves a class of several effects, with the right one in it", verdict(before),
              name in first_class(before) and len(first_class(before)) > 1),
        Claim("with the re-print only the right one is left", verdict(after), first_class(after) == [name]),
        Claim("its size is right: the intervals hold what was printed",
              "; ".join(f"{key} {one['low']:.3g} to {one['high']:.3g}" for key, one in sizes.items()) or "not named",
              covered),
    )  # fmt: skip
    shown = {
        "bars.png": "The two recordings, and what the seven parameters leave of each; x is the hatch direction.",
        "profiles.png": "Means along the hatch: what the seven parameters leave, and what the effect found adds.",
    }
    figures = {"before": verdict(before), "after": verdict(after), "advice": advised, "found": sizes, "printed": MEMORY}
    concealed = f"`{name}`, gain {MEMORY['gain']:g}, {MEMORY['length_um']:g} µm"
    return Told(TITLE, concealed, text, claims, shown, figures)


def draw(bench: Bench) -> None:
    """Draw the recordings, the residuals, and their means along the hatch."""
    seen = {part: bench.map(f"{part}_recording.tif") for part in PARTS}
    targets = {part: bench.map(f"{part}.tif") for part in PARTS}
    left = {part: bench.map(f"after_maps/residual_{k}.tif") for k, part in enumerate(PARTS)}
    residuals = {f"{part}: left": one for part, one in left.items()}
    pictures.maps(bench.folder / "bars.png", seen, residuals)
    curves = {
        part: {
            name: pictures.along(pictures.within(targets[part], one), "x")
            for name, one in (("left", left[part]), ("explained", bench.map(f"after_maps/explained_{k}.tif")))
        }
        for k, part in enumerate(PARTS)
    }
    pictures.profiles(bench.folder / "profiles.png", curves)

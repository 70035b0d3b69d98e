"""Draw docs/overview.png from the results of `make demo`: ``python docs/picture.py runs/demo``."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import dlwpredict as dlw
from dlwpredict.metrology.walls import near_walls_or_rim
from dlwpredict.plots.panels import difference_limit, height_limits, show_difference, show_map, show_profiles

PART = "cin"


def picture(runs: Path) -> Figure:
    """Return the picture: what was asked for, printed, and printed of the corrected design; what was missing."""
    read = {name: dlw.read(runs / PART / f"{name}.tif") for name in ("target", "aligned", "reprinted")}
    target, printed, corrected = read.values()
    both = (dlw.read_parameters(runs / f"{name}.yaml") for name in ("process", "found"))
    process, extended = (one.decided("print") if one.undecided else one for one in both)
    seven, named = (dlw.predict(target, one) for one in (process, extended))
    apart = np.where(near_walls_or_rim(target, 3) | (target.heights_um == 0), np.nan, 1.0)
    left, explained = (
        target.with_heights(apart * (a.heights_um - b.heights_um)) for a, b in ((printed, seven), (named, seven))
    )
    figure = Figure(figsize=(15, 7.2), layout="constrained")
    above = figure.subplots(2, 3)
    limits, limit = height_limits(target, printed, corrected), difference_limit(left.heights_um)
    titles = "(a) asked for", "(b) printed", "(c) printed of the corrected design"
    for axes, title, one in zip(above[0], titles, (target, printed, corrected), strict=True):
        show_map(axes, one, title=title, limits_um=limits)
    show_difference(above[1, 0], left, title="(d) print − prediction of the seven parameters", limit_um=limit)
    show_difference(
        above[1, 1], explained, title=f"(e) of it, {', '.join(e.name for e in extended.effects)}", limit_um=limit
    )
    names = "asked for", "printed", "corrected"
    show_profiles(above[1, 2], (target, printed, corrected), axis="x", names=names)
    above[1, 2].set(ylim=(limits[0] - 0.3, limits[1] + 0.3), title="(f) profiles through the centre")
    above[1, 2].legend(frameon=False, ncols=3, loc="lower center")
    return figure


if __name__ == "__main__":
    picture(Path(sys.argv[1])).savefig(Path(__file__).with_name("overview.png"), dpi=100)

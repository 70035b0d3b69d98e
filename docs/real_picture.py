"""Draw docs/real.png from the maps of `make real-diagnosis`: ``python docs/real_picture.py runs/real/maps``."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import dlwpredict as dlw
from dlwpredict.plots.panels import difference_limit, show_difference

FIELDS = 0, 5
TITLES = {
    "residual": "recording − prediction of the seven",
    "explained": "explained by what was named",
    "remainder": "what is left",
}


def picture(maps: Path) -> Figure:
    """Return the picture: one row for each of some fields."""
    figure = Figure(figsize=(12, 3.5 * len(FIELDS)), layout="constrained")
    for row, field in zip(figure.subplots(len(FIELDS), len(TITLES)), FIELDS, strict=True):
        shown = [dlw.read(maps / f"{name}_{field}.tif") for name in TITLES]
        limit = 1e3 * difference_limit(shown[0].heights_um)
        for axes, one, title in zip(row, shown, TITLES.values(), strict=True):
            inner = one.with_heights(1e3 * np.asarray(one.heights_um))
            show_difference(axes, inner, title=title, limit_um=limit, label="nm")
    return figure


if __name__ == "__main__":
    picture(Path(sys.argv[1])).savefig(Path(__file__).with_name("real.png"), dpi=70)

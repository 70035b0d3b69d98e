"""Draw the pictures of the real prints after `make real-diagnosis`: ``python -m docs.real_picture runs/real``."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

import dlwpredict as dlw
from dlwpredict.plots.panels import difference_limit, show_difference
from tests.bench.real import Answered, Predictor, scored, without_plane

FIELDS = 0, 5
TITLES = {
    "residual": "recording − prediction of the seven",
    "explained": "explained by what was named",
    "remainder": "what is left",
}

ACROSS = 4
"""Fields in a row of the sheet, each with two maps."""

LIMIT_NM = 75.0


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


def sheet(run: Path) -> Figure:
    """Return the residuals of every field, of the seven and beside it of what was named; offset and tilt are free."""
    found = Answered.of(run)
    fields = {**found.fitted, **found.unseen}
    figure = Figure(figsize=(16, 4.6 * len(fields) / (2 * ACROSS)), layout="constrained")
    places = figure.subplots(-(-len(fields) // ACROSS), 2 * ACROSS).reshape(-1, 2)
    for pair, (name, (target, aligned)) in zip(places, sorted(fields.items()), strict=True):
        used = "fitted" if name in found.fitted else "held out"
        for axes, way, title in zip(pair, (found.seven, found.extended), (f"{name}, {used}", "named"), strict=True):
            left = residual_nm(way, target, aligned)
            rms = np.sqrt(np.nanmean(left**2))
            shown = axes.imshow(left, cmap="RdBu_r", vmin=-LIMIT_NM, vmax=LIMIT_NM, interpolation="nearest")
            axes.set_title(f"{title}: {rms:.1f} nm", fontsize=10)
            axes.set_xticks([])
            axes.set_yticks([])
    figure.colorbar(shown, ax=places.ravel().tolist(), shrink=0.4, label="recording − prediction / nm", extend="both")
    return figure


def residual_nm(way: Predictor, target: dlw.HeightMap, aligned: dlw.HeightMap) -> np.ndarray:
    """Return recording − prediction less its plane, NaN where nothing counts, shape (rows, cols)."""
    used = scored(aligned)
    left = np.full(aligned.shape, np.nan)
    left[used] = 1e3 * without_plane(aligned.heights_um - way(target), used)
    return left


if __name__ == "__main__":
    run, docs = Path(sys.argv[1]), Path(__file__).parent
    for name, figure in (("real", picture(run / "maps")), ("real-sheet", sheet(run))):
        figure.savefig(kept := docs / f"{name}.png", dpi=72)
        Image.open(kept).convert("RGB").quantize(256).save(kept, optimize=True)

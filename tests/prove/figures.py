"""The figures of a proof."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from tests.prove.table import confusion, strongest, wilson

RIGHT, OTHER, WRONG = "#0072B2", "#999999", "#D55E00"  # of Okabe and Ito
MULTIPLES = (0.3, 0.5, 1, 2, 3, 5)
EDGES = np.geomspace(0.25, 6.0, 8)
"""Strengths are counted between these."""


def save(folder: Path, results: Sequence[Mapping]) -> list[str]:
    """Write all figures; return their file names."""
    pictures = {"confusion": _confusion, "detection": _detection, "unseen": _unseen, "intervals": _intervals}
    for name, draw in pictures.items():
        figure = Figure(figsize=(8.4, 5.2) if name == "confusion" else (6.4, 4.2), layout="constrained")
        draw(figure.add_subplot(), results)
        figure.savefig(folder / f"{name}.png", dpi=110, metadata={"Software": None})
    return [f"{name}.png" for name in pictures]


def _confusion(axes: Axes, results: Sequence[Mapping]) -> None:
    truths, answers, counts = confusion(results)
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for (row, column), count in np.ndenumerate(counts):
        if count:
            axes.text(column, row, count, ha="center", va="center", color="w" if shares[row, column] > 0.5 else "k")
    axes.set_xticks(range(len(answers)), answers, rotation=40, ha="right")
    axes.set_yticks(range(len(truths)), truths)
    axes.set(xlabel="said", ylabel="concealed", title="Class of the strongest finding, from the detection limit on")


def _detection(axes: Axes, results: Sequence[Mapping]) -> None:
    singles = [r for r in results if r["truth"]["kind"] == "single"]
    strength = np.array([max(strongest(r), EDGES[0]) for r in singles])
    found = np.array([bool(r.get("detected")) for r in singles])
    right = np.array([any(r.get("held", [])) for r in singles])
    for hits, colour, words in ((found, OTHER, "detected"), (right, RIGHT, "truth in the named class")):
        for low, high in pairwise(EDGES):
            inside = (strength >= low) & (strength < high)
            if inside.any():
                share, ends = hits[inside].mean(), wilson(int(hits[inside].sum()), int(inside.sum()))
                place = np.sqrt(low * high) * (1.03 if colour == RIGHT else 0.97)
                axes.plot([place] * 2, ends, color=colour, lw=1)
                axes.plot(place, share, "o", color=colour, label=words)
                words = None
    rug = {True: 1.04, False: -0.04}
    axes.scatter(strength, [rug[bool(f)] for f in found], marker="|", c=np.where(right, RIGHT, OTHER), s=60)
    nulls = [r["verdict"] != "none" for r in results if r["truth"]["kind"] == "null"]
    if nulls:
        axes.axhline(np.mean(nulls), color=WRONG, lw=1, ls="--", label="anything said on nulls")
    axes.axvline(1, color="0.5", lw=0.8)
    axes.set(xscale="log", xlabel="strength / detection limit", ylabel="share of cases", ylim=(-0.08, 1.08),
             title="Single effects: detection against strength")  # fmt: skip
    axes.set_xticks(MULTIPLES, [f"{m:g}" for m in MULTIPLES])
    axes.minorticks_off()
    axes.legend(loc="upper left", bbox_to_anchor=(0.01, 0.93), fontsize=8)


def _unseen(axes: Axes, results: Sequence[Mapping]) -> None:
    heard = [r for r in results if r.get("detected") and r["truth"]["kind"] in ("single", "pair", "outside")]
    colours = {"single": RIGHT, "pair": "#009E73", "outside": OTHER}
    for kind, colour in colours.items():
        points = [(r["unseen_um"]["seven"], r["unseen_um"]["diagnose"]) for r in heard if r["truth"]["kind"] == kind]
        if points:
            axes.loglog(*(1e3 * np.array(points).T), "o", ms=4, color=colour, label=f"{kind}: diagnose")
    oracle = [r["baselines"] for r in heard if "oracle" in r["baselines"]]
    if oracle:
        both = [(b["seven"]["unseen_um"], b["oracle"]["unseen_um"]) for b in oracle]
        axes.loglog(*(1e3 * np.array(both).T), "x", color=WRONG, label="oracle (sample)")
    ends = axes.get_xlim()
    axes.loglog(ends, ends, color="0.5", lw=0.8)
    axes.set(xlabel="error of the seven parameters alone / nm", ylabel="error with the effects / nm",
             title="A structure that was kept from the program")  # fmt: skip
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
    if heard:
        axes.legend(fontsize=8)


def _intervals(axes: Axes, results: Sequence[Mapping]) -> None:
    every = [one for r in results for one in r.get("intervals", []) if one["switch"] and one["true"] != one["off"]]
    every.sort(key=lambda one: one["times"])
    for place, one in enumerate(every):
        ends = [(one[end] - one["off"]) / (one["true"] - one["off"]) for end in ("low", "value", "high")]
        colour = RIGHT if one["covered"] else WRONG
        axes.plot([place] * 2, np.clip([ends[0], ends[2]], -1, 3), color=colour, lw=1)
        axes.plot(place, np.clip(ends[1], -1, 3), "o" if one["model"] == "library" else "s", color=colour, ms=3)
    axes.axhline(1, color="0.5", lw=0.8)
    axes.set(xlabel="effects named rightly, weakest first (squares: longer physics)", ylabel="found / true strength")
    axes.set(ylim=(-1.05, 3.05), title="95 % intervals of strengths (cut at -1 and 3)")

"""The picture of a transfer function."""

from __future__ import annotations

from matplotlib.figure import Figure

from dlwpredict.metrology.transfer import HALF, Transfer
from dlwpredict.plots.panels import REFERENCE_LINE, TEST_LINE


def transfer_curves(transfers: dict[str, Transfer], *, title: str = "") -> Figure:
    """Draw amplitude transfer against spatial period along x and y, each with its period at 50 %."""
    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    axes.axhline(HALF, color="0.7", lw=0.8, ls=(0, (6, 6)))
    styles = {"x": {**REFERENCE_LINE, "marker": "o"}, "y": {**TEST_LINE, "marker": "s"}}
    for axis, transfer in transfers.items():
        half = "" if transfer.half_period_um is None else f", 50 % at {transfer.half_period_um:.2f} µm"
        line = {**styles[axis], "ms": 4, "capsize": 2}
        axes.errorbar(
            transfer.period_um, transfer.transfer, transfer.half_difference, label=f"along {axis}{half}", **line
        )
    axes.set(xlabel="spatial period / µm", ylabel="amplitude transfer / 1", title=title)
    axes.set_ylim(0, max(1.05, *(1.05 * value for transfer in transfers.values() for value in transfer.transfer)))
    axes.grid(color="0.9", lw=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, loc="lower right")
    return figure

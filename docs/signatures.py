"""Draw docs/signatures/NAME.png, what each effect changes in a print: ``python docs/signatures.py``."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

import dlwpredict as dlw
from dlwpredict.effects.base import Effect
from dlwpredict.plots.panels import difference_limit, show_difference

FOLDER = Path(__file__).with_name("signatures")
TARGET = dlw.design("cin", size_um=50, pitch_um=0.5, margin_um=6)


def signature(kind: type[Effect]) -> Figure:
    """Return a figure with a panel for every parameter that switches an effect on, at its typical size."""
    switches = kind.switches()
    figure = Figure(figsize=(2.9 * len(switches), 2.5), layout="constrained")
    without = dlw.predict(TARGET, as_measured=True)
    for axes, (name, size) in zip(figure.subplots(1, len(switches), squeeze=False)[0], switches.items(), strict=True):
        printed = dlw.predict(TARGET, dlw.ParameterSet(effects=(kind(**{name: size}),)), as_measured=True)
        change = TARGET.with_heights(1e3 * (printed.heights_um - without.heights_um))
        limit = difference_limit(change.heights_um[TARGET.heights_um > 0])
        show_difference(axes, change, limit_um=limit, label="nm")
        axes.set_title(f"{name} {size:g}", fontsize=8, loc="left", pad=12)
        axes.set(xlabel="", ylabel="")
        axes.tick_params(labelsize=7)
    return figure


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name, kind in dlw.effects.library().items():
        signature(kind).savefig(FOLDER / f"{name}.png", dpi=75)

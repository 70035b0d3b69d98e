"""The option ``--plot``: the same in every command that draws what it did."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dlwpredict.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ENDINGS = (".png", ".pdf", ".svg")

Plot = Annotated[
    Path | None,
    typer.Option("--plot", metavar="FILE", help="Draw maps and profiles (.png, .pdf, .svg).", show_default=False),
]


def check_plot(path: Path | None, option: str = "--plot") -> None:
    """Refuse a picture of a kind that is not drawn, before any work is done.

    Raises
    ------
    InputError
        The ending is none of .png, .pdf, .svg.
    """
    if path is not None and path.suffix.lower() not in ENDINGS:
        allowed = f"allowed {' '.join(ENDINGS)}"
        raise InputError(f"ends in {path.suffix or 'nothing'}", where=path, key=option, allowed=allowed)


def draw(path: Path | None, figure: Callable[[Any], Figure]) -> None:
    """Save the figure that a function makes of `dlwpredict.plots`, if it is asked for: matplotlib takes a second."""
    if path is not None:
        from dlwpredict import plots

        plots.save(path, figure(plots))

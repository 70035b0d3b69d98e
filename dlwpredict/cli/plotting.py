"""The option ``--plot``: the same in every command that draws what it did."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dlwpredict.errors import InputError

ENDINGS = (".png", ".pdf", ".svg")

Plot = Annotated[
    Path | None,
    typer.Option("--plot", metavar="FILE", help="Draw maps and profiles (.png, .pdf, .svg).", show_default=False),
]


def check_plot(path: Path | None) -> None:
    """Refuse a picture of a kind that is not drawn, before any work is done.

    Raises
    ------
    InputError
        The ending is none of .png, .pdf, .svg.
    """
    if path is not None and path.suffix.lower() not in ENDINGS:
        allowed = f"allowed {' '.join(ENDINGS)}"
        raise InputError(f"ends in {path.suffix or 'nothing'}", where=path, key="--plot", allowed=allowed)

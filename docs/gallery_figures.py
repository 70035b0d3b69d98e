"""Bring figures that need no pyplot into the pages of the gallery."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst


def last_expression(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Save the figure that a block of code ends with, as `dlw.plot` returns it, and return the reST that shows it.

    Sphinx-Gallery keeps the value of a block's last expression under ``___``, and writes its repr below the pictures. A
    figure that was saved is taken away there: it has no repr to show, and must not appear again after the next block.
    """
    names = block_vars["example_globals"]
    figure = names.get("___")
    if not isinstance(figure, Figure):
        return ""
    path = next(block_vars["image_path_iterator"])
    figure.savefig(path, dpi=100)
    names["___"] = None
    return figure_rst([path], gallery_conf["src_dir"])

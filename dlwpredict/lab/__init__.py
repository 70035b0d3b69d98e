"""What a lab's folder begins with: a Makefile, its settings, a parameter set, a page of words, places for files."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

FOLDERS = "targets", "recordings", "written"

FILES = {"Makefile": "workflow.mk"} | {name: name for name in ("settings.mk", "start.yaml", "README.md")}
"""Files of a lab's folder, and where their text stands in this package."""


def contents() -> dict[Path, str]:
    """Return the text of every file of a lab's folder, by its place in it.

    Examples
    --------
    >>> sorted(map(str, contents()))
    ['Makefile', 'README.md', 'settings.mk', 'start.yaml']
    """
    place = files(__package__)
    return {Path(name): place.joinpath(stored).read_text(encoding="utf-8") for name, stored in FILES.items()}

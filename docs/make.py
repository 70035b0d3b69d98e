"""Write docs/commands.md from the command line itself: `make docs`, or ``python docs/make.py``."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

PLACE = Path(__file__).with_name("commands.md")
HEAD = "<!-- Made by `make docs` with typer {typer}; not to be edited. -->\n\n"
_EXAMPLE = re.compile(r"^\$ (dlwpredict .*)$", re.MULTILINE)


def commands() -> str:
    """Return the reference of all commands as Markdown, each example in a block of its own."""
    words = ["-m", "typer", "dlwpredict.cli.app", "utils", "docs", "--name", "dlwpredict", "--title", "Commands"]
    said = subprocess.run([sys.executable, *words], capture_output=True, encoding="utf-8", check=True).stdout
    blocks = said.split("```")  # every second one is code already
    blocks[::2] = [_EXAMPLE.sub(r"```sh\n\1\n```", text) for text in blocks[::2]]
    return HEAD.format(typer=metadata.version("typer")) + "```".join(blocks).rstrip() + "\n"


if __name__ == "__main__":
    PLACE.write_text(commands(), encoding="utf-8")

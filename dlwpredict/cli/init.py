"""``dlwpredict init``: a lab's folder, with the workflow from raw recordings to corrected parts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dlwpredict.cli.console import say
from dlwpredict.errors import InputError
from dlwpredict.lab import FOLDERS, contents

COMMAND = "init"


def run(
    folder: Annotated[Path, typer.Argument(help="Folder to lay out; made if it is not there.", show_default=False)],
) -> None:
    """Lay out a folder for a lab: Makefile, parameter set, places for targets and recordings; nothing is replaced.

    $ dlwpredict init lenses
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(
            "is no folder", where=folder, key="FOLDER", allowed="allowed: a new folder, or one without these"
        )
    texts = {folder / name: text for name, text in contents().items()}
    for path in texts:
        if path.exists():
            raise InputError("is there already", where=path, key="FOLDER", allowed="nothing is replaced: take another")
    try:
        for name in ("", *FOLDERS):
            (folder / name).mkdir(parents=True, exist_ok=True)
        for path, text in texts.items():
            path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot be made ({error.strerror})", where=folder, key="FOLDER") from None
    say(f"{folder}: put targets into targets/, recordings of the same names into recordings/, then type make")

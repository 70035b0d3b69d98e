"""Options and arguments that mean the same in every command."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dlwpredict.errors import InputError

Output = Annotated[Path, typer.Option("-o", "--output", help="Main output file.", show_default=False)]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an existing output.")]
Parameters = Annotated[
    Path | None,
    typer.Option("-p", "--parameters", help="Parameter file (YAML); the paper's defaults if absent."),
]
Seed = Annotated[int, typer.Option("--seed", help="Seed of all randomness.")]


def check_outputs(*paths: Path | None, overwrite: bool) -> None:
    """Refuse outputs that cannot be written, before any work is done.

    Raises
    ------
    InputError
        The folder is missing, the path is a folder, two outputs share a path, or the file exists without ``--overwrite``.
    """
    wanted = [path for path in paths if path is not None]
    for path in wanted:
        if not path.parent.is_dir():
            raise InputError("folder does not exist", where=path, key="output", allowed=f"create {path.parent} first")
        if path.is_dir():
            raise InputError("is a folder", where=path, key="output", allowed="give a file name")
        if path.exists() and not overwrite:
            raise InputError("exists already", where=path, key="output", allowed="allowed with --overwrite")
    if len({path.resolve() for path in wanted}) < len(wanted):
        raise InputError("named for two outputs", where=wanted[-1], key="output", allowed="one file each")

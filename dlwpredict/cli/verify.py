"""``dlwpredict verify``: do the inputs of a result still have the content it was made from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dlwpredict.cli.console import detail, say
from dlwpredict.errors import InputError, ResultError
from dlwpredict.files.provenance import beside, own_sha256, sha256, stated_by

COMMAND = "verify"


def run(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="Results of this program.", show_default=False)
    ],
) -> None:
    """Check that the inputs of results are still what they were, by the SHA-256 that every result names.

    An input is looked for from the result's folder and those above it, then from here, then beside the result.

    $ dlwpredict verify corrected.tif corrected.stl process.yaml
    """
    faults = [(file, fault) for file in files for fault in _faults(file)]
    if faults:
        file, fault = faults[0]
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        raise ResultError(f"{fault}{more}", where=file, key="inputs", allowed="make it again, or bring the inputs back")


def _faults(file: Path) -> list[str]:
    """Say for every input whether it matches; return what does not."""
    if not file.is_file():
        raise InputError("no such file", where=file, key="file", allowed="needs a result of this program")
    stated = stated_by(file) or {}
    inputs = stated.get("inputs")
    if not isinstance(inputs, dict):
        raise InputError("states no provenance", where=file, key="provenance", allowed="needs a result of this program")
    detail(f"{file}: {stated.get('command')}")
    states = {name: _state(Path(name), digest, file.parent) for name, digest in inputs.items()}
    if own_sha256(file) not in (None, sha256(file)):
        states = {f"{file.name} itself": f"is not the file that {beside(file).name} belongs to", **states}
    for name, state in states.items():
        say(f"{file}: {name} {state}")
    if not states:
        say(f"{file}: made without input files")
    return [f"{name} {state}" for name, state in states.items() if state != "matches"]


def _state(name: Path, digest: object, folder: Path) -> str:
    folder = folder.resolve()
    places = *(above / name for above in (folder, *folder.parents)), name, folder / name.name
    place = next((place for place in places if place.is_file()), None)
    if place is None:
        return "is missing"
    if sha256(place) == digest:
        return "matches"
    return "has changed" if place.resolve() == name.resolve() else f"has changed ({place})"

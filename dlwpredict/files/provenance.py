"""Where a result comes from: command, inputs by their SHA-256, versions and seed; no time stamps.

While a command runs, `Run` notes every file that is read, and every file that is written gets its provenance: YAML and
JSON under a key, everything else in a file beside it, NAME.provenance.yaml, which also names the SHA-256 of the result.
Equal heights so remain equal bytes, whichever command made them.
"""

from __future__ import annotations

import hashlib
import json
import platform
import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import scipy

import dlwpredict
from dlwpredict.errors import InputError
from dlwpredict.files.yaml_text import read_yaml, yaml_text
from dlwpredict.heightmap import HeightMap

RECORDS = (".yaml", ".yml", ".json")
_PASSED_ON = ("convert", "export-stl")  # another form of the same heights: what made the input made the output


@dataclass
class Run:
    """What a running command has read so far.

    Parameters
    ----------
    words : sequence of str
        The command line.
    seed : int, optional
    inputs : dict
        SHA-256 by path, in the order of reading.
    maps : dict
        Height maps by path.
    steps : dict
        By path of a height map, the command that made it, if it says so.
    """

    words: Sequence[str]
    seed: int | None = None
    inputs: dict[str, str] = field(default_factory=dict)
    maps: dict[Path, HeightMap] = field(default_factory=dict, repr=False)
    steps: dict[Path, str] = field(default_factory=dict)

    @property
    def step(self) -> str:
        """The command that made the heights; `convert` only gives them another form."""
        command = self.words[1] if len(self.words) > 1 else ""
        return next(iter(self.steps.values()), command) if command in _PASSED_ON else command


_run: ContextVar[Run | None] = ContextVar("run", default=None)


@contextmanager
def running(words: Sequence[str]) -> Iterator[Run]:
    """Note what is read in this block, and let everything written in it say so."""
    run = Run(tuple(words))
    token = _run.set(run)
    try:
        yield run
    finally:
        _run.reset(token)


def present_run() -> Run | None:
    """Return the command that runs at present; none where the package is used as a library."""
    return _run.get()


def note_input(path: Path) -> None:
    """Note that a file is read."""
    if (run := _run.get()) and path.is_file():
        run.inputs.setdefault(str(path), sha256(path))


def note_map(path: Path, height_map: HeightMap) -> None:
    """Note the heights that were read, and what made them if that is known."""
    if run := _run.get():
        run.maps[path] = height_map
        with suppress(InputError, KeyError):  # a damaged record is no fault of the heights
            if own_sha256(path) == run.inputs.get(str(path)):
                run.steps[path] = str((stated_by(path) or {})["step"])


def origin() -> dict[str, Any] | None:
    """Return the provenance of what the present command writes; None outside of a command."""
    run = _run.get()
    if run is None:
        return None
    return {
        "step": run.step,
        "command": shlex.join(run.words),
        "inputs": dict(run.inputs),
        "versions": {
            "dlwpredict": dlwpredict.__version__,
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "python": platform.python_version(),
        },
        **({} if run.seed is None else {"seed": run.seed}),
    }


def with_cautions(cautions: Sequence[str]) -> dict[str, Any]:
    """Return the provenance of what the present command writes, with what its user should know; empty without any."""
    return (origin() or {}) | {"cautions": list(cautions)} if cautions else {}


def cautions_of(stated: dict[str, Any]) -> list[str]:
    """Return what a provenance warns of."""
    cautions = stated.get("cautions")
    return [str(caution) for caution in cautions] if isinstance(cautions, list) else []


def signed(text: str, ending: str) -> str:
    """Return the text of a YAML or JSON mapping with the provenance under a key, unless it has that key."""
    stated = origin()
    if stated is None or ending not in RECORDS:
        return text
    if ending == ".json":
        content = {"provenance": stated} | json.loads(text)
        content["provenance"] = content.pop("provenance")  # at the end
        return json.dumps(content, indent=2, ensure_ascii=False) + "\n"
    return text if "\nprovenance:" in text else text + yaml_text({"provenance": stated})


def beside(path: Path) -> Path:
    """Return the file that states the provenance of one that cannot."""
    return path.with_name(f"{path.name}.provenance.yaml")


def stated_by(path: Path) -> dict[str, Any] | None:
    """Return the provenance of a result, from the file itself (YAML, JSON) or from the one beside it; None without."""
    stated = _record(path).get("provenance")
    return stated if isinstance(stated, dict) else None


def own_sha256(path: Path) -> Any:
    """Return the SHA-256 that the file beside states for this one; None where there is no such file."""
    return None if path.suffix.lower() in RECORDS else _record(path).get("sha256")


def _record(path: Path) -> dict[str, Any]:
    record = path if path.suffix.lower() in RECORDS else beside(path)
    content = read_yaml(record) if record.is_file() else None
    return content if isinstance(content, dict) else {}


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, hexadecimal."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()

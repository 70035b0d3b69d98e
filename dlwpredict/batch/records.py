"""What has been finished: one small record per command, naming by their SHA-256 what was read and what was written."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import dlwpredict
from dlwpredict.files.atomic import write_text
from dlwpredict.files.provenance import sha256

FOLDER = ".dlwpredict-batch"


@dataclass(frozen=True)
class Record:
    """A command on given inputs, and what it left.

    Parameters
    ----------
    words : tuple of str
        The command line.
    inputs, outputs : dict
        SHA-256 by path as it stands in the command line. No outputs: begun, not finished.
    warnings : tuple of str
        What the command warned of.
    version : str
        Of this program.
    standing : dict
        Where the command has not finished: the outputs that stood there before it began, SHA-256 by path.
    """

    words: tuple[str, ...]
    inputs: dict[str, str]
    outputs: dict[str, str]
    warnings: tuple[str, ...] = ()
    version: str = dlwpredict.__version__
    standing: dict[str, str] = field(default_factory=dict)

    def made_from(self, words: Sequence[str], inputs: dict[str, str]) -> bool:
        """Tell whether this very command has finished on these inputs."""
        same = self.words == tuple(words) and self.inputs == inputs and self.version == dlwpredict.__version__
        return same and bool(self.outputs)


def hashes(folder: Path, paths: Sequence[Path]) -> dict[str, str]:
    """Return the SHA-256 of the files among these paths, which count from the folder."""
    return {str(path): sha256(folder / path) for path in paths if (folder / path).is_file()}


def record_path(folder: Path, outputs: Sequence[Path]) -> Path:
    """Return where the record of a command lies: it is known by its first output."""
    first = str(outputs[0])
    return folder / FOLDER / f"{Path(first).stem}-{hashlib.sha256(first.encode()).hexdigest()[:12]}.json"


def read_record(path: Path) -> Record | None:
    """Return a record, None where there is none that can be read."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        content.pop("provenance", None)
        return Record(tuple(content.pop("words")), warnings=tuple(content.pop("warnings")), **content)
    except (OSError, ValueError, TypeError, KeyError):
        return None


def write_record(path: Path, record: Record) -> None:
    """Write a record whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps(asdict(record), indent=1, ensure_ascii=False) + "\n")

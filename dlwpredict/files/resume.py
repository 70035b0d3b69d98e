"""The file beside an output that holds what an interrupted run has done."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import scipy

import dlwpredict
from dlwpredict.errors import InputError
from dlwpredict.files.atomic import write_text
from dlwpredict.files.provenance import sha256

FORMAT = "dlwpredict-resume/1"


def fingerprint(files: Sequence[Path], options: Mapping[str, Any]) -> str:
    """Return what a run must share with an earlier one to take up its work: inputs, options, versions."""
    versions = dlwpredict.__version__, np.__version__, scipy.__version__
    known = [[sha256(file) for file in files], dict(options), versions]
    return hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()


@dataclass(eq=False)
class Companion:
    """The file beside an output that holds what an interrupted run has done.

    Parameters
    ----------
    path : Path
    fingerprint : str
    stored : dict
        Grows while the work goes on.
    """

    path: Path
    fingerprint: str = ""
    stored: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def beside(cls, output: Path) -> Companion:
        """Return that of an output; nothing is stored yet."""
        return cls(output.with_suffix(".resume.json"))

    def read(self) -> bool:
        """Take up what is stored; tell whether there was anything.

        Raises
        ------
        InputError
            The file is damaged, or of other inputs, options or versions.
        """
        if not self.path.exists():
            return False
        allowed = "--overwrite without --resume begins afresh"
        try:
            content = json.loads(self.path.read_text(encoding="utf-8"))
            mark, stored = content["fingerprint"], dict(content["stored"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            said = f"cannot be read ({type(error).__name__})"
            raise InputError(said, where=self.path, key="--resume", allowed=allowed) from None
        if mark != self.fingerprint:
            said = "made from other inputs, options or versions"
            raise InputError(said, where=self.path, key="--resume", allowed=f"the same command, or {allowed}")
        self.stored = stored
        return True

    def write(self) -> None:
        """Write it whole or not at all."""
        content = {"format": FORMAT, "fingerprint": self.fingerprint, "stored": self.stored}
        write_text(self.path, json.dumps(content) + "\n")

    def remove(self) -> None:
        """Remove it: the run has completed."""
        self.path.unlink(missing_ok=True)

"""Where a result comes from: inputs by their SHA-256, versions and the command; no time stamps."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy

import dlwpredict


def provenance(command: Sequence[str], inputs: Sequence[Path]) -> dict[str, Any]:
    """Return the provenance of a result, the same for the same command on the same files.

    Parameters
    ----------
    command : sequence of str
        Words of the command line.
    inputs : sequence of Path
        Files that were read.
    """
    return {
        "command": " ".join(_quoted(str(word)) for word in command),
        "inputs": {str(path): sha256(path) for path in inputs},
        "versions": {
            "dlwpredict": dlwpredict.__version__,
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "python": platform.python_version(),
        },
    }


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, hexadecimal."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _quoted(word: str) -> str:
    return f"'{word}'" if " " in word else word

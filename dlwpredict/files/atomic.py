"""Outputs that are whole or absent: written under a temporary name in the same folder, then renamed.

The temporary name carries machine and process, so that the next run can clear away what a killed one has left.
"""

from __future__ import annotations

import os
import platform
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dlwpredict.errors import InputError
from dlwpredict.files.provenance import RECORDS, beside, origin, sha256, signed
from dlwpredict.files.yaml_text import yaml_text

_MACHINE = re.sub(r"\W", "", platform.node())
_TEMPORARY = re.compile(rf"\.dlwpredict-{_MACHINE}-(\d+)-")

_new: set[Path] = set()
"""Outputs that were not there when a command began: what has come since, from elsewhere, is not replaced."""


def expect_new(path: Path, *, new: bool) -> None:
    """Note whether an output, when it is first written, must still not be there."""
    (_new.add if new else _new.discard)(path.absolute())


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside ``path``; rename it to ``path`` on success, remove it on any failure.

    The temporary name keeps the ending, so that writers that look at it work. If a command runs, a file that does not
    state its provenance itself gets it in a file beside.

    Raises
    ------
    InputError
        The folder is missing, not writable or full.
    """
    path = Path(path)
    with _whole(path) as temporary:
        yield temporary
    stated = origin()
    if stated is not None and path.suffix.lower() not in RECORDS:
        record = {"file": path.name, "sha256": sha256(path), "provenance": stated}
        with _whole(beside(path)) as temporary:
            temporary.write_text(yaml_text(record), encoding="utf-8")


def write_text(path: Path | str, text: str) -> None:
    """Write a text file whole or not at all; a YAML or JSON mapping also states its provenance."""
    with replacing(path) as temporary:
        temporary.write_text(signed(text, Path(path).suffix.lower()), encoding="utf-8")


@contextmanager
def _whole(path: Path) -> Iterator[Path]:
    temporary = None
    try:
        _clear(path.parent)
        prefix = f".dlwpredict-{_MACHINE}-{os.getpid()}-"
        handle, name = tempfile.mkstemp(prefix=prefix, suffix="".join(path.suffixes[-2:]), dir=path.parent)
        os.close(handle)
        temporary = Path(name)
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        _into_place(temporary, path)
    except OSError as error:
        raise InputError(
            f"cannot write ({error.strerror or f'disk full? {error}'})", where=path, key="output"
        ) from None
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def _into_place(temporary: Path, path: Path) -> None:
    """Give a file its name; a name that must be new is taken only if it still is, where the file system knows links."""
    if path.absolute() in _new:
        _new.discard(path.absolute())
        try:
            os.link(temporary, path)
        except FileExistsError:
            raise InputError("exists by now", where=path, key="output", allowed="allowed with --overwrite") from None
        except OSError:
            pass
        else:
            return
    temporary.replace(path)


def _clear(folder: Path) -> None:
    """Remove temporary files of processes of this machine that have ended."""
    for entry in os.scandir(folder):
        match = _TEMPORARY.match(entry.name)
        if match and not _runs(int(match[1])):
            Path(entry.path).unlink(missing_ok=True)


def _runs(process: int) -> bool:
    """Tell whether a process runs; where that cannot be asked, it is taken to.

    One that has ended stays in the list until its parent has asked about it: in a container, where nobody does, for
    ever.
    """
    if os.name != "posix":
        return True
    try:
        os.kill(process, 0)
        state = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace").rpartition(") ")[2][:1]
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return state not in ("Z", "X")

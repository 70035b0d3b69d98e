"""A command that can be ended at any time: by Ctrl-C, by SIGTERM, by a time limit; and how it is taken up again."""

from __future__ import annotations

import hashlib
import json
import os
import re
import signal
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import active_children
from pathlib import Path
from typing import Any

import numpy as np
import scipy

import dlwpredict
from dlwpredict.errors import InputError
from dlwpredict.files.atomic import write_text
from dlwpredict.files.provenance import sha256

FORMAT = "dlwpredict-resume/1"
INTERRUPTED = 130
"""Exit code after Ctrl-C or SIGTERM."""

LIMIT = "the time limit"
_CAUSES: dict[int, str] = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM"}
_SECONDS = {"": 1.0, "s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0}
_TIME = re.compile(r"(\d+\.?\d*|\.\d+)\s*(s|m|min|h|)")


def seconds(text: str | float) -> float:
    """Return a time in seconds: a number, or a number with s, m or h right after it.

    >>> seconds("90"), seconds("90s"), seconds("5m"), seconds("1.5h")
    (90.0, 90.0, 300.0, 5400.0)
    """
    if not isinstance(text, str):
        return float(text)
    if not (match := _TIME.fullmatch(text.strip())) or not float(match[1]) > 0:
        raise ValueError(f"{text!r} is no time such as 90, 90s, 5m or 1.5h")
    return float(match[1]) * _SECONDS[match[2]]


TIME: dict[str, Any] = {"parser": seconds, "metavar": "TIME"}
"""What makes an option of typer take a time."""


def said(seconds_: float) -> str:
    """Return about how long something takes.

    >>> said(3), said(42), said(200), said(5000)
    ('5 s', '40 s', '3 min', '1.4 h')
    """
    if seconds_ < 95:
        return f"{max(5 if seconds_ < 10 else 10 * round(seconds_ / 10), 5)} s"
    return f"{round(seconds_ / 60)} min" if seconds_ < 3600 else f"{seconds_ / 3600:.1f} h"


@dataclass(eq=False)
class Ending:
    """What has ended the work in this block, if anything: a KeyboardInterrupt is raised in it, once.

    Parameters
    ----------
    cause : str
        "" while nothing has.
    closed : bool
        Nothing can any more: what is left to do is quick, and should be done.
    """

    cause: str = ""
    closed: bool = False

    def stop(self) -> None:
        """Raise again what a callback of some library may have swallowed."""
        if self.cause and not self.closed:
            raise KeyboardInterrupt

    def _strike(self, number: int, frame: object) -> None:
        if not (self.cause or self.closed):
            self.cause = _CAUSES.get(number, LIMIT)
            raise KeyboardInterrupt


@contextmanager
def ending(limit_s: float | None) -> Iterator[Ending]:
    """Turn Ctrl-C, SIGTERM and the end of a time into a KeyboardInterrupt.

    Signals that are ignored already, as in the workers of a batch, stay so.
    """
    end = Ending()
    if threading.current_thread() is not threading.main_thread():
        yield end
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    asked = [number for number, handler in before.items() if handler is not signal.SIG_IGN]
    for number in asked:
        signal.signal(number, end._strike)
    try:
        with _alarm(limit_s, end):
            yield end
    finally:
        for number in asked:
            signal.signal(number, before[number])


@contextmanager
def _alarm(limit_s: float | None, end: Ending) -> Iterator[None]:
    if limit_s is None:
        yield
    elif hasattr(signal, "setitimer"):
        before = signal.signal(signal.SIGALRM, end._strike)
        signal.setitimer(signal.ITIMER_REAL, limit_s)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, before)
    else:  # Windows: after what the main thread waits for
        import _thread

        def strike() -> None:
            end.cause = end.cause or LIMIT
            _thread.interrupt_main()

        timer = threading.Timer(limit_s, strike)
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()


def end_workers() -> None:
    """End the worker processes of this one: what they were doing is not wanted any more."""
    for worker in active_children():
        worker.terminate()


def cpu_s() -> float:
    """Return the processor time of this process and its workers, s; of those that run, where the system lists them."""
    spent = time.process_time() + sum(os.times()[2:4])
    for worker in active_children():
        try:
            stat = Path(f"/proc/{worker.pid}/stat").read_text(encoding="utf-8", errors="replace")
        except OSError:
            continue
        spent += sum(map(int, stat.rpartition(") ")[2].split()[11:13])) / os.sysconf("SC_CLK_TCK")
    return spent


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

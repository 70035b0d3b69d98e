"""A command that can be ended at any time: by Ctrl-C, by SIGTERM, by a time limit."""

from __future__ import annotations

import re
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

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
    waits : bool
        The end of a time is noted, and raised by the next `stop` only: what is done first is quick, and no answer
        stands before it.
    """

    cause: str = ""
    closed: bool = False
    waits: bool = False

    def stop(self) -> None:
        """Raise again what a callback of some library may have swallowed."""
        if self.cause and not self.closed:
            raise KeyboardInterrupt

    def _strike(self, number: int, frame: object) -> None:
        noted = self.waits and self.cause == LIMIT
        if self.closed or (self.cause and not noted):
            return
        self.cause = _CAUSES.get(number, LIMIT)
        if not (self.waits and self.cause == LIMIT):
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
            if not end.waits:
                _thread.interrupt_main()

        timer = threading.Timer(limit_s, strike)
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()

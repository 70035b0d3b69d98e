"""How far a diagnosis has come, and about how long the rest takes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from dlwpredict.cli.anytime import said
from dlwpredict.cli.console import detail, progress_shown
from dlwpredict.diagnosis.run import STAGES, Stage


@dataclass(eq=False)
class Clock:
    """How far something has come, and about how long the rest takes; a live line on a terminal.

    Parameters
    ----------
    whole_s : float
        Expected at the beginning.
    """

    whole_s: float
    begun: float = field(default_factory=time.monotonic)
    text: str = "begun"

    def step(self, text: str, share: float) -> str:
        """Begin a stage when a share of the whole is done, and return the line."""
        spent = time.monotonic() - self.begun
        if share > 0.1:
            self.whole_s = spent / share
        self.text = text
        return self.line

    @property
    def line(self) -> str:
        """What goes on, and how much time is left."""
        left = self.whole_s - (time.monotonic() - self.begun)
        return f"{self.text}, about {said(left)} left" if left > 0 else f"{self.text}, longer than expected"

    def __rich__(self) -> str:
        """Return the line as it is now: rich asks for it whenever it draws."""
        return self.line


@contextmanager
def progress(expected_s: float) -> Iterator[Callable[[Stage], None]]:
    """Say what goes on: on a terminal in one line that goes away, with ``--verbose`` line by line."""
    clock = Clock(expected_s)

    def step(stage: Stage) -> None:
        detail(clock.step(f"stage {stage.number} of {len(STAGES)}: {stage.text}", stage.share))

    if not progress_shown():
        yield step
        return
    from rich.console import Console

    with Console(stderr=True).status(clock):
        yield step

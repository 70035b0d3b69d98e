"""What typer reads of a command that is made by a program: its parameters, said in its signature."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable


def taking(run: Callable[..., None], parameters: Iterable[inspect.Parameter]) -> Callable[..., None]:
    """Let a function that takes keywords say by which names and annotations it takes them, and return it."""
    known = list(parameters)
    run.__dict__["__signature__"] = inspect.Signature(known)
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in known}
    return run

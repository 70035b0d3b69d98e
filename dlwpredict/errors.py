"""The project's own errors: what the user can mend, said in one line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import ClassVar


class InputError(ValueError):
    """Something the user gave is at fault: a file, a key in it, or a value.

    Printed by the command line as ``error: WHERE: KEY: WHAT, ALLOWED``; the program ends with `exit_code`.

    Parameters
    ----------
    what : str
        What was found.
    where : object, optional
        File (or option) that holds the fault. A reader that knows no file name leaves it empty;
        whoever knows the name adds it with `at`.
    key : str, optional
        Key, option or property at fault.
    allowed : str, optional
        What would have been accepted.

    Examples
    --------
    >>> str(InputError("found -1", where="p.yaml", key="threshold", allowed="allowed 0.05 to 0.95"))
    'p.yaml: threshold: found -1, allowed 0.05 to 0.95'
    """

    exit_code: ClassVar[int] = 1

    def __init__(self, what: str, *, where: object = "", key: str = "", allowed: str = "") -> None:
        self.what, self.where, self.key, self.allowed = what, str(where), key, allowed
        super().__init__(what)

    def __str__(self) -> str:
        head = "".join(f"{part}: " for part in (self.where, self.key) if part)
        return " ".join((head + self.what + (f", {self.allowed}" if self.allowed else "")).split())

    def at(self, where: object) -> InputError:
        """Return the same error with the file named, unless one is named already."""
        return type(self)(self.what, where=self.where or str(where), key=self.key, allowed=self.allowed)


class ResultError(InputError):
    """The input is well-formed but no trustworthy result exists (no match, no measured points ...)."""


class InterruptionError(ResultError):
    """The work was ended by the user before its result was there."""

    exit_code = 130


@contextmanager
def blaming(where: object) -> Iterator[None]:
    """Name the file in every `InputError` that leaves this block without one."""
    try:
        yield
    except InputError as error:
        raise error.at(where).with_traceback(error.__traceback__) from None

"""What the program says: one line per result on stdout, details on request, progress on a terminal only."""

from __future__ import annotations

import functools
import inspect
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from dlwpredict.cli.signatures import taking
from dlwpredict.files.doubts import doubts
from dlwpredict.files.provenance import present_run

_QUIET, _NORMAL, _VERBOSE = range(3)
_level = _NORMAL
_LONGEST = 4000  # characters of an error


def say(text: str) -> None:
    """Print a result line, unless ``--quiet``."""
    if _level >= _NORMAL:
        typer.echo(text)


def detail(text: str) -> None:
    """Print a line that only ``--verbose`` shows."""
    if _level >= _VERBOSE:
        typer.echo(text, err=True)


def warn(text: str) -> None:
    """Print a warning on stderr, also with ``--quiet``."""
    typer.echo(f"warning: {text}", err=True)


def fault(error: Exception) -> str:
    r"""Return what an error says in one line that a terminal can show, whatever stood in the file.

    >>> fault(ValueError("a.tif: found \x1b[2J"))
    'error: a.tif: found ?[2J'
    """
    text = "".join(letter if letter.isprintable() else "?" for letter in str(error))
    return f"error: {text if len(text) <= _LONGEST else f'{text[: _LONGEST - 100]} ... {text[-100:]}'}"


def progress_shown() -> bool:
    """Tell whether progress bars make sense: stderr is a terminal and the user did not ask for quiet."""
    return _level >= _NORMAL and sys.stderr.isatty()


@contextmanager
def counted(title: str, noun: str, count: int | None = None) -> Iterator[Callable[[int, int], None]]:
    """Yield what shows how many of all are done, on a terminal only."""
    if not progress_shown():
        yield lambda done, count: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = TextColumn(title), BarColumn(), MofNCompleteColumn(), TextColumn(noun), TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=count)
        yield lambda done, count: bar.update(task, completed=done, total=count)


def _pairs(arguments: dict[str, Any]) -> list[tuple[Path, Path]]:
    """Return which of a command's inputs are target and recording of each other."""
    files = arguments.get("pair") or []
    pairs = list(zip(files[::2], files[1::2], strict=False))
    for names in (("target", "recording"), ("reference", "test")):
        if arguments.keys() >= set(names):
            pairs.append(tuple(arguments[name] for name in names))
    return pairs


def with_verbosity(run: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options ``--verbose`` and ``--quiet``, which every command has."""

    @functools.wraps(run)
    def wrapped(*args: Any, verbose: bool, quiet: bool, **kwargs: Any) -> None:
        global _level
        if verbose and quiet:
            raise typer.BadParameter("--verbose and --quiet exclude each other")
        _level = _VERBOSE if verbose else _QUIET if quiet else _NORMAL
        present = present_run()
        if present is not None:
            present.seed = kwargs.get("seed")
        run(*args, **kwargs)
        for text in doubts(present, _pairs(kwargs)) if present is not None else ():
            warn(text)

    signature = inspect.signature(run, eval_str=True)
    extra = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=Annotated[bool, option])
        for name, option in (
            ("verbose", typer.Option("-v", "--verbose", help="Say more about each step.")),
            ("quiet", typer.Option("-q", "--quiet", help="Say nothing but warnings and errors.")),
        )
    ]
    return taking(wrapped, [*signature.parameters.values(), *extra])

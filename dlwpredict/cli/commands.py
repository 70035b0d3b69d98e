"""The commands by name, each imported only when it is needed: `--help` needs their first lines alone."""

from __future__ import annotations

import functools
import importlib
import inspect
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from typer.core import TyperCommand

if TYPE_CHECKING:
    from typer._click import Command

NAMES = (
    "design",
    "convert",
    "align",
    "predict",
    "score",
    "calibrate",
    "precompensate",
    "export-stl",
    "diagnose",
    "effects",
    "batch",
    "report",
    "verify",
    "init",
)
"""In the order of the work. The module of a command has its name, with ``_`` for ``-``."""

_DOCSTRING = re.compile(r'^def run\(.*?^    """(.*?)"""', re.DOTALL | re.MULTILINE)


class Commands(Mapping[str, "Command"]):
    """Every command by its name, imported when it is asked for."""

    def __iter__(self) -> Iterator[str]:
        return iter(NAMES)

    def __len__(self) -> int:
        return len(NAMES)

    def __getitem__(self, name: str) -> Command:
        if name not in NAMES:
            raise KeyError(name)
        return imported(name)


@functools.cache
def imported(name: str) -> Command:
    """Return a command: the module's `run`, or its `group` of sub-commands."""
    from dlwpredict.cli.console import with_verbosity
    from dlwpredict.cli.streams import with_streams

    module = importlib.import_module(f"{__package__}.{_module(name)}")
    around = typer.Typer(add_completion=False)
    if hasattr(module, "group"):
        around.add_typer(module.group, name=name)
    else:
        run = with_streams(
            module.run, streams=getattr(module, "STREAMS", None), figures=getattr(module, "FIGURES", False)
        )
        around.command(name, cls=getattr(module, "CLASS", TyperCommand))(with_verbosity(run))
    return _plainly(typer.main.get_group(around).commands[name])


def _plainly(command: Command) -> Command:
    """Return a command, and its sub-commands, whose help gives no type to what takes no value."""
    for option in command.params:
        if getattr(option, "is_flag", False):
            option.metavar = ""
    for inner in getattr(command, "commands", {}).values():
        _plainly(inner)
    return command


def outlines() -> dict[str, Command]:
    """Return every command by its name with nothing but its help, the docstring of `run`, read without importing it."""
    return {name: TyperCommand(name, help=_help(name)) for name in NAMES}


def _help(name: str) -> str:
    """Search the text, not the syntax tree: that takes 20 ms less for all commands."""
    source = Path(__file__).with_name(f"{_module(name)}.py").read_text(encoding="utf-8")
    return inspect.cleandoc(next(_DOCSTRING.finditer(source))[1])


def _module(name: str) -> str:
    return name.replace("-", "_")

"""The program: collects the commands, turns the project's errors into one line and exit code 1."""

from __future__ import annotations

import importlib
import pkgutil
import platform
import re
import sys
from importlib import metadata
from typing import Annotated

import typer
from typer.core import TyperCommand, TyperGroup

import dlwpredict
from dlwpredict.cli.console import fault, with_verbosity
from dlwpredict.cli.options import joined_pairs
from dlwpredict.cli.streams import with_streams
from dlwpredict.errors import InputError
from dlwpredict.files.provenance import running

COMMAND_ORDER = [
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
]


class _Program(TyperGroup):
    """List commands in the order of the work; report the project's errors in one line."""

    def list_commands(self, ctx) -> list[str]:
        return sorted(super().list_commands(ctx), key=lambda name: (*COMMAND_ORDER, name).index(name))

    def parse_args(self, ctx, args: list[str]) -> list[str]:
        ctx.obj = ("dlwpredict", *args)
        return super().parse_args(ctx, joined_pairs(args))

    def invoke(self, ctx):
        try:
            with running(ctx.obj):
                return super().invoke(ctx)
        except InputError as error:
            typer.echo(fault(error), err=True)
        except MemoryError:
            typer.echo("error: not enough memory for this input, allowed: fewer points or a coarser pitch", err=True)
        raise typer.Exit(1) from None


app = typer.Typer(
    cls=_Program,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=True,
    help="Predict, calibrate, correct and diagnose prints made by multi-photon lithography.",
)


def _show_version(value: bool) -> None:
    if value:
        typer.echo(f"dlwpredict {dlwpredict.__version__}")
        typer.echo(f"python {platform.python_version()}")
        for name in libraries():
            typer.echo(f"{name} {version_of(name)}")
        raise typer.Exit


def libraries() -> list[str]:
    """Return the libraries that this program depends on, those of extras included."""
    return [re.match(r"[\w-]+", one)[0] for one in metadata.requires("dlwpredict") or []]


def version_of(library: str) -> str:
    """Return the version of a library as it is installed."""
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return "not installed"


@app.callback()
def _program(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_show_version,
            is_eager=True,
            help="Show the version and those of the libraries, and exit.",
        ),
    ] = False,
) -> None:
    """Predict, calibrate, correct and diagnose prints made by multi-photon lithography."""


def _register() -> None:
    """Add every module of this package: COMMAND and `run`, or COMMAND and a `group` of sub-commands, per file."""
    for found in pkgutil.iter_modules(sys.modules[__package__].__path__):
        module = importlib.import_module(f"{__package__}.{found.name}") if found.name != "app" else None
        if hasattr(module, "group"):
            app.add_typer(module.group, name=module.COMMAND)
        elif hasattr(module, "COMMAND"):
            kind, streams = getattr(module, "CLASS", TyperCommand), getattr(module, "STREAMS", None)
            run = with_streams(module.run, streams=streams, figures=getattr(module, "FIGURES", False))
            app.command(module.COMMAND, cls=kind)(with_verbosity(run))


_register()


def main() -> None:
    """Run the program."""
    app()

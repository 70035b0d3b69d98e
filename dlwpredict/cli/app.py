"""The program: collects the commands, turns the project's errors into one line and exit code 1."""

from __future__ import annotations

import errno
import platform
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

import dlwpredict
from dlwpredict.cli.commands import Commands, outlines
from dlwpredict.cli.options import joined_pairs
from dlwpredict.errors import InputError, InterruptionError

if TYPE_CHECKING:
    from typer._click import Context, HelpFormatter


class _Program(TyperGroup):
    """List the commands without importing them; report the project's errors in one line."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings | {"commands": Commands()})

    @contextmanager
    def _outlined(self) -> Iterator[None]:
        commands, self.commands = self.commands, outlines()
        try:
            yield
        finally:
            self.commands = commands

    def format_help(self, ctx: Context, formatter: HelpFormatter) -> None:
        with self._outlined():
            super().format_help(ctx, formatter)

    def shell_complete(self, ctx: Context, incomplete: str) -> list[Any]:
        with self._outlined():
            return super().shell_complete(ctx, incomplete)

    def parse_args(self, ctx: Context, args: list[str]) -> list[str]:
        ctx.obj = ("dlwpredict", *args)
        return super().parse_args(ctx, joined_pairs(args))

    def invoke(self, ctx: Context) -> Any:
        from dlwpredict.cli.console import fault
        from dlwpredict.files.provenance import running

        code = 1
        try:
            with running(ctx.obj):
                return super().invoke(ctx)
        except InputError as error:
            typer.echo(fault(error), err=True)
            code = error.exit_code
        except KeyboardInterrupt:
            typer.echo(fault(InterruptionError("interrupted")), err=True)
            code = InterruptionError.exit_code
        except MemoryError:
            typer.echo("error: not enough memory for this input, allowed: fewer points or a coarser pitch", err=True)
        except OSError as error:  # a folder that may not be entered, a name that is too long, a full disk
            if error.errno == errno.EPIPE:
                raise
            typer.echo(f"error: {error.filename or 'output'}: {error.strerror or error}", err=True)
        raise typer.Exit(code) from None


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
    from importlib import metadata

    return [re.split(r"[^\w-]", requirement, maxsplit=1)[0] for requirement in metadata.requires("dlwpredict") or []]


def version_of(library: str) -> str:
    """Return the version of a library as it is installed."""
    from importlib import metadata

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


def main() -> None:
    """Run the program."""
    app()

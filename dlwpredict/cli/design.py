"""``dlwpredict design KIND``: a target made by formula; the options of a kind are those that the kind declares."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, get_args

import typer

from dlwpredict.api.maps import design
from dlwpredict.cli import options
from dlwpredict.cli.console import say, warn, with_verbosity
from dlwpredict.cli.plotting import Plot, check_plot, draw
from dlwpredict.cli.signatures import taking
from dlwpredict.cli.streams import figures_of, tell, with_streams
from dlwpredict.designs import KINDS, options_of
from dlwpredict.errors import InputError, blaming
from dlwpredict.files import write_height_map
from dlwpredict.parameters import Declaration

COMMAND = "design"
group = typer.Typer(no_args_is_help=True, subcommand_metavar="KIND -o TARGET.tif [OPTIONS]")


@group.callback()
def run() -> None:
    """Make a target by formula; `design KIND --help` lists the options of a kind."""


def command(kind: str) -> Callable[..., None]:
    """Return the command of a kind, its options derived from the kind's signature."""
    make = KINDS[kind]

    def run(*, output: Path, plot: Path | None, overwrite: bool, **settings: Any) -> None:
        options.check_outputs(output, plot, overwrite=overwrite)
        check_plot(plot)
        with blaming(f"design {kind}"), _options_named(settings):
            target = design(kind, **settings)
        write_height_map(output, target)
        draw(plot, lambda plots: plots.overview(target, name=kind, caption=target.summary()))
        asked = settings["size_um"] + 2 * settings["margin_um"]
        if max(abs(side - asked) for side in target.size_um) > 1e-6 * asked:
            width, depth = target.size_um
            warn(
                f"size and margin rounded to whole pixels: field {width:.6g} x {depth:.6g} µm instead of {asked:.6g} µm"
            )
        say(f"{output}: {kind}, {target.summary()}")
        tell(figures_of(target))

    declared = options_of(make)
    given = inspect.signature(make).parameters.values()
    kind_options = [option.replace(annotation=as_option(option, declared[option.name])) for option in given]
    output, plot, overwrite = (
        inspect.Parameter("output", inspect.Parameter.KEYWORD_ONLY, annotation=options.Output),
        inspect.Parameter("plot", inspect.Parameter.KEYWORD_ONLY, annotation=Plot, default=None),
        inspect.Parameter("overwrite", inspect.Parameter.KEYWORD_ONLY, annotation=options.Overwrite, default=False),
    )
    run.__doc__ = f"Make a target: {make.meaning}.\n\n$ dlwpredict design {kind} -o {kind}.tif"
    return taking(run, [output, *kind_options, plot, overwrite])


@contextmanager
def _options_named(names: Collection[str]) -> Iterator[None]:
    """Let errors name options as they are typed: --feature-um for feature_um."""
    pattern = re.compile(rf"\b({'|'.join(name for name in names if '_' in name)})\b")

    def typed(text: str) -> str:
        return pattern.sub(lambda name: flag(name[1]), text)

    try:
        yield
    except InputError as error:
        key = flag(error.key) if error.key in names else error.key
        raise type(error)(typed(error.what), where=error.where, key=key, allowed=typed(error.allowed)) from None


def flag(name: str) -> str:
    """Return how an option is typed.

    >>> flag("size_um")
    '--size-um'
    """
    return f"--{name.replace('_', '-')}"


def as_option(option: inspect.Parameter, declaration: Declaration) -> object:
    """Return the annotation that makes typer ask for a declared option; the range is checked by the kind itself."""
    kind_of_value = get_args(option.annotation)[0]
    unit = "" if declaration.unit == "1" else f" {declaration.unit}"
    allowed = f" ({declaration.low:.10g} to {declaration.high:.10g}{unit})" if kind_of_value is not bool else ""
    length = options.LENGTH if kind_of_value in (float, float | None) and unit == " µm" else {}
    meaning = f"{declaration.meaning[0].upper()}{declaration.meaning[1:]}{allowed}."
    return Annotated[kind_of_value, typer.Option(flag(option.name), help=meaning, **length)]


for _kind in KINDS:
    group.command(_kind, short_help=KINDS[_kind].meaning)(
        with_verbosity(with_streams(command(_kind), streams={"output": ".txt"}, figures=True))
    )

"""``dlwpredict effects``: every named effect, what it means and what it takes."""

from __future__ import annotations

import textwrap
from dataclasses import asdict
from typing import Annotated, Any

import typer

from dlwpredict.cli.console import say
from dlwpredict.cli.streams import tell
from dlwpredict.effects import library
from dlwpredict.effects.base import Effect
from dlwpredict.errors import InputError
from dlwpredict.files.yaml_text import yaml_text
from dlwpredict.parameters import Declaration, declarations

COMMAND = "effects"
FIGURES = True
WIDTH = 110


def run(
    name: Annotated[str | None, typer.Argument(help="One effect; all of them if absent.", show_default=False)] = None,
    yaml: Annotated[
        bool, typer.Option("--yaml", help="Print an entry for a parameter file, at typical sizes.")
    ] = False,
) -> None:
    """List the named effects and their parameters.

    $ dlwpredict effects vignetting --yaml
    """
    known = library()
    if name is not None and name not in known:
        raise InputError(f"found {name}", key="NAME", allowed=f"allowed: {', '.join(known)}")
    chosen = list(known.values()) if name is None else [known[name]]
    tell({kind.name: known_of(kind) for kind in chosen})
    if yaml:
        say(yaml_text({"effects": [example(kind) for kind in chosen]}).rstrip())
    else:
        say(overview(chosen) if name is None else card(chosen[0]))


def example(kind: type[Effect]) -> dict[str, float | str]:
    """Return an entry for a parameter file: switched on at typical sizes, everything else at its default."""
    values = {name: default for name, (default, _) in _parameters(kind)} | kind.switches()
    return {"name": kind.name, **{name: float(value) for name, value in values.items()}}


def known_of(kind: type[Effect]) -> dict[str, Any]:
    """Return what is declared of an effect."""
    return {
        "side": kind.side,
        "stage": kind.stage,
        "frame": kind.frame,
        "meaning": kind.meaning,
        "parameters": {name: {"default": default, **asdict(known)} for name, (default, known) in _parameters(kind)},
    }


def overview(kinds: list[type[Effect]]) -> str:
    """Return three lines per effect: what it is, and what it takes."""
    lines = []
    for side, note in (("print", ""), ("measurement", " (predict: with --as-measured; never corrected for)")):
        lines += ["", f"{side.upper()} SIDE{note}"]
        for kind in (kind for kind in kinds if kind.side == side):
            lines += ["", f"  {kind.name}  [{kind.stage} stage, {kind.frame} frame]", f"    {kind.meaning}"]
            lines += _wrapped("; ".join(_short(*item) for item in _parameters(kind)), "    ")
    lines += ["", "Lengths in µm; off at the value after the name. One effect in full: dlwpredict effects NAME"]
    return "\n".join(lines[1:])


def card(kind: type[Effect]) -> str:
    """Return everything that an effect knows of itself."""
    facts = {
        "side": kind.side,
        "frame": kind.frame,
        "stage": kind.stage,
        "looks like": ", ".join(kind.confused_with) or "nothing else",
        "told apart by": kind.separated_by,
        "source": kind.source,
    }
    lines = [f"{kind.name}: {kind.meaning}", ""]
    for fact, text in facts.items():
        lines += _wrapped(f"{fact + ':':15}{text}", "", " " * 15)
    lines += ["", f"{'parameter':22}{'default':>9}  {'unit':6}{'allowed':18}meaning"]
    for name, (default, known) in _parameters(kind):
        span = f"{known.low:g} to {known.high:g}"
        lines += _wrapped(f"{name:22}{default:>9g}  {known.unit:6}{span:18}{_meaning(known)}", "", " " * 57)
    return "\n".join(lines)


def _parameters(kind: type[Effect]) -> list[tuple[str, tuple[float, Declaration]]]:
    """Return names and declarations, the effect's own before the resin's η."""
    return sorted(declarations(kind).items(), key=lambda item: item[0] == "conversion")


def _meaning(known: Declaration) -> str:
    switch = f" (switches the effect on; typical {known.typical:g})" if known.typical is not None else ""
    return known.meaning + switch + ("" if known.fitted else " (setting, never fitted)")


def _short(name: str, declared: tuple[float, Declaration]) -> str:
    default, known = declared
    return f"{name} {default:g} ({known.low:g} to {known.high:g})"


def _wrapped(text: str, first: str, following: str | None = None) -> list[str]:
    indent = first if following is None else following
    return textwrap.wrap(text, WIDTH, initial_indent=first, subsequent_indent=indent, break_on_hyphens=False)

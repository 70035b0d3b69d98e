"""Options and arguments that mean the same in every command."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer.core import TyperCommand

from dlwpredict.errors import InputError

if TYPE_CHECKING:
    from typer._click import Context

    from dlwpredict.heightmap import HeightMap

_LENGTH = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(nm|um|µm|μm|mm)?")


def length_um(text: str | float) -> float:
    """Return a length in µm: a number of µm, or a number with nm, um, µm, mm right after it.

    >>> length_um("0.25"), length_um("100nm"), length_um("1.5mm"), length_um(50.0)
    (0.25, 0.1, 1500.0, 50.0)
    """
    from dlwpredict.files.formats import um_per  # numpy and the formats: not for every --help

    if not isinstance(text, str):
        return float(text)
    match = _LENGTH.fullmatch(text)
    length = float(f"{float(match[1]) * um_per(match[2], 'length'):.15g}") if match and match[2] else float(text)
    if abs(length) > LONGEST_UM:
        raise typer.BadParameter(f"{text} is longer than a metre")
    return length


LONGEST_UM = 1e6
"""A metre: no length of a print, a map or a pitch is longer."""

OUTPUTS = ("output", "report", "json_file", "params_out", "plot", "transfer_plot", "unreachable", "maps")
"""Parameters of commands that name what is written, the main output first; all other paths are read, but OUT."""

LENGTH: dict[str, Any] = {"parser": length_um, "metavar": "LENGTH"}
"""What makes an option of typer take a length: 0.1 or 100nm."""

Output = Annotated[Path, typer.Option("-o", "--output", help="Main output file.", show_default=False)]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an existing output.")]
Parameters = Annotated[
    Path | None,
    typer.Option(
        "-p",
        "--parameters",
        help="Parameter file (YAML); if absent the paper's seven, and heights that are not cut into slices.",
    ),
]
Jobs = Annotated[int | None, typer.Option(help="Processes at once; as many as cores if absent.", min=1)]
Seed = Annotated[int, typer.Option("--seed", help="Seed of all randomness.", min=0)]
PitchUm = Annotated[
    str | None,
    typer.Option("--pitch-um", metavar="DX [DY]", help="Pixel pitch in µm, or 100nm; wins over what the file says."),
]
ZScale = Annotated[
    float | None,
    typer.Option("--z-scale", help="µm per stored number (metres: 1e6); wins over the unit in the file."),
]
ZRange = Annotated[
    tuple[float, float] | None,
    typer.Option("--z-range", metavar="LO HI", help="Heights in µm of the lowest and the highest grey level (PNG)."),
]
Fill = Annotated[
    str | None,
    typer.Option("--fill", metavar="zero|nearest|UM", help="What to put where nothing was measured (NaN)."),
]
InstrumentKind = Annotated[
    Literal["confocal", "wli", "afm", "unknown"] | None,
    typer.Option("--instrument", help="What recorded the map; wins over what the file says."),
]
FastAxis = Annotated[
    float | None,
    typer.Option(
        "--fast-axis-deg",
        metavar="DEG",
        help="Direction in which it scans its lines, counter-clockwise from x; wins over what the file says.",
    ),
]


def recorded_by(height_map: HeightMap, kind: str | None, fast_axis_deg: float | None) -> HeightMap:
    """Return a map with what the user says of its instrument."""
    instrument = height_map.instrument
    if kind is not None:
        instrument = replace(instrument, kind=kind)
    if fast_axis_deg is not None:
        instrument = replace(instrument, fast_axis_deg=fast_axis_deg)
    return height_map if instrument is height_map.instrument else replace(height_map, instrument=instrument)


class Surround(StrEnum):
    """What lies beyond the map."""

    empty = "empty"
    continued = "continued"


SurroundOption = Annotated[
    Surround | None,
    typer.Option(
        "--surround",
        help="Beyond the map: empty resin, or the part goes on as its mirror image (a map cut out of a larger part).",
    ),
]


Pairs = Annotated[
    list[Path],
    typer.Option("--pair", metavar="TARGET ALIGNED", help="Target and aligned recording; once for each recording."),
]

Holdouts = Annotated[
    list[Path] | None,
    typer.Option(
        "--holdout", metavar="TARGET ALIGNED", help="A pair that is scored, never used in a fit; may be repeated."
    ),
]
Repeats = Annotated[
    list[Path] | None,
    typer.Option(
        "--repeat", metavar="ALIGNED AGAIN", help="A second recording of the same print: the noise is taken from both."
    ),
]
_TWO_FILES = {"--pair": "TARGET ALIGNED", "--holdout": "TARGET ALIGNED", "--repeat": "ALIGNED AGAIN"}


class PairCommand(TyperCommand):
    """A command whose ``--pair`` takes two files and may be repeated, which typer alone does not offer.

    ``--pair T A`` is read as ``--pair T --pair A``; `pairs_of` puts the two together again.
    """

    def parse_args(self, ctx: Context, args: list[str]) -> list[str]:
        """Read the command line."""
        read: list[str] = []
        words = list(args)
        while words:
            word = words.pop(0)
            read.append(word)
            if word in _TWO_FILES:
                files = words[:2]
                if len(files) < 2 or any(file.startswith("-") for file in files):
                    raise typer.BadParameter(f"{word} takes two files, {_TWO_FILES[word]}", ctx=ctx)
                read += [files[0], word, files[1]]
                words = words[2:]
        return super().parse_args(ctx, read)


def pairs_of(files: list[Path], option: str = "--pair") -> list[tuple[Path, Path]]:
    """Return the pairs of an option that takes two files, (target, recording) or (recording, repeat).

    Raises
    ------
    InputError
        A recording is its own target, or stands in two pairs.
    """
    if len(files) % 2:
        raise typer.BadParameter(f"{option} takes two files, {_TWO_FILES[option]}")
    pairs = list(zip(files[::2], files[1::2], strict=True))
    seen: set[Path] = set()
    for target, recording in pairs:
        if target.resolve() == recording.resolve():
            raise InputError("the recording is the target itself", where=recording, key=option)
        if recording.resolve() in seen:
            raise InputError("given in two pairs", where=recording, key=option, allowed="each recording once")
        seen.add(recording.resolve())
    return pairs


def check_outputs(*paths: Path | None, overwrite: bool) -> None:
    """Refuse outputs that cannot be written, before any work is done.

    Raises
    ------
    InputError
        The folder is missing or read-only, the path is a folder, two outputs share a path, or the file exists without
        ``--overwrite``.
    """
    from dlwpredict.files.atomic import expect_new  # numpy and the formats: not for every --help

    wanted = [path for path in paths if path is not None]
    for path in wanted:
        if not path.parent.is_dir():
            raise InputError("folder does not exist", where=path, key="output", allowed=f"create {path.parent} first")
        if not os.access(path.parent, os.W_OK | os.X_OK):
            raise InputError("folder cannot be written to", where=path, key="output", allowed="another folder")
        if path.is_dir():
            raise InputError("is a folder", where=path, key="output", allowed="give a file name")
        if path.exists() and not overwrite:
            raise InputError("exists already", where=path, key="output", allowed="allowed with --overwrite")
        expect_new(path, new=not overwrite)
    if len({path.resolve() for path in wanted}) < len(wanted):
        raise InputError("named for two outputs", where=wanted[-1], key="output", allowed="one file each")


def paths_of(value: Any) -> list[Path]:
    """Return the paths of a parameter's value: one, several or none."""
    return [path for path in (value if isinstance(value, (list, tuple)) else [value]) if isinstance(path, Path)]


def check_apart(arguments: Mapping[str, Any]) -> None:
    """Refuse an output that a command reads as well.

    Raises
    ------
    InputError
    """
    read = {path.resolve() for name, value in arguments.items() if name not in OUTPUTS for path in paths_of(value)}
    for name in OUTPUTS:
        for path in paths_of(arguments.get(name)):
            if path.resolve() in read and not path.is_dir():
                raise InputError("is read by this command", where=path, key="output", allowed="one file each")


def joined_pairs(arguments: list[str]) -> list[str]:
    """Join the two numbers of ``--pitch-um DX DY``: a parser takes one value or two, not either.

    >>> joined_pairs(["in.tif", "--pitch-um", "0.1", "0.2", "out.tif"])
    ['in.tif', '--pitch-um', '0.1 0.2', 'out.tif']
    """
    joined: list[str] = []
    for argument in arguments:
        if joined[-2:-1] == ["--pitch-um"] and all(_LENGTH.fullmatch(text) for text in (joined[-1], argument)):
            joined[-1] += f" {argument}"
        else:
            joined.append(argument)
    return joined


def pitch(text: str | None) -> tuple[float, ...] | None:
    """Return the numbers of ``--pitch-um``; the reader checks their size.

    >>> pitch("0.1"), pitch("100nm 0.2"), pitch(None)
    ((0.1,), (0.1, 0.2), None)

    Raises
    ------
    InputError
        No numbers, or a comma between digits: one pitch in the German manner, or two?
    """
    if text is None:
        return None
    if re.search(r"\d,\s*[\d.]", text):
        allowed = "allowed: a decimal point, and a space between two pitches (1.5 or 1 5)"
        raise InputError(f"found {text}, a comma between digits", key="--pitch-um", allowed=allowed)
    try:
        return tuple(length_um(number) for number in re.split(r"[,\s]+", text.strip()))
    except ValueError:
        allowed = "allowed: one or two numbers of µm, or with nm, um, mm"
        raise InputError(f"found {text}", key="--pitch-um", allowed=allowed) from None

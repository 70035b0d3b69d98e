"""Delimited text: a matrix of heights, row 0 on top, as microscopes and scripts export it.

Recognised by themselves: tab, comma, semicolon or blanks between the numbers; CR, LF or CRLF; decimal commas; a byte
order mark; gzip. Lines that start with ``#`` are comments and may state pitch and unit. A first row x and a first
column y (µm; NanoFocus µSurf) give the pitch. Not measured: nothing between two delimiters, nan, BAD, ***.
"""

from __future__ import annotations

import gzip
import re
import zlib
from pathlib import Path

from dlwpredict.errors import InputError
from dlwpredict.files.formats import Format, Pair, Stored, um_per, unmarked
from dlwpredict.files.key_lines import key_lines, parse_lines, stored_facts
from dlwpredict.files.text_matrix import matrix_of, without_axes
from dlwpredict.heightmap import HeightMap

_MOST_PACKED = 200  # how far text may unpack: numbers do so by less than 10, only a bomb by 1000
_SMALL_BYTES, _LARGEST_BYTES = 2**25, 2**28
_ENDINGS = (".txt", ".csv", ".asc", ".dat")
_GWYDDION = re.compile(r"^#\s*(Width|Height|Value units):\s*([-+.\deE]*)\s*(\S*)\s*$", re.MULTILINE)


def read_text(path: Path, pitch_um: Pair | None) -> Stored:
    """Read a matrix of numbers.

    Raises
    ------
    InputError
        Damaged gzip, not text, no numbers, a row of another length, or something that is no number, with its line.
    """
    content = _text(path)
    lines = content.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    comments = "\n".join(line for line in lines if line.lstrip().startswith("#"))
    rows = [
        (number, line) for number, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")
    ]
    if not rows:
        raise InputError("no numbers found", key="file", allowed="a matrix of heights")
    numbers, label = matrix_of(rows)
    facts = _gwyddion(comments, numbers.shape) | stored_facts(parse_lines(comments))
    if "pitch_um" in facts and label is None:
        return Stored(numbers, **facts)
    numbers, axes_pitch = without_axes(numbers, label)
    return Stored(numbers, **{"pitch_um": axes_pitch, **facts})


def write_text(path: Path, height_map: HeightMap) -> list[str]:
    """Write heights that read back exactly, pitch and unit in ``#`` lines; commas in ``.csv``, else tabs."""
    delimiter = "," if ".csv" in path.name.lower() else "\t"
    lines = ["# height map, row 0 on top (y upwards); nan = not measured"]
    lines += [f"# {key}={value}" for key, value in key_lines(height_map).items()]
    lines += [delimiter.join(map(repr, row)) for row in height_map.heights_um.tolist()]
    content = ("\n".join(lines) + "\n").encode()
    path.write_bytes(gzip.compress(content, mtime=0) if path.suffix.lower() == ".gz" else content)
    return unmarked(height_map)


def _text(path: Path) -> str:
    content = _unpacked(path) if path.suffix.lower() == ".gz" else path.read_bytes()
    encoding = "utf-16" if content.startswith((b"\xff\xfe", b"\xfe\xff")) else "utf-8-sig"
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    if "\0" in text:
        raise InputError("not a text file", key="file", allowed="a matrix of numbers as text")
    return text


def _unpacked(path: Path) -> bytes:
    """Unpack a .gz no further than numbers could have been packed."""
    most = min(max(_SMALL_BYTES, _MOST_PACKED * path.stat().st_size), _LARGEST_BYTES)
    try:
        with gzip.open(path) as stream:
            content = stream.read(most + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"damaged gzip ({error})", key="file", allowed="a whole .gz") from None
    if len(content) > most:
        raise InputError(f"unpacks to more than {most} bytes", key="size", allowed="unpack it first")
    return content


def _gwyddion(comments: str, shape: tuple[int, int]) -> dict:
    """Return what the comment lines of Gwyddion's text export state: ``# Width: 5 µm``, ``# Value units: m``."""
    stated = {name: (value, unit) for name, value, unit in _GWYDDION.findall(comments)}
    facts: dict = {}
    if {"Width", "Height"} <= stated.keys():
        width, depth = (_length(name, *stated[name]) for name in ("Width", "Height"))
        facts["pitch_um"] = width / shape[1], depth / shape[0]
    if "Value units" in stated:
        facts["z_unit"] = stated["Value units"][1]
    return facts


def _length(name: str, value: str, unit: str) -> float:
    try:
        return float(value) * um_per(unit, name)
    except ValueError:
        raise InputError(f"found {value} {unit}", key=name, allowed="a length with its unit, such as 5 µm") from None


FORMAT = Format("delimited text", _ENDINGS + tuple(f"{ending}.gz" for ending in _ENDINGS), read_text, write_text)

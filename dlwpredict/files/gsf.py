"""Gwyddion Simple Field (``.gsf``): metres, float32, row 0 on top; opens in Gwyddion without a dialogue.

Layout (Gwyddion user guide, "Gwyddion Simple Field"): the line ``Gwyddion Simple Field 1.0``, ``key = value`` lines,
1 to 4 NUL bytes up to a multiple of four, then float32 little endian, row by row.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dlwpredict.errors import InputError
from dlwpredict.files.formats import Format, Pair, Stored, float32, require_size, um_per, unmarked, unsaid
from dlwpredict.files.key_lines import parse_lines
from dlwpredict.heightmap import HeightMap

_MAGIC = b"Gwyddion Simple Field 1.0\n"


def read_gsf(path: Path, pitch_um: Pair | None) -> Stored:
    """Read heights and pitch; units default to metres, NaN = not measured.

    Raises
    ------
    InputError
        Wrong first line, missing or faulty key, or a length that does not fit XRes x YRes.
    """
    content = path.read_bytes()
    end = content.find(b"\0")
    if not content.startswith(_MAGIC) or end < 0:
        raise InputError("not a Gwyddion Simple Field", key="file", allowed=f"first line {_MAGIC.decode().strip()}")
    lines = parse_lines(content[:end].decode("utf-8", "replace"))
    cols, rows = (int(_positive(lines, name)) for name in ("XRes", "YRes"))
    require_size(cols, rows)
    values = content[end + 4 - end % 4 :]
    if len(values) != 4 * rows * cols:
        raise InputError(
            f"{len(values)} bytes of heights", key="length", allowed=f"{4 * rows * cols} for {cols} x {rows}"
        )
    pitch = None
    if pitch_um is None and {"XReal", "YReal"} <= lines.keys():
        unit = um_per(lines.get("XYUnits") or "m", "XYUnits")
        pitch = unit * _positive(lines, "XReal") / cols, unit * _positive(lines, "YReal") / rows
    return Stored(
        np.frombuffer(values, "<f4").reshape(rows, cols),
        pitch_um=pitch,
        z_unit=lines.get("ZUnits") or "m",
        height_reference="relative" if lines.get("HeightReference") == "relative" else "substrate",
    )


def write_gsf(path: Path, height_map: HeightMap) -> list[str]:
    """Write heights in metres as float32, NaN kept."""
    (rows, cols), (width, depth) = height_map.shape, height_map.size_um
    header = {
        "XRes": cols,
        "YRes": rows,
        "XReal": repr(width * 1e-6),
        "YReal": repr(depth * 1e-6),
        "XYUnits": "m",
        "ZUnits": "m",
        "Title": "Height",
        "HeightReference": height_map.height_reference,
    }
    head = _MAGIC + "".join(f"{key} = {value}\n" for key, value in header.items()).encode()
    head += b"\0" * (4 - len(head) % 4)
    path.write_bytes(head + float32(height_map.heights_um * 1e-6).tobytes())
    return unmarked(height_map) + unsaid(height_map)


def _positive(lines: dict[str, str], name: str) -> float:
    try:
        value = float(lines[name])
    except (KeyError, ValueError):
        value = 0.0
    if not 0 < value < np.inf:
        raise InputError(f"found {lines.get(name, 'nothing')}", key=name, allowed="allowed: a positive number")
    return value


FORMAT = Format("Gwyddion Simple Field", (".gsf",), read_gsf, write_gsf)

"""Gwyddion's own files (``.gwy``): the height channels, with the mask of each as points not measured.

Own reader: the package gwyfile never returns from a file whose last text has lost its end. Layout (Gwyddion user
guide, "Gwyddion file format"): ``GWYP``, then one object = type name, NUL, number of bytes, components; a component =
name, NUL, type letter, value. Little endian.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import Any

import numpy as np

from dlwpredict.errors import InputError
from dlwpredict.files.channels import chosen_channel
from dlwpredict.files.formats import UM_PER_UNIT, Format, Pair, Stored, um_per

_MAGIC = b"GWYP"
_SCALARS = {"b": "<?", "c": "<c", "i": "<i", "q": "<q", "d": "<d"}
_ARRAYS = {"C": "u1", "I": "<i4", "Q": "<i8", "D": "<f8"}
_CHANNEL = re.compile(r"/(\d+)/data")

Components = dict[str, Any]


def read_gwy(path: Path, pitch_um: Pair | None, channel: str | None = None) -> Stored:
    """Read one height channel.

    Raises
    ------
    InputError
        Not a whole ``.gwy``, no channel in a unit of length, or several and none named.
    """
    content = path.read_bytes()
    if not content.startswith(_MAGIC):
        raise InputError("not a Gwyddion file", key="file", allowed="first bytes GWYP")
    try:
        container, _ = _object(content, len(_MAGIC), len(content))
    except (ValueError, struct.error, RecursionError):
        raise InputError("not a whole Gwyddion file", key="file", allowed="save it again") from None
    numbers = sorted(int(match[1]) for name in container if (match := _CHANNEL.fullmatch(name)))
    numbers = [number for number in numbers if _unit(container[f"/{number}/data"], "si_unit_z") in UM_PER_UNIT]
    titles = [str(container.get(f"/{number}/data/title", f"channel {number}"))[:80] for number in numbers]
    number = numbers[chosen_channel(titles, channel)]
    field = container[f"/{number}/data"]
    heights = _matrix(field)
    if f"/{number}/mask" in container:
        mask = _matrix(container[f"/{number}/mask"])
        if mask.shape != heights.shape:
            raise InputError(f"mask of {mask.shape}", key="mask", allowed=f"the shape of the heights, {heights.shape}")
        heights = np.where(mask > 0, np.nan, heights)
    return Stored(heights, pitch_um=pitch_um or _pitch(field, heights.shape), z_unit=_unit(field, "si_unit_z"))


def _unit(field: Any, name: str) -> str:
    unit = field.get(name) if isinstance(field, dict) else None
    return str(unit.get("unitstr", "")) if isinstance(unit, dict) else ""


def _matrix(field: Any) -> np.ndarray:
    """Return the numbers of a data field, shape (rows, cols)."""
    try:
        rows, cols, data = field["yres"], field["xres"], field["data"]
        if min(rows, cols) < 1 or data.dtype != np.dtype("<f8"):
            raise ValueError
        return data.reshape(rows, cols)
    except (KeyError, TypeError, ValueError, AttributeError):
        raise InputError("xres, yres and data do not fit", key="channels", allowed="xres x yres numbers") from None


def _pitch(field: Components, shape: tuple[int, ...]) -> Pair:
    unit = um_per(_unit(field, "si_unit_xy"), "si_unit_xy")
    pitch = []
    for name, points in (("xreal", shape[1]), ("yreal", shape[0])):
        length = field.get(name)
        if not (isinstance(length, float) and 0 < length < np.inf):
            raise InputError(f"found {length}", key=name, allowed="allowed: a positive number")
        pitch.append(unit * length / points)
    return pitch[0], pitch[1]


def _object(content: bytes, start: int, end: int) -> tuple[Components, int]:
    """Return the components of the object at ``start``, and where it ends; ValueError beyond ``end``."""
    _, start = _text(content, start, end)
    (size,) = struct.unpack_from("<I", content, start)
    start += 4
    if start + size > end:
        raise ValueError
    end = start + size
    components: Components = {}
    while start < end:
        name, start = _text(content, start, end)
        kind = content[start : start + 1].decode("latin-1")
        components[name], start = _value(content, kind, start + 1, end)
    if start > end:
        raise ValueError
    return components, end


def _value(content: bytes, kind: str, start: int, end: int) -> tuple[Any, int]:
    """Return the value of one component, and where it ends."""
    if kind == "s":
        return _text(content, start, end)
    if kind == "o":
        return _object(content, start, end)
    if kind in _SCALARS:
        return struct.unpack_from(_SCALARS[kind], content, start)[0], start + struct.calcsize(_SCALARS[kind])
    (count,) = struct.unpack_from("<I", content, start)
    start += 4
    if kind in _ARRAYS:
        stop = start + count * np.dtype(_ARRAYS[kind]).itemsize
        if stop > end:
            raise ValueError
        return np.frombuffer(content, _ARRAYS[kind], count, start), stop
    if kind not in ("S", "O"):
        raise ValueError
    values = []
    for _ in range(count):
        value, start = _value(content, kind.lower(), start, end)
        values.append(value)
    return values, start


def _text(content: bytes, start: int, end: int) -> tuple[str, int]:
    stop = content.index(b"\0", start, end)
    return content[start:stop].decode("utf-8"), stop + 1


FORMAT = Format("Gwyddion", (".gwy",), read_gwy, channels=True)

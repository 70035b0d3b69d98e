"""What every height-map format shares: the noun `Format`, the noun `Stored`, and the list of all formats.

A new format is one new file in this package that defines ``FORMAT = Format(...)``; nothing else is edited.
"""

from __future__ import annotations

import functools
import importlib
import math
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dlwpredict.errors import InputError
from dlwpredict.heightmap import UNKNOWN, HeightMap, HeightReference, Instrument

Pair = tuple[float, float]
MOST_POINTS = 2**26  # 8192 x 8192
UM_PER_UNIT = {"m": 1e6, "cm": 1e4, "mm": 1e3, "um": 1.0, "µm": 1.0, "micron": 1.0, "nm": 1e-3, "inch": 25400.0}


def um_per(unit: str, key: str) -> float:
    """Return the µm in one unit.

    >>> um_per("nm", "z_unit")
    0.001
    """
    name = unit.replace("\\u00B5", "µ").replace("μ", "µ")
    if name not in UM_PER_UNIT:
        raise InputError(f"found {unit!r}", key=key, allowed=f"allowed: {', '.join(UM_PER_UNIT)}")
    return UM_PER_UNIT[name]


def require_size(*shape: int) -> None:
    """Refuse what a file claims to hold before memory is taken for it.

    >>> require_size(1_000_000, 1_000_000)
    Traceback (most recent call last):
    ...
    dlwpredict.errors.InputError: shape: 1000000 x 1000000 points, at most 67108864 in all
    """
    if math.prod(shape) > MOST_POINTS:
        raise InputError(f"{' x '.join(map(str, shape))} points", key="shape", allowed=f"at most {MOST_POINTS} in all")


def float32(values: np.ndarray) -> np.ndarray:
    """Return the numbers as float32, refusing those beyond its range."""
    with np.errstate(over="ignore", under="ignore"):
        single = values.astype("<f4")
    if np.isinf(single).any():
        raise InputError("heights beyond float32", key="heights", allowed="allowed up to 3.4e38 in the file's unit")
    return single


def said(error: Exception) -> str:
    """Return what a library says of a file it cannot read, cut where it quotes the file at length."""
    return str(error)[:150] or type(error).__name__


@dataclass(frozen=True, eq=False)
class Stored:
    """What a file holds, as it stands there: numbers that still need their unit, and what is said about them.

    Parameters
    ----------
    numbers : numpy.ndarray, shape (rows, cols)
        Row 0 on top; NaN = not measured.
    pitch_um : tuple of float, optional
        Pitch (dx, dy) in µm if the file states it.
    z_unit : str, optional
        Unit of the numbers if the file states it; looked up only where the user says nothing.
    z_range_um : tuple of float, optional
        Heights of level 0 and of level ``top_level`` if the file states them.
    top_level : int, optional
        For grey pictures: the level that ``z_range_um`` ends at. Such numbers mean nothing without a range.
    height_reference, filled, instrument
        As in `HeightMap`.
    """

    numbers: np.ndarray
    pitch_um: Pair | None = None
    z_unit: str | None = None
    z_range_um: Pair | None = None
    top_level: int | None = None
    height_reference: HeightReference = "substrate"
    filled: np.ndarray | None = None
    instrument: Instrument = UNKNOWN

    def height_map(
        self, *, pitch_um: Pair | None = None, z_scale: float | None = None, z_range_um: Pair | None = None
    ) -> HeightMap:
        """Return heights in µm; what is given here wins over what the file states.

        Raises
        ------
        InputError
            No pitch in either place, no range for grey levels, a range for numbers that need none, no measured
            point, or anything that `HeightMap` refuses.
        """
        pitch = pitch_um or self.pitch_um
        if pitch is None:
            raise InputError("no pitch in the file", key="pitch", allowed="allowed with --pitch-um DX [DY] of convert")
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows is infinite, and refused as such
            heights = self._heights(z_scale, z_range_um or self.z_range_um)
        if heights.size and np.isnan(heights).all():
            raise InputError("not one measured point (all NaN)", key="heights", allowed="at least one finite height")
        return HeightMap(heights, *pitch, self.height_reference, self.filled, self.instrument)

    def _heights(self, z_scale: float | None, z_range_um: Pair | None) -> np.ndarray:
        heights = np.asarray(self.numbers, dtype=float)
        if self.top_level is None:
            if z_range_um is not None:
                raise InputError("given for numbers that are heights", key="--z-range", allowed="allowed for .png only")
            factor = um_per(self.z_unit or "um", "z_unit") if z_scale is None else z_scale
            return heights if factor == 1 else heights * factor
        if z_range_um is None:
            allowed = "allowed with --z-range LO HI of convert"
            raise InputError("grey levels without a height range", key="range", allowed=allowed)
        low, high = z_range_um
        return (low + heights * ((high - low) / self.top_level)) * (1.0 if z_scale is None else z_scale)


def unmarked(height_map: HeightMap) -> list[str]:
    """Return the remark of a format that cannot keep the mask of filled points."""
    count = 0 if height_map.filled is None else int(height_map.filled.sum())
    return [f"{count} filled points are no longer marked as such (.tif keeps the marks)"] if count else []


def unsaid(height_map: HeightMap, *, reference: bool = False) -> list[str]:
    """Return the remark of a format that cannot keep what is known of the instrument, nor of the heights' zero."""
    lost = ["what recorded it, its fast axis, pitch and scale"] if height_map.instrument != UNKNOWN else []
    lost += ["that its heights are relative"] if reference and height_map.height_reference == "relative" else []
    return [f"the file no longer says {' and '.join(lost)} (.tif does): fits will take it for exact"] if lost else []


@dataclass(frozen=True)
class Format:
    """A height-map format: its endings, its reader and its writer.

    ``read(path, pitch_um)`` gives `Stored`; the pitch is what the user asked for, or None. ``write(path,
    height_map, **knobs)`` writes to a path that is renamed into place afterwards. Both raise `InputError`
    without naming the file: the caller does. The writer returns remarks on what the format could not keep.
    ``channels``: the reader takes a third argument, the title or number of a channel, or None. A file that begins
    with one of ``first_bytes`` is of this format whatever its ending.
    """

    name: str
    endings: tuple[str, ...]
    read: Callable[..., Stored] | None = None
    write: Callable[..., list[str]] | None = None
    channels: bool = False
    first_bytes: tuple[bytes, ...] = ()


@functools.cache
def formats() -> dict[str, Format]:
    """Return every format by ending, collected from the modules of this package.

    Raises
    ------
    RuntimeError
        Two formats claim one ending.
    """
    by_ending: dict[str, Format] = {}
    for module in sorted(entry.name for entry in pkgutil.iter_modules([str(Path(__file__).parent)])):
        this = getattr(importlib.import_module(f"{__package__}.{module}"), "FORMAT", None)
        if not isinstance(this, Format):
            continue
        for ending in this.endings:
            if ending in by_ending:
                raise RuntimeError(f"{ending} is claimed by {by_ending[ending].name} and {this.name}")
            by_ending[ending] = this
    return by_ending


def format_of(path: Path, action: str, first_bytes: bytes = b"") -> Format:
    """Return the format that can ``read`` or ``write`` the path, by its first bytes, else by its ending.

    Raises
    ------
    InputError
        Unknown ending, or one that this program can only read or only write.
    """
    able = {ending: this for ending, this in formats().items() if getattr(this, action)}
    for this in able.values():
        if any(first_bytes.startswith(marked) for marked in this.first_bytes):
            return this
    for ending in sorted(able, key=len, reverse=True):
        if path.name.lower().endswith(ending):
            return able[ending]
    suffixes = "".join(path.suffixes[-2:]) or "no ending"
    raise InputError(f"cannot {action} {suffixes}", key="format", allowed=f"allowed: {' '.join(able)}")

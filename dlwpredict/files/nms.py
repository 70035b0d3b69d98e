"""NanoFocus µSurf (``.nms``): 16-bit heights with an 8-bit intensity picture; intensity 0 = not measured.

Own reader: the general libraries misread this format. Little endian; version text ``OM_MS_2.0``; heights in µm are
``f_low + (f_high − f_low)/(n_high − n_low)·(raw − n_low)``, row by row from byte 3468, pitch in nm.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from dlwpredict.errors import InputError
from dlwpredict.files.formats import Format, Pair, Stored
from dlwpredict.heightmap import Instrument

HEADER_BYTES = 3468
VERSION = b"OM_MS_2.0"
_UINT16, _AREA = 2, 1


def read_nms(path: Path, pitch_um: Pair | None) -> Stored:
    """Read the heights; points without intensity are NaN.

    Raises
    ------
    InputError
        Another version, no 16-bit area, a faulty range or pitch, or a length that does not fit the header.
    """
    content = path.read_bytes()
    if content[32 : 32 + len(VERSION) + 1] != VERSION + b"\0" or len(content) < HEADER_BYTES:
        raise InputError("not an .nms of this version", key="version", allowed=f"allowed: {VERSION.decode()}")
    data_type, dimension, n_low, n_high, f_low, f_high = struct.unpack_from("<4i2d", content)
    cols, rows, dx_nm, dy_nm = struct.unpack_from("<2i2d", content, 1368)
    (has_intensity,) = struct.unpack_from("<i", content, 1416)
    if (data_type, dimension) != (_UINT16, _AREA):
        raise InputError(f"type {data_type}, dimension {dimension}", key="type", allowed="allowed: 2, 1 (16-bit area)")
    if not (n_low < n_high and np.isfinite((f_low, f_high)).all() and f_low < f_high):
        ranges = f"levels {n_low} to {n_high} for {f_low:g} to {f_high:g} µm"
        raise InputError(ranges, key="z range", allowed="allowed: the lower one first")
    if not (np.isfinite((dx_nm, dy_nm)).all() and min(dx_nm, dy_nm) > 0):
        raise InputError(f"found {dx_nm:g} {dy_nm:g} nm", key="pitch", allowed="allowed: positive numbers")
    expected = HEADER_BYTES + cols * rows * (3 if has_intensity == 1 else 2)
    if min(cols, rows) < 1 or has_intensity not in (0, 1) or len(content) != expected:
        raise InputError(f"{len(content)} bytes", key="length", allowed=f"{expected} for {cols} x {rows} points")
    raw = np.frombuffer(content, "<u2", cols * rows, HEADER_BYTES).reshape(rows, cols).astype(float)
    heights_um = f_low + (f_high - f_low) / (n_high - n_low) * (raw - n_low)
    if has_intensity:
        intensity = np.frombuffer(content, np.uint8, offset=HEADER_BYTES + 2 * cols * rows).reshape(rows, cols)
        heights_um[intensity == 0] = np.nan
    return Stored(heights_um, pitch_um=(dx_nm * 1e-3, dy_nm * 1e-3), z_unit="um", instrument=Instrument("confocal"))


FORMAT = Format("NanoFocus µSurf", (".nms",), read_nms)

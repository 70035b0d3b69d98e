"""Float32 TIFF in ImageJ's conventions: the height-map file of this project.

The pitch stands in the resolution tags and, at full precision, in the description, which wins. A private tag keeps
the mask of filled points, so that every other program still sees one plain picture.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import tifffile

from dlwpredict.errors import InputError
from dlwpredict.files.formats import Format, Pair, Stored, float32, require_size, um_per
from dlwpredict.files.key_lines import key_lines, parse_lines, stored_facts
from dlwpredict.heightmap import HeightMap

FILLED_TAG = 65001  # private: zlib-packed bits, row by row
_PITCH_UM = (1e-9, 1e9)  # what fits the ratio of two 32-bit numbers
_BYTES = 7  # TIFF type UNDEFINED
_UM_PER_RESOLUTION_UNIT = {2: 25400.0, 3: 10000.0}  # inch, cm


def read_tiff(path: Path, pitch_um: Pair | None) -> Stored:
    """Read one plane of numbers from a TIFF; integer levels are returned as they stand.

    Raises
    ------
    InputError
        Not a TIFF, truncated, several pages or channels, not stored upright, or faulty lines in the description.
    """
    try:
        with tifffile.TiffFile(path, is_ome=False) as file:  # OME lets a file name others to be read
            page = file.pages.first
            _require_one_plane(file)
            numbers = _numbers(path, file)
            tags = {tag.code: tag.value for tag in page.tags}
            description = page.description
    except InputError:
        raise
    except Exception as error:  # tifffile meets broken files with errors of every kind
        raise InputError(
            f"not a readable TIFF ({type(error).__name__}: {error})", key="file", allowed="needs one plane of numbers"
        ) from None
    lines = parse_lines(description)
    facts = stored_facts(lines)
    if pitch_um is None and "pitch_um" not in facts:
        facts["pitch_um"] = _pitch_from_tags(tags, lines.get("unit"))
    return Stored(numbers, **facts, filled=_unpacked(tags.get(FILLED_TAG), numbers.shape))


def write_tiff(path: Path, height_map: HeightMap) -> list[str]:
    """Write heights as float32, NaN kept; no time stamp, so equal maps give equal bytes.

    Raises
    ------
    InputError
        Heights beyond float32, or a pitch that resolution tags cannot hold.
    """
    pitches = height_map.dx_um, height_map.dy_um
    if not _PITCH_UM[0] <= min(pitches) <= max(pitches) <= _PITCH_UM[1]:
        raise InputError(f"found {min(pitches):g}, {max(pitches):g}", key="pitch", allowed="allowed 1e-9 to 1e9 µm")
    lines, extra = {"unit": "um", **key_lines(height_map)}, []
    if height_map.filled is not None:
        packed = zlib.compress(np.packbits(height_map.filled).tobytes(), 9)
        lines["filled_points"] = str(int(height_map.filled.sum()))
        extra = [(FILLED_TAG, _BYTES, len(packed), packed, True)]
    tifffile.imwrite(
        path,
        float32(height_map.heights_um),
        imagej=True,
        resolution=(1 / pitches[0], 1 / pitches[1]),
        metadata=lines,
        extratags=extra,
        software="dlwpredict",
    )
    return []


def _require_one_plane(file: tifffile.TiffFile) -> None:
    pages = len(file.pages)  # counted, not read: damaged ones take minutes
    shape = file.series[0].shape if pages == 1 else (pages, *file.pages.first.shape)
    if len(shape) != 2:
        raise InputError(f"picture of shape {shape}", key="channels", allowed="one page with one channel of heights")
    require_size(*shape)
    page = file.pages.first
    require_size(*page.shape)
    orientation = page.tags.valueof("Orientation", 1)
    if orientation != 1:
        raise InputError(f"orientation {orientation}", key="orientation", allowed="allowed: 1 (first row on top)")
    if page.dtype is None or page.dtype.kind not in "uif":
        raise InputError(f"values of type {page.dtype}", key="type", allowed="allowed: integer or float")


def _numbers(path: Path, file: tifffile.TiffFile) -> np.ndarray:
    """Return the picture; LZW, which tifffile lacks by itself, is left to Pillow."""
    if file.pages.first.compression != tifffile.COMPRESSION.LZW:
        return file.asarray()
    from PIL import Image

    with _silent(), Image.open(path) as picture:
        return np.asarray(picture)


@contextmanager
def _silent() -> Iterator[None]:
    """Keep a library in C, which writes to stderr by itself, from adding lines to our one."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _pitch_from_tags(tags: dict, unit: str | None) -> Pair | None:
    """Return the pitch that the resolution tags give, or None where they carry no unit of length."""
    x, y = (tags.get(code) for code in (282, 283))
    length: float | None
    if unit and unit not in ("pixel", "pixels"):
        length = um_per(unit, "unit")
    else:
        length = _UM_PER_RESOLUTION_UNIT.get(int(tags.get(296, 1)))
    if length is None or not x or not y or 0 in (*x, *y):
        return None
    return length * x[1] / x[0], length * y[1] / y[0]


def _unpacked(packed: bytes | None, shape: tuple[int, int]) -> np.ndarray | None:
    """Return the mask of filled points."""
    if packed is None:
        return None
    try:
        bits = np.unpackbits(np.frombuffer(zlib.decompress(packed), np.uint8))
        return bits[: np.prod(shape)].astype(bool).reshape(shape)
    except (zlib.error, ValueError, TypeError):
        raise InputError("damaged mask of filled points", key="filled", allowed="write the file again") from None


FORMAT = Format("ImageJ TIFF", (".tif", ".tiff"), read_tiff, write_tiff)

"""Formats of other instruments, read by SurfaceTopography (extra ``instruments``), which is imported only then.

Only formats that state their unit are listed, and each ending goes to its own reader: guessing by content takes one
format for another. ``.dat`` is text, unless the file begins as MetroPro files do.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dlwpredict.errors import InputError
from dlwpredict.files.channels import chosen_channel
from dlwpredict.files.formats import Format, Pair, Stored, said
from dlwpredict.heightmap import Instrument

METROPRO_FIRST_BYTES = (b"\x88\x1b\x03\x6f", b"\x88\x1b\x03\x70", b"\x88\x1b\x03\x71")
READERS = {
    ".al3d": "al3d",
    ".apx": "plu",
    ".bcr": "bcr",
    ".bcrf": "bcr",
    ".datx": "datx",
    ".ezd": "ezd",
    ".frt": "frt",
    ".ibw": "ibw",
    ".jpk": "jpk",
    ".lext": "lext",
    ".mdt": "mdt",
    ".mi": "mi",
    ".mnt": "mnt",
    ".nid": "ezd",
    ".oir": "oir",
    ".opd": "opd",
    ".opdx": "opdx",
    ".os3d": "os3d",
    ".plu": "plu",
    ".plux": "plux",
    ".poir": "poir",
    ".qep": "qep",
    ".spm": "di",
    ".stp": "wsxm",
    ".sur": "sur",
    ".tmd": "tmd",
    ".top": "wsxm",
    ".vk3": "vk",
    ".vk4": "vk",
    ".vk6": "vk",
    ".vk7": "vk",
    ".zmg": "zmg",
    ".zon": "zon",
} | {f".{number:03}": "di" for number in range(6)}
"""Reader by ending, as the library names it."""


AFM = ("di", "ezd", "ibw", "jpk", "mdt", "mi", "wsxm")
"""Readers of scanning probes: a row is a line of the scan."""

KINDS = dict.fromkeys(("datx", "metropro", "opd", "opdx", "zmg"), "wli") | dict.fromkeys(
    ("lext", "oir", "poir", "vk"), "confocal"
)
"""Readers of instruments that are of one kind."""


def read_instrument(path: Path, pitch_um: Pair | None, channel: str | None = None) -> Stored:
    """Read one height channel, converted to µm from the unit that the file states.

    Raises
    ------
    InputError
        The extra is not installed, the reader refuses the file, no areal height channel with a unit of length, or
        several and none named.
    """
    name = READERS.get(path.suffix.lower(), "metropro")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # on parallel machines and on metadata, neither used here
        readers = _library()
        try:
            with readers[name](str(path)) as reader:
                return replace(_stored(reader, pitch_um, channel), instrument=instrument_of(name))
        except InputError:
            raise
        except Exception as error:  # the library meets broken files with errors of every kind
            raise InputError(f"not readable as {name} ({said(error)})", key="file", allowed="a whole file") from None


def instrument_of(reader: str) -> Instrument:
    """Return what writes files that a reader reads.

    Examples
    --------
    >>> instrument_of("di") == Instrument("afm", fast_axis_deg=0.0), instrument_of("vk").kind, instrument_of("sur").kind
    (True, 'confocal', 'unknown')
    """
    return Instrument("afm", 0.0) if reader in AFM else Instrument(KINDS.get(reader, "unknown"))


def _library() -> dict[str, Any]:
    try:
        from SurfaceTopography.IO import lookup_reader_by_format
    except ImportError:
        raise InputError(
            "needs the readers for other instruments",
            key="format",
            allowed="pip install '.[instruments]' in this program's folder, or export .x3p, .sdf or text",
        ) from None
    return lookup_reader_by_format


def _stored(reader: Any, pitch_um: Pair | None, channel: str | None) -> Stored:
    areas = [this for this in reader.channels if this.is_height_channel and this.dim == 2 and this.is_uniform]
    chosen = areas[chosen_channel([str(this.name) for this in areas], channel)]
    if chosen.unit is None:
        raise InputError("the file states none", key="unit", allowed="export text and give --pitch-um, --z-scale")
    surface = chosen.topography().to_unit("um")
    across: np.ndarray = np.ma.asarray(surface.heights(), dtype=float)  # the library has (x, y)
    heights = np.ma.filled(across, np.nan).T
    rows, cols = heights.shape
    width, depth = surface.physical_sizes
    return Stored(heights, pitch_um=pitch_um or (width / cols, depth / rows), z_unit="um")


FORMAT = Format("other instruments", tuple(READERS), read_instrument, channels=True, first_bytes=METROPRO_FIRST_BYTES)

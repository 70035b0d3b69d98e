"""ISO 25178-72 (``.x3p``): a zip of XML and binary heights, metres, NaN = not measured.

Written in revision ISO5436_2000 with float32 heights, which every reader tried takes. The format wants a date; the
same map must give the same bytes, so it is always 1970-01-01, as other programs without a clock write it.
"""

from __future__ import annotations

import io
import zipfile
from datetime import UTC, datetime
from pathlib import Path

from dlwpredict.errors import InputError
from dlwpredict.files.formats import Format, Pair, Stored, float32, said, unmarked, unsaid
from dlwpredict.files.key_lines import parse_lines, stored_facts
from dlwpredict.heightmap import HeightMap

LARGEST_BYTES = 2**29  # of all members unpacked: 8192 x 8192 heights of 8 bytes
LARGEST_XML_BYTES = 2**26
_DATE = datetime(1970, 1, 1, tzinfo=UTC)
_REFERENCE = "height_reference"


def read_x3p(path: Path, pitch_um: Pair | None) -> Stored:
    """Read a surface of one layer; row 0 is the first one stored.

    Raises
    ------
    InputError
        Not an x3p, damaged, larger than allowed once unpacked, with paths that lead out of it or with XML entities,
        or no surface of one layer on an even grid.
    """
    import x3pio

    archive = _unpacked(path)
    try:
        surface = x3pio.read(archive)
    except Exception as error:  # the library meets broken files with errors of every kind
        raise InputError(
            f"not a readable x3p ({said(error)})", key="file", allowed="needs a surface of ISO 25178-72"
        ) from None
    header = surface.header
    if not isinstance(surface, x3pio.Surface) or len(surface.layers) != 1:
        kind = f"{type(surface).__name__.lower()} of {len(surface.layers)} layers"
        raise InputError(kind, key="channels", allowed="a surface of one layer")
    if not (header.x.is_incremental and header.y.is_incremental):
        raise InputError("x and y of every point", key="axes", allowed="an even grid")
    lines = parse_lines((surface.metadata and surface.metadata.comment) or "")
    facts = stored_facts({_REFERENCE: lines[_REFERENCE]} if _REFERENCE in lines else {})
    pitch = header.x.increment * 1e6, header.y.increment * 1e6
    return Stored(surface.layers[0].z, pitch_um=pitch, z_unit="m", **facts)


def write_x3p(path: Path, height_map: HeightMap) -> list[str]:
    """Write heights in metres as float32, NaN kept."""
    import x3pio

    metadata = x3pio.Metadata.for_software("dlwpredict", "not stated", date=_DATE)
    if height_map.height_reference != "substrate":
        metadata.comment = f"{_REFERENCE}={height_map.height_reference}"
    with path.open("wb") as stream:
        x3pio.write(
            stream,
            float32(height_map.heights_um * 1e-6),
            x_scale=height_map.dx_um * 1e-6,
            y_scale=height_map.dy_um * 1e-6,
            z_type=x3pio.DataType.FLOAT32,
            revision=x3pio.Revision.ISO5436_2000,
            metadata=metadata,
        )
    return unmarked(height_map) + unsaid(height_map)


def _unpacked(path: Path) -> io.BytesIO:
    """Return the archive again without compression, each member read no further than is allowed.

    A zip may state any size it likes, so sizes are counted while unpacking, and what reads the copy meets true ones.
    """
    copy, left = io.BytesIO(), LARGEST_BYTES
    try:
        with zipfile.ZipFile(path) as archive, zipfile.ZipFile(copy, "w") as again:
            for member in archive.infolist():
                _require_inside(member.filename)
                most = min(left, LARGEST_XML_BYTES) if member.filename.endswith(".xml") else left
                with archive.open(member) as stream:
                    content = stream.read(most + 1)
                if len(content) > most:
                    raise InputError(
                        f"{member.filename[:80]} unpacks to more than {most} bytes",
                        key="size",
                        allowed=f"at most {LARGEST_BYTES} bytes in all, {LARGEST_XML_BYTES} of XML",
                    )
                left -= len(content)
                again.writestr(member.filename, content)
    except InputError:
        raise
    except Exception as error:  # zipfile meets broken archives with errors of every kind
        raise InputError(f"not a readable zip ({said(error)})", key="file", allowed="an x3p is a zip archive") from None
    copy.seek(0)
    return copy


def _require_inside(name: str) -> None:
    parts = name.replace("\\", "/").split("/")
    if parts[0] == "" or parts[0].endswith(":") or ".." in parts:
        raise InputError(
            f"member {name[:80]!r} leads out of the archive", key="path", allowed="names inside the archive"
        )


FORMAT = Format("ISO 25178-72 x3p", (".x3p",), read_x3p, write_x3p)

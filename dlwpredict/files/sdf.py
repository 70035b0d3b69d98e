"""Surface data files of ISO 25178-71 (``.sdf``), text and binary, revisions ISO-1.0, ISO-2.0 and BCR-1.0."""

from __future__ import annotations

from pathlib import Path

from dlwpredict.errors import InputError
from dlwpredict.files.formats import Format, Pair, Stored, said


def read_sdf(path: Path, pitch_um: Pair | None) -> Stored:
    """Read heights and pitch, both in metres; ``BAD`` = not measured. The first profile is row 0.

    Raises
    ------
    InputError
        Not an SDF, truncated, compressed, or with a faulty field.
    """
    import sdfio

    try:
        surface = sdfio.read(path)
    except Exception as error:  # the library meets broken files with errors of every kind
        raise InputError(
            f"not a readable SDF ({said(error)})", key="file", allowed="needs ISO-1.0, ISO-2.0 or BCR-1.0"
        ) from None
    heights = surface.header.revision.rules.order_rows(surface.data)  # the library turns BCR upside down
    scale = surface.header.x_scale, surface.header.y_scale
    return Stored(heights, pitch_um=pitch_um or (scale[0] * 1e6, scale[1] * 1e6), z_unit="m")


FORMAT = Format("ISO 25178-71 SDF", (".sdf",), read_sdf)

"""Read and write height maps of any known format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dlwpredict.errors import InputError, blaming
from dlwpredict.files.atomic import replacing
from dlwpredict.files.formats import format_of
from dlwpredict.files.provenance import note_input, note_map
from dlwpredict.heightmap import HeightMap

LARGEST_UM = 1e12
"""Height beyond which numbers are none of a surface, in whatever unit: a thousand kilometres."""


def read_height_map(
    path: Path | str,
    *,
    pitch_um: float | tuple[float, ...] | None = None,
    z_scale: float | None = None,
    z_range_um: tuple[float, float] | None = None,
    channel: str | None = None,
) -> HeightMap:
    """Read a height map; the ending decides the format.

    Parameters
    ----------
    path : pathlib.Path or str
        File to read.
    pitch_um : float or tuple of float, optional
        Pitch (dx, dy) or one for both, µm. Wins over the file's; needed where the file has none.
    z_scale : float, optional
        µm per stored number (metres: 1e6). Wins over the unit in the file; 1 where neither says.
    z_range_um : tuple of float, optional
        Heights of the lowest and the highest grey level (pictures only), µm.
    channel : str, optional
        Title or number (from 1) of the channel, for formats that can hold several.

    Raises
    ------
    InputError
        Missing, unreadable or malformed file, unknown ending, no pitch, no measured point, infinite heights.
    """
    path = Path(path)
    with blaming(path):
        pitch = _pair(pitch_um)
        _check_scale(z_scale)
        _check_range(z_range_um)
        chosen = format_of(path, "read", _first_bytes(path))
        if channel is not None and not chosen.channels:
            raise InputError(f"given for {chosen.name}", key="--channel", allowed="allowed where a file has several")
        note_input(path)
        assert chosen.read is not None  # `format_of` has seen to it
        stored = chosen.read(path, pitch, channel) if chosen.channels else chosen.read(path, pitch)
        height_map = stored.height_map(pitch_um=pitch, z_scale=z_scale, z_range_um=z_range_um)
        _check_sizes(height_map)
    note_map(path, height_map)
    return height_map


def _check_sizes(height_map: HeightMap) -> None:
    """Refuse heights that no surface has, whatever its unit was taken for."""
    most = float(np.nanmax(np.abs(height_map.heights_um), initial=0.0))
    if most > LARGEST_UM:
        raise InputError(f"heights up to {most:.4g} µm", key="heights", allowed=f"up to {LARGEST_UM:g} µm either way")


def write_height_map(path: Path | str, height_map: HeightMap, **knobs: Any) -> list[str]:
    """Write a height map whole or not at all; the ending decides the format, ``knobs`` go to its writer.

    Returns
    -------
    list of str
        Remarks on what the format could not keep (pitch, marks, heights lifted).

    Raises
    ------
    InputError
        Unknown ending, folder missing, or heights that the format cannot hold.
    """
    path = Path(path)
    with blaming(path):
        chosen = format_of(path, "write")
        assert chosen.write is not None  # `format_of` has seen to it
        with replacing(path) as temporary:
            return chosen.write(temporary, height_map, **knobs)


def _pair(pitch_um: float | tuple[float, ...] | None) -> tuple[float, float] | None:
    """Return (dx, dy), each a positive number of µm."""
    if pitch_um is None:
        return None
    values = np.atleast_1d(np.asarray(pitch_um, dtype=float))
    if values.shape not in ((1,), (2,)) or not (np.isfinite(values).all() and (values > 0).all()):
        numbers = " ".join(f"{value:g}" for value in values.ravel())
        raise InputError(f"found {numbers}", key="--pitch-um", allowed="allowed: one or two positive numbers of µm")
    return float(values[0]), float(values[-1])


def _check_scale(z_scale: float | None) -> None:
    if z_scale is not None and not (np.isfinite(z_scale) and z_scale != 0):
        raise InputError(f"found {z_scale:g}", key="--z-scale", allowed="allowed: a finite number, not 0")


def _check_range(z_range_um: tuple[float, float] | None) -> None:
    if z_range_um is not None and not (np.isfinite(z_range_um).all() and z_range_um[0] < z_range_um[1]):
        numbers = " ".join(f"{value:g}" for value in z_range_um)
        raise InputError(f"found {numbers}", key="--z-range", allowed="allowed: two numbers of µm, the lower one first")


def _first_bytes(path: Path) -> bytes:
    """Return what the file begins with; refuse what is missing, a folder, not readable, or empty."""
    if path.is_dir():
        raise InputError("is a folder", key="file", allowed="give a file")
    try:
        with path.open("rb") as stream:
            first = stream.read(16)
    except OSError as error:
        raise InputError(f"cannot read ({error.strerror})", key="file") from None
    if not first:
        raise InputError("is empty", key="file", allowed="a height map")
    return first

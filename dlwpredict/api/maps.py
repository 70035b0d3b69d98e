"""Height maps: read, written, made by formula, drawn."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dlwpredict.designs import KINDS
from dlwpredict.errors import InputError
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.heightmap import HeightMap

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def read(path: str | PathLike[str], **settings: Any) -> HeightMap:
    """Read a height map; the ending of the file decides the format.

    Parameters
    ----------
    path : str or path
    **settings
        For files that do not say it: ``pitch_um``, ``z_scale`` (µm per stored number), ``z_range_um``, ``channel``.

    Raises
    ------
    InputError
        The file is missing, unreadable, or does not say its pitch.
    """
    return read_height_map(Path(path), **settings)


def write(path: str | PathLike[str], height_map: HeightMap) -> list[str]:
    """Write a height map, whole or not at all; return remarks on what the format could not keep."""
    return write_height_map(Path(path), height_map)


def design(kind: str, **settings: Any) -> HeightMap:
    """Make a target by formula.

    Parameters
    ----------
    kind : str
        air, blaze, cin, f, fresnel, grating, lens, lens-array, pads, posts or stairs.
    **settings
        What ``dlwpredict design KIND --help`` lists, in µm: ``size_um``, ``pitch_um``, ``margin_um`` ...

    Raises
    ------
    InputError
        Unknown kind, or a setting out of range.
    """
    if kind not in KINDS:
        raise InputError(f"found {kind}", key="kind", allowed=f"allowed: {', '.join(sorted(KINDS))}")
    return KINDS[kind](**settings)


def plot(*maps: HeightMap, names: Sequence[str] = ()) -> Figure:
    """Draw one map, or a reference and a test with their difference, and profiles.

    Parameters
    ----------
    *maps : HeightMap
        One, or two on one grid.
    names : sequence of str, optional

    Returns
    -------
    matplotlib.figure.Figure
        A notebook shows it; ``figure.savefig("map.png")`` keeps it.
    """
    from dlwpredict import plots  # matplotlib takes a second

    if len(maps) not in (1, 2):
        raise InputError(f"found {len(maps)} maps", key="maps", allowed="allowed: one, or two on one grid")
    if len(maps) == 1:
        return plots.overview(maps[0], name=names[0] if names else "height map")
    reference, test = names or ("reference", "test")
    return plots.comparison(*maps, names=(reference, test))

"""STL: the solid a printer slices. The number in the file is µm; x to the right, y up, z = 0 the substrate.

Reading looks at the solid from above: the highest point over every pixel centre, nothing = 0.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dlwpredict.errors import InputError, ResultError
from dlwpredict.files.formats import Format, Pair, Stored, float32
from dlwpredict.heightmap import HeightMap
from dlwpredict.solid.mesh import Solid, solid_of
from dlwpredict.solid.rasterise import seen_from_above

_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])
_HEAD = 84  # 80 bytes of text, then the number of triangles
_TITLE = b"dlwpredict, lengths in um, z = 0 on the substrate"
_VOLUME_TOLERANCE = 1e-4


def read_stl(path: Path, pitch_um: Pair | None) -> Stored:
    """Rasterise the mesh from above; its lowest point is the substrate.

    Raises
    ------
    InputError
        Neither binary nor ASCII STL, no triangles, or no pitch given.
    """
    if pitch_um is None:
        raise InputError("an STL has no pixels", key="pitch", allowed="allowed with --pitch-um DX [DY] of convert")
    triangles = halved(read_triangles(path), np.array(pitch_um))
    return Stored(seen_from_above(triangles, *pitch_um), pitch_um=pitch_um)


def read_triangles(path: Path) -> np.ndarray:
    """Return the corners of all triangles of a binary or ASCII STL, shape (n, 3, 3), µm."""
    content = path.read_bytes()
    count = int.from_bytes(content[80:_HEAD], "little")
    if len(content) > _HEAD and len(content) == _HEAD + count * _RECORD.itemsize:
        with np.errstate(invalid="ignore"):  # what is not a number is refused below
            triangles = np.frombuffer(content, _RECORD, offset=_HEAD)["corners"].astype(float)
    elif content.lstrip()[:5].lower() == b"solid":
        triangles = _ascii_triangles(content)
    else:
        raise InputError("not a whole STL", key="file", allowed="binary or ASCII STL")
    if not triangles.size or not (np.abs(triangles) <= np.finfo("<f4").max).all():  # text can say more than float32
        raise InputError("no triangles, or not finite", key="triangles", allowed="a mesh of finite corners")
    return triangles


def halved(triangles_um: np.ndarray, pitch_um: np.ndarray, most_pixels: float = 2e6) -> np.ndarray:
    """Halve triangles across their longest edge, seen from above, until none needs many pixels at a time.

    Parameters
    ----------
    triangles_um : numpy.ndarray, shape (n, 3, 3)
    pitch_um : numpy.ndarray, shape (2,)
    most_pixels : float
        Pixels in the box around a triangle. A mesh of more than 10⁸ in all is left as it is, for it cannot be read.

    Examples
    --------
    >>> plate = np.array([[[0, 0, 1], [8, 0, 1], [8, 8, 1]]])
    >>> halved(plate, np.array([1.0, 1.0]), most_pixels=40)[:, :, :2].tolist()
    [[[8.0, 8.0], [4.0, 4.0], [8.0, 0.0]], [[4.0, 4.0], [0.0, 0.0], [8.0, 0.0]]]
    """
    with np.errstate(over="ignore"):
        if np.prod(np.ptp(triangles_um[..., :2], axis=(0, 1)) / pitch_um) > 1e8:
            return triangles_um
    while (large := np.prod(np.ptp(triangles_um[..., :2], axis=1) / pitch_um, axis=1) > most_pixels).any():
        corners = triangles_um[large]
        edges = np.linalg.norm((corners - np.roll(corners, -1, axis=1))[..., :2], axis=2)
        order = (edges.argmax(axis=1)[:, None] + np.arange(3)) % 3
        a, b, c = (np.take_along_axis(corners, order[:, k, None, None], axis=1)[:, 0] for k in range(3))
        middle = (a + b) / 2
        halves = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
        triangles_um = np.concatenate([triangles_um[~large], halves])
    return triangles_um


def _ascii_triangles(content: bytes) -> np.ndarray:
    words = [line.split() for line in content.lower().splitlines()]
    try:
        if not any(line[:1] == [b"endsolid"] for line in words):
            raise ValueError
        return np.array([line[1:4] for line in words if line[:1] == [b"vertex"]], dtype=float).reshape(-1, 3, 3)
    except ValueError:
        raise InputError("not a whole ASCII STL", key="file", allowed="three vertex lines per facet") from None


def write_stl(path: Path, height_map: HeightMap, *, base_um: float = 0.0, min_thickness_um: float = 0.1) -> list[str]:
    """Write the solid under a height map, and check the file; see `dlwpredict.solid.mesh.solid_of`."""
    solid = solid_of(height_map, base_um=base_um, min_thickness_um=min_thickness_um)
    write_solid(path, solid)
    return solid.remarks


def write_solid(path: Path, solid: Solid) -> None:
    """Write a solid as binary STL, read it back, and have trimesh check it.

    Raises
    ------
    ResultError
        What was written is not watertight, not wound consistently, or has another volume.
    """
    vertices = float32(solid.vertices_um)
    corners = vertices[solid.faces]
    records = np.zeros(len(corners), _RECORD)
    records["corners"] = corners
    records["normal"] = _normals(corners)
    with path.open("wb") as stream:
        stream.write(_TITLE.ljust(80, b"\0") + len(records).to_bytes(4, "little"))
        stream.write(records.tobytes())
    if not np.array_equal(read_triangles(path), corners):
        raise ResultError("the file does not read back as written", key="mesh", allowed="check the disk")
    _require_solid(vertices, solid)


def _normals(corners: np.ndarray) -> np.ndarray:
    """Return the unit normals of triangles (n, 3, 3)."""
    a, b, c = (corners[:, k].astype(float) for k in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(lengths > 0, lengths, 1.0)


def _require_solid(vertices: np.ndarray, solid: Solid) -> None:
    """Check the mesh as any program sees it that joins equal corners of the STL."""
    import trimesh

    mesh = trimesh.Trimesh(vertices, solid.faces, process=True)
    if not (mesh.is_watertight and mesh.is_winding_consistent):
        raise ResultError("mesh is not watertight", key="mesh", allowed="pixels too small for float32 at this size")
    if not (mesh.volume > 0 and abs(mesh.volume / solid.volume_um3 - 1) < _VOLUME_TOLERANCE):
        raise ResultError(f"mesh holds {mesh.volume:.6g} µm³", key="mesh", allowed=f"must hold {solid.volume_um3:.6g}")


FORMAT = Format("binary STL", (".stl",), read_stl, write_stl)

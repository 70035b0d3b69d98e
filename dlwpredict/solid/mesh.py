"""Height map to a watertight solid: vertices and faces, numpy only.

Footprint: every written pixel owns the points of the map nearer to it than to its neighbours, so the border of a part
runs half-way between written and unwritten pixels. The map itself ends at its outermost pixel centres. The top
passes through the heights at the pixel centres; beyond the last written pixel it stays level up to the border. The
base is flat at z = 0, walls are vertical.

Seen from above: x = col·dx, y = (rows − 1 − row)·dy, so the solid looks like the picture.

Two written pixels that touch by a corner only would share one vertical edge, which no solid has: both corners are
drawn back by 1/64 of a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dlwpredict.errors import InputError, ResultError
from dlwpredict.heightmap import TALLEST_UM, HeightMap
from dlwpredict.solid.bisection import triangles
from dlwpredict.solid.rasterise import seen_from_above

NOTHING_UM = 1e-3  # heights below 1 nm count as nothing written
_DRAWN_BACK = 1 / 64


@dataclass(frozen=True, eq=False)
class Solid:
    """A closed surface: ``vertices_um`` (n, 3) in µm, ``faces`` (m, 3), anticlockwise seen from outside.

    ``lifted_points`` heights were raised, by at most ``largest_lift_um``, to the smallest thickness.
    """

    vertices_um: np.ndarray
    faces: np.ndarray
    lifted_points: int = 0
    largest_lift_um: float = 0.0

    @property
    def remarks(self) -> list[str]:
        """Say which heights were lifted."""
        lift = f"{self.lifted_points} points lifted to the smallest thickness, by up to {self.largest_lift_um:.4g} µm"
        return [lift] if self.lifted_points else []

    @property
    def volume_um3(self) -> float:
        """Volume by the divergence theorem, Σ a·(b × c)/6 over the faces, µm³."""
        a, b, c = (self.vertices_um[self.faces[:, k]] for k in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def solid_of(
    height_map: HeightMap, *, base_um: float = 0.0, min_thickness_um: float = 0.1, error_um: float | None = None
) -> Solid:
    """Build the solid under a height map.

    Parameters
    ----------
    height_map : HeightMap
        Heights, µm, shape (rows, cols); 0 = nothing written there.
    base_um : float
        Thickness of a plate under the whole map, µm; 0 = none, unwritten pixels are left out.
    min_thickness_um : float
        Smallest thickness of what stands, µm (one slice); lower heights are lifted.
    error_um : float, optional
        With as few faces as keep the top within this distance of every height, µm; if not given, with all.

    Raises
    ------
    InputError
        NaN or negative heights, nothing written at all, thickness or plate out of range.
    """
    heights = _checked(height_map, base_um, min_thickness_um)
    written = heights >= NOTHING_UM if base_um == 0 else np.ones(heights.shape, dtype=bool)
    if not written.any():
        raise InputError("nothing written (no height above 1 nm)", key="heights", allowed="at least one written pixel")
    heights = np.where(written, heights + base_um, 0.0)
    lift = np.where(written, min_thickness_um - heights, 0.0).clip(min=0)
    nodes = _Nodes.of(heights + lift, written)
    vertices, faces = _compact(nodes, _closed(nodes, written, heights + lift, error_um))
    vertices *= (height_map.dx_um / 2, -height_map.dy_um / 2, 1.0)
    vertices[:, 1] += (written.shape[0] - 1) * height_map.dy_um
    return Solid(vertices, faces, int((lift > 0).sum()), float(lift.max()))


def merged(
    whole: Solid, part: HeightMap, max_faces: int, max_error_um: float, base_um: float, min_thickness_um: float
) -> tuple[Solid, float]:
    """Return the solid with merged triangles, and how far its surface is from the whole one's, µm.

    Raises
    ------
    ResultError
        More triangles are needed to stay within the error.
    """
    if not 0 < max_error_um <= 1:
        raise InputError(f"found {max_error_um:g}", key="--max-error-um", allowed="allowed above 0, up to 1 µm")
    solid = solid_of(part, base_um=base_um, min_thickness_um=min_thickness_um, error_um=max_error_um)
    if len(solid.faces) > max_faces:
        raise ResultError(
            f"{len(solid.faces)} triangles are needed to stay within {max_error_um:g} µm",
            key="--max-faces",
            allowed="allowed: as many, or a larger --max-error-um",
        )
    error_um = largest_distance_um(solid, whole, part)
    if error_um > max_error_um * (1 + 1e-6):
        raise ResultError(f"surface {error_um:.3g} µm off", key="--max-faces", allowed=f"allowed {max_error_um:g}")
    return solid, error_um


def largest_distance_um(first: Solid, second: Solid, height_map: HeightMap) -> float:
    """Return how far apart two solids of one height map are at most, seen from above at its pixels, µm."""
    pitch = height_map.dx_um, height_map.dy_um
    seen, against = (seen_from_above(solid.vertices_um[solid.faces], *pitch) for solid in (first, second))
    return float(np.abs(seen - against).max())


def boundary_edges(faces: np.ndarray) -> np.ndarray:
    """Return the directed edges (n, 2) of a surface that no other face shares."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    low, high = edges.min(axis=1), edges.max(axis=1)
    _, first, count = np.unique(low * (high.max() + 1) + high, return_index=True, return_counts=True)
    return edges[first[count == 1]]


def _checked(height_map: HeightMap, base_um: float, min_thickness_um: float) -> np.ndarray:
    heights = height_map.heights_um
    if missing := int(np.isnan(heights).sum()):
        raise InputError(
            f"{missing} points not measured", key="heights", allowed="a solid has no NaN: use --fill zero|nearest|VALUE"
        )
    if heights.min() < 0:
        raise InputError(
            f"{int((heights < 0).sum())} negative heights, lowest {heights.min():.4g} µm",
            key="heights",
            allowed="allowed: 0 (nothing written) and above",
        )
    if heights.max() > TALLEST_UM:
        raise InputError(
            f"highest height {heights.max():.4g} µm", key="heights", allowed=f"allowed up to {TALLEST_UM:g} µm"
        )
    if not 0.001 <= min_thickness_um <= 1000:
        raise InputError(f"found {min_thickness_um:g}", key="--min-thickness-um", allowed="allowed 0.001 to 1000 µm")
    if base_um != 0 and not min_thickness_um <= base_um <= 1e4:
        raise InputError(
            f"found {base_um:g}", key="--base-um", allowed=f"allowed: 0 or {min_thickness_um:g} to 10000 µm"
        )
    return heights


def _corners(pixels: np.ndarray) -> list[np.ndarray]:
    """Return the pixels at the four corners of every cell, anticlockwise from the lower left."""
    return [pixels[1:, :-1], pixels[1:, 1:], pixels[:-1, 1:], pixels[:-1, :-1]]


@dataclass(frozen=True, eq=False)
class _Nodes:
    """Numbered points of the top, on a grid of half pixels; the base repeats them with ``count`` added.

    ``row``, ``col`` in half pixels and ``z`` in µm, each (count,). Per cell of four pixels, anticlockwise:
    ``corner[k]``, ``middle[k]`` between corners k and k + 1, ``centre[k]`` as seen from corner k.
    """

    row: np.ndarray
    col: np.ndarray
    z: np.ndarray
    corner: list[np.ndarray]
    middle: list[np.ndarray]
    centre: list[np.ndarray]

    @property
    def count(self) -> int:
        return self.z.size

    @classmethod
    def of(cls, heights: np.ndarray, written: np.ndarray) -> _Nodes:
        """Number the points and give each its height; unwritten pixels have height 0."""
        rows, cols = (2 * n - 1 for n in heights.shape)
        number = np.arange(rows * cols).reshape(rows, cols)
        z = np.zeros((rows, cols))
        z[::2, ::2] = heights
        z[::2, 1::2] = heights[:, 1:] + heights[:, :-1]  # a node only where one of the two is not written
        z[1::2, ::2] = heights[1:] + heights[:-1]
        z[1::2, 1::2] = _centre_heights(_corners(heights), _corners(written))
        row, col = (axis.ravel().astype(float) for axis in np.indices((rows, cols)))
        middle = [number[2::2, 1::2], number[1::2, 2::2], number[:-2:2, 1::2], number[1::2, :-2:2]]
        centre = [number[1::2, 1::2].copy() for _ in range(4)]
        extra = _draw_back(centre, heights, written, number.size)
        row, col, z = (np.concatenate([a, b]) for a, b in zip((row, col, z.ravel()), extra, strict=True))
        return cls(row, col, z, _corners(number[::2, ::2]), middle, centre)


def _centre_heights(heights: list[np.ndarray], written: list[np.ndarray]) -> np.ndarray:
    """Return the height in mid-cell: with one written corner its height, with three the mean of the outer two."""
    total, count = sum(heights), sum(w.astype(int) for w in written)
    opposite = sum(np.where(written[k], 0.0, heights[k - 2]) for k in range(4))
    return np.where(count == 3, (total - opposite) / 2, total)


def _draw_back(
    centre: list[np.ndarray], heights: np.ndarray, written: np.ndarray, first: int
) -> tuple[np.ndarray, ...]:
    """Give corners that touch diagonally a centre node each, drawn back towards its pixel; return row, col, z."""
    extra = [np.zeros((3, 0))]
    w, h = _corners(written), _corners(heights)
    for k, (down, right) in enumerate(((1, -1), (1, 1), (-1, 1), (-1, -1))):
        i, j = np.nonzero(w[k] & w[k - 2] & ~w[k - 1] & ~w[k - 3])
        centre[k][i, j] = first + np.arange(i.size)
        first += i.size
        back = 2 * _DRAWN_BACK
        extra.append(np.stack([2 * i + 1 + down * back, 2 * j + 1 + right * back, h[k][i, j]]))
    return tuple(np.concatenate(extra, axis=1))


def _fan(where: np.ndarray, *polygon: np.ndarray) -> np.ndarray:
    """Return triangles (n, 3) of one convex-from-its-first-corner polygon in every chosen cell."""
    first, *others = (nodes[where] for nodes in polygon)
    return np.concatenate([np.stack([first, a, b], axis=1) for a, b in pairwise(others)])


def _cover(nodes: _Nodes, written: np.ndarray, full: np.ndarray) -> np.ndarray:
    """Return the triangles over the written parts of all cells; of the full cells only those asked for."""
    w, K, M, X = _corners(written), nodes.corner, nodes.middle, nodes.centre
    parts = [_fan(full, *K)]
    for a in range(4):
        b, c, d = (a + 1) % 4, (a + 2) % 4, (a + 3) % 4
        alone, pair, three = w[a] & ~w[b] & ~w[d], w[a] & w[b] & ~w[c] & ~w[d], w[a] & w[b] & w[c] & ~w[d]
        parts.append(_fan(alone, K[a], M[a], X[a], M[d]))
        parts.append(_fan(pair, K[a], K[b], M[b], M[d]))
        parts.append(_fan(three, K[b], K[c], M[c], X[b], M[d], K[a]))
    return np.concatenate(parts)


def _closed(nodes: _Nodes, written: np.ndarray, heights: np.ndarray, error_um: float | None) -> np.ndarray:
    """Return top, base and walls; the top within an error of the heights, or through all of them."""
    full = np.logical_and.reduce(_corners(written))
    top = _cover(nodes, written, full) if error_um is None else _sparse(nodes, written, full, heights, error_um)
    base = _sparse(nodes, written, full, np.zeros_like(heights), 0.0)[:, ::-1]
    u, v = boundary_edges(top).T
    low_u, low_v = u + nodes.count, v + nodes.count
    walls = np.concatenate([np.stack([low_u, low_v, v], axis=1), np.stack([low_u, v, u], axis=1)])
    return np.concatenate([top, base + nodes.count, walls])


def _sparse(nodes: _Nodes, written: np.ndarray, full: np.ndarray, heights: np.ndarray, error_um: float) -> np.ndarray:
    """Return few triangles over the full cells, within an error of the heights, and all of the other cells'."""
    keep = np.zeros(written.shape, dtype=bool)
    for corner in _corners(keep):
        corner |= ~full
    corners = triangles(heights, keep, error_um)
    within = full[tuple((corners.sum(axis=1) // 3).T)]  # the cell in the middle; a larger one lies in full cells only
    pixel = np.empty(written.shape, dtype=int)
    for into, number in zip(_corners(pixel), nodes.corner, strict=True):
        into[:] = number
    merged = pixel[tuple(np.moveaxis(corners[within], -1, 0))]
    return np.concatenate([merged, _cover(nodes, written, np.zeros_like(full))])


def _compact(nodes: _Nodes, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the used points as (col, row, z) in half pixels and µm, and the faces renumbered."""
    used = np.zeros(2 * nodes.count, dtype=bool)
    used[faces] = True
    numbers = np.flatnonzero(used)
    renumbered = np.cumsum(used) - 1
    top = numbers % nodes.count
    z = np.where(numbers < nodes.count, nodes.z[top], 0.0)
    return np.stack([nodes.col[top], nodes.row[top], z], axis=1), renumbered[faces]

"""Lateral shrinkage: the base adheres to the substrate, the top draws inwards, as a whole or where it has edges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import linalg, ndimage

from dlwpredict.effects.base import MapEffect
from dlwpredict.effects.plane import centroid_um, nearest, pixel_of, standing
from dlwpredict.heightmap import HeightMap
from dlwpredict.numerics.interpolation import read_locally
from dlwpredict.parameters import declare

REACH = 1.3
"""Shear lag of a layer over its height, √(E′/2G) = 1/√(1 − ν), with Poisson's ratio ν = 0.4 of a glassy polymer."""

_LAYERS = 8
"""Heights at which the pull of free edges is computed; between them it is nearly straight."""

_SECANTS = 6
"""Steps that find a smooth surface."""

_PARTS, _DIVISIONS = 4, 13
"""Elsewhere an interval is divided into so many parts, so often: 2⁻²⁶ of it are left."""

_SETTLED_UM = 1e-7
_BESIDE, _BARE = -1e9, 1e-6

Depth = Callable[[np.ndarray, np.ndarray], np.ndarray]


def edge_pull_um(surface: HeightMap, z_um: float) -> np.ndarray:
    """Return how far a layer at height z moves per unit of strain where only its edges are free, (x, y; rows, cols).

    Shear holds it back over l = 1.3 z (shear lag: Cox, Br. J. Appl. Phys. 3, 72, 1952): w·u = ∇·(l²w·(1 + ∇u)), w the
    part of what is below z that is resin, no force across its edges. With m = x + u: w·m − ∇·(l²w ∇m) = w·x, solved
    along each axis in turn: exactly that on rectangles. A straight wall comes in by l, which dies away as e^(−d/l), a
    strip of half width R by l·tanh(R/l); on a gentle slope the surface moves by l²/2z · ∇h, to where more resin is.
    """
    if z_um <= 0:
        return np.zeros((2, *surface.shape))
    resin = np.clip(surface.heights_um / z_um, _BARE, 1)
    x, y = (line + np.zeros(surface.shape) for line in (surface.x_um, surface.y_um[:, None]))
    stiff = {axis: (REACH * z_um / pitch) ** 2 for axis, pitch in ((0, surface.dy_um), (1, surface.dx_um))}
    for axis in (1, 0):
        x, y = _held(x, resin, stiff[axis], axis), _held(y, resin, stiff[1 - axis], 1 - axis)
    return np.stack([x - surface.x_um, y - surface.y_um[:, None]])


def _held(values: np.ndarray, resin: np.ndarray, stiff: float, axis: int) -> np.ndarray:
    """Return m of w·m − ∂(stiff · w ∂m) = w · values along one axis, in pixels; nothing passes from the last pixels."""
    lines, known = np.moveaxis(resin, axis, -1), np.moveaxis(values, axis, -1)
    joint = np.pad(stiff * np.minimum(lines[:, 1:], lines[:, :-1]), [(0, 0), (1, 1)])
    bands = np.stack([-joint[:, :-1].ravel(), (lines + joint[:, :-1] + joint[:, 1:]).ravel()])
    solved = linalg.solveh_banded(bands, (lines * known).ravel(), check_finite=False)
    return np.moveaxis(solved.reshape(lines.shape), -1, axis)


def drawn_inwards(surface: HeightMap, strain: float, pin_height_um: float, free_edges: float = 0.0) -> np.ndarray:
    """Return the surface of a part whose resin moved from x to x + strain · (1 − e^(−z/H)) · u(x, z).

    u is (1 − f) · (x_c − x) + f · `edge_pull_um`: drawn to the centroid x_c of the footprint, as far as edges are not
    all that is free. The new height at x′ is the largest z at which the resin that moved there, from x(x′, z), belongs
    to the part: z ≤ h(x). Newton's step from x′ finds x, exact where u is straight. Secants find z where the surface
    is smooth. They begin at the higher of the surface here and of that where the highest resin would come from, so that
    a top that has come to lie over lower ground is seen. Elsewhere an interval is divided, so that walls may lean as
    far as they do. Law and pinning height are ours; Lang et al. 2022 leave lateral shrinkage out.

    Parameters
    ----------
    surface : HeightMap
    strain : float
        Shrinkage far above the base, ≥ 0.
    pin_height_um : float
        H, height over which the base holds the part back.
    free_edges : float
        f, 0 to 1.
    """
    footprint = standing(surface)
    if not footprint.any():
        return surface.heights_um
    rows, cols = np.nonzero(footprint)
    here = np.stack([surface.x_um[cols], surface.y_um[rows]])
    # heights continue beyond the footprint, so that only the footprint itself ends a wall
    continued = nearest(surface.heights_um, footprint)
    around = ndimage.minimum_filter(continued, 3, mode="nearest"), ndimage.maximum_filter(continued, 3, mode="nearest")
    resin, inside = footprint.astype(float), ndimage.binary_erosion(footprint, np.ones((3, 3)), border_value=1)
    top, every = 1.2 * surface.heights_um.max(), np.arange(len(rows))
    pull, slope = _pulls(surface, footprint, free_edges, top)

    def depth(z: np.ndarray, some: np.ndarray) -> np.ndarray:
        """Return how far z lies below the surface where its resin came from, far above it where that is no part."""
        moved = strain * (1 - np.exp(-z / pin_height_um))
        by, slopes = (_between(nodes[..., some], z / top) for nodes in (pull, slope))
        place = pixel_of(surface, *(here[:, some] - moved * by / (1 + moved * slopes)))
        pixel = tuple(
            np.clip(np.rint(line).astype(int), 0, n - 1) for line, n in zip(place, surface.shape, strict=True)
        )
        # a cubic overshoots at cliffs inside the footprint
        below = np.clip(read_locally(continued, place), *(limit[pixel] for limit in around)) - z
        rim = np.flatnonzero(~inside[pixel])
        part = ndimage.map_coordinates(resin, place[:, rim], order=1, mode="grid-constant")
        below[rim[part < 0.5]] = _BESIDE
        return below

    highest = top + depth(np.full(len(rows), top), every)
    z, settled = _by_secants(depth, np.maximum(surface.heights_um[footprint], highest), top)
    z[~settled] = _by_division(depth, np.flatnonzero(~settled), top)
    moved = np.zeros(surface.shape)
    moved[rows, cols] = z
    return moved


def _pulls(surface: HeightMap, footprint: np.ndarray, free_edges: float, top: float) -> tuple[np.ndarray, np.ndarray]:
    """Return u and its slope along itself on the footprint, on heights from 0 to the top, (heights, x and y, points).

    One height stands for all where the part is drawn to its centroid.
    """
    centre, rows_cols = np.array(centroid_um(footprint, surface))[:, None], np.nonzero(footprint)
    here = np.stack([surface.x_um[rows_cols[1]], surface.y_um[rows_cols[0]]])
    pull, slope = (1 - free_edges) * (centre - here)[None], np.full((1, *here.shape), free_edges - 1)
    if not free_edges:
        return pull, slope
    edges = np.stack([edge_pull_um(surface, z) for z in np.linspace(0, top, _LAYERS + 1)])
    bends = np.gradient(edges[:, 0], surface.dx_um, axis=-1), -np.gradient(edges[:, 1], surface.dy_um, axis=-2)
    bend = np.stack(bends, axis=1)
    return pull + free_edges * edges[..., footprint], slope + free_edges * bend[..., footprint]


def _between(nodes: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Read values (heights, 2, points) straight between even heights, each point at its own share of the highest."""
    if len(nodes) == 1:
        return nodes[0]
    place = np.clip(share, 0, 1) * (len(nodes) - 1)
    lower, points = np.minimum(place.astype(int), len(nodes) - 2), np.arange(nodes.shape[-1])
    low, high = (nodes[k, :, points].T for k in (lower, lower + 1))
    return low + (place - lower) * (high - low)


def _by_secants(depth: Depth, start: np.ndarray, top: float) -> tuple[np.ndarray, np.ndarray]:
    """Return where the depth of every point is 0, as far as secants lead there, and whether they do."""
    todo, z, slope = np.arange(len(start)), start.copy(), -np.ones(len(start))
    at = depth(z, todo)
    for _ in range(_SECANTS):
        last, was = z[todo], at[todo]
        z[todo] = np.clip(last - was / slope, 0, top)
        at[todo] = depth(z[todo], todo)
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = (at[todo] - was) / (z[todo] - last)
        going = (np.abs(at[todo]) > _SETTLED_UM) & (slope < 0)
        todo, slope = todo[going], slope[going]
        if not len(todo):
            break
    return z, np.abs(at) <= _SETTLED_UM


def _by_division(depth: Depth, some: np.ndarray, top: float) -> np.ndarray:
    """Return where the resin of some points ends: the highest part of an interval is kept whose lower end is resin."""
    low, part = np.zeros(len(some)), top / _PARTS
    for _ in range(_DIVISIONS):
        ends = low + part * np.arange(1, _PARTS)[:, None]
        held = depth(ends.ravel(), np.tile(some, _PARTS - 1)).reshape(ends.shape) >= 0
        low = np.max(np.where(held, ends, low), axis=0)
        part /= _PARTS
    return low + part * _PARTS / 2


@dataclass(frozen=True)
class LateralShrinkage(MapEffect):
    """Tops shift towards the centre, bases do not."""

    name = "lateral-shrinkage"
    meaning = "the part shrinks sideways above its adhering base: tops are drawn towards the centre, or in from edges"
    frame = "sample"
    stage = "surface"
    source = "left out explicitly in Lang 2022; law is ours"
    confused_with = ("misregistration",)
    separated_by = "tops against marks on the substrate in one recording, or footprints of several sizes"

    strain: float = declare(0.0, "1", 0.0, 0.3, "lateral shrinkage far above the base", typical=0.02)
    pin_height_um: float = declare(5.0, "µm", 0.5, 50, "height over which the base holds the part back")
    free_edges: float = declare(
        0.0, "1", 0.0, 1.0, "share that gives way at free edges alone; the rest draws to the centre"
    )

    def heights(self, state: HeightMap) -> np.ndarray:
        """Return the deformed surface."""
        return drawn_inwards(state, self.strain, self.pin_height_um, self.free_edges)

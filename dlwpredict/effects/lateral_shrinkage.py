"""Lateral shrinkage: the base adheres to the substrate, the top draws inwards."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from dlwpredict.effects.base import MapEffect
from dlwpredict.effects.plane import centroid_um, nearest, pixel_of, standing
from dlwpredict.heightmap import HeightMap
from dlwpredict.numerics.interpolation import read_locally
from dlwpredict.parameters import declare

_SECANTS = 6
"""Steps that find a smooth surface."""

_PARTS, _DIVISIONS = 4, 13
"""Elsewhere an interval is divided into so many parts, so often: 2⁻²⁶ of it are left."""

_SETTLED_UM = 1e-7
_BESIDE = -1e9

Depth = Callable[[np.ndarray, np.ndarray], np.ndarray]


def drawn_inwards(surface: HeightMap, strain: float, pin_height_um: float) -> np.ndarray:
    """Return the surface of a part whose resin at height z moved to x_c + (x − x_c) · (1 − strain · (1 − e^(−z/H))).

    The new height at x′ is the largest z at which the resin that moved there, from x(x′, z), belongs to the part:
    z ≤ h(x). Secants find it where the surface is smooth. They begin at the higher of the surface here and of that
    where the highest resin would come from, so that a top that has come to lie over lower ground is seen. Elsewhere an
    interval is divided, so that walls may lean as far as they do. x_c is the centroid of the footprint. Law and pinning
    height are ours; Lang et al. 2022 leave lateral shrinkage out.

    Parameters
    ----------
    surface : HeightMap
    strain : float
        Shrinkage far above the base, ≥ 0.
    pin_height_um : float
        H, height over which the base holds the part back.
    """
    footprint = standing(surface)
    if not footprint.any():
        return surface.heights_um
    centre_x, centre_y = centroid_um(footprint, surface)
    rows, cols = np.nonzero(footprint)
    x, y = surface.x_um[cols] - centre_x, surface.y_um[rows] - centre_y
    # heights continue beyond the footprint, so that only the footprint itself ends a wall
    continued = nearest(surface.heights_um, footprint)
    around = ndimage.minimum_filter(continued, 3, mode="nearest"), ndimage.maximum_filter(continued, 3, mode="nearest")
    resin, inside = footprint.astype(float), ndimage.binary_erosion(footprint, np.ones((3, 3)), border_value=1)

    def depth(z: np.ndarray, some: np.ndarray) -> np.ndarray:
        """Return how far z lies below the surface where its resin came from, far above it where that is no part."""
        stretch = 1 / (1 - strain * (1 - np.exp(-z / pin_height_um)))
        place = pixel_of(surface, centre_x + x[some] * stretch, centre_y + y[some] * stretch)
        pixel = tuple(
            np.clip(np.rint(line).astype(int), 0, n - 1) for line, n in zip(place, surface.shape, strict=True)
        )
        # a cubic overshoots at cliffs inside the footprint
        below = np.clip(read_locally(continued, place), *(limit[pixel] for limit in around)) - z
        rim = np.flatnonzero(~inside[pixel])
        part = ndimage.map_coordinates(resin, place[:, rim], order=1, mode="grid-constant")
        below[rim[part < 0.5]] = _BESIDE
        return below

    top, every = 1.2 * surface.heights_um.max(), np.arange(len(x))
    highest = top + depth(np.full(len(x), top), every)
    z, settled = _by_secants(depth, np.maximum(surface.heights_um[footprint], highest), top)
    z[~settled] = _by_division(depth, np.flatnonzero(~settled), top)
    moved = np.zeros(surface.shape)
    moved[rows, cols] = z
    return moved


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
    meaning = "the part shrinks sideways above its adhering base: tops are drawn towards the centre"
    frame = "sample"
    stage = "surface"
    source = "left out explicitly in Lang 2022; law is ours"
    confused_with = ("misregistration",)
    separated_by = "tops against marks on the substrate in one recording, or footprints of several sizes"

    strain: float = declare(0.0, "1", 0.0, 0.3, "lateral shrinkage far above the base", typical=0.02)
    pin_height_um: float = declare(5.0, "µm", 0.5, 50, "height over which the base holds the part back")

    def heights(self, state: HeightMap) -> np.ndarray:
        """Return the deformed surface."""
        return drawn_inwards(state, self.strain, self.pin_height_um)

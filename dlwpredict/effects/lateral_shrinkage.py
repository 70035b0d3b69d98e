"""Lateral shrinkage: the base adheres to the substrate, the top draws inwards."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from dlwpredict.effects.base import MapEffect
from dlwpredict.effects.plane import centroid_um, nearest, pixel_of, standing
from dlwpredict.heightmap import HeightMap
from dlwpredict.numerics.interpolation import read_locally
from dlwpredict.parameters import declare

_HALVINGS, _MORE_HALVINGS = 6, 22
"""The first find out between which walls a column lies; the others follow only where its surface is not smooth."""

_SETTLED_UM = 1e-7
_BESIDE = -1e9


def drawn_inwards(surface: HeightMap, strain: float, pin_height_um: float) -> np.ndarray:
    """Return the surface of a part whose resin at height z moved to x_c + (x − x_c) · (1 − strain · (1 − e^(−z/H))).

    The new height at x′ is the largest z at which the resin that moved there, from x(x′, z), belongs to the part:
    z ≤ h(x). It is found by halving an interval, so that walls may lean as far as they do; where the surface is
    smooth in what is left of it, a secant and one more step find it. x_c is the centroid of the footprint. Law and
    pinning height are ours; Lang et al. 2022 leave lateral shrinkage out.

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

    def depth(z: np.ndarray, some: slice | np.ndarray) -> np.ndarray:
        """Return how far z lies below the surface where its resin came from, far above it where that is no part."""
        stretch = 1 / (1 - strain * (1 - np.exp(-z / pin_height_um)))
        place = pixel_of(surface, centre_x + x[some] * stretch, centre_y + y[some] * stretch)
        pixel = tuple(
            np.clip(np.rint(line).astype(int), 0, n - 1) for line, n in zip(place, surface.shape, strict=True)
        )
        # a cubic overshoots at cliffs inside the footprint
        height = np.clip(read_locally(continued, place), *(limit[pixel] for limit in around))
        part = ndimage.map_coordinates(1.0 * footprint, place, order=1, mode="grid-constant")
        return np.where(part >= 0.5, height - z, _BESIDE)

    def halved(low: np.ndarray, high: np.ndarray, some: slice | np.ndarray, times: int) -> tuple[np.ndarray, ...]:
        """Return narrower intervals around the surface, and the depths at their ends."""
        at_low, at_high = surface.heights_um[footprint][some], np.full(len(low), _BESIDE)
        for _ in range(times):
            middle = (low + high) / 2
            at = depth(middle, some)
            inside = at >= 0
            low, high = np.where(inside, middle, low), np.where(inside, high, middle)
            at_low, at_high = np.where(inside, at, at_low), np.where(inside, at_high, at)
        return low, high, at_low, at_high

    every, top = slice(None), np.full(len(x), 1.2 * surface.heights_um.max())
    low, high, at_low, at_high = halved(np.zeros(len(x)), top, every, _HALVINGS)
    slope = (at_high - at_low) / (high - low)
    z = low - at_low / slope
    z = np.clip(z - depth(z, every) / slope, low, high)
    rough = np.flatnonzero(np.abs(depth(z, every)) > _SETTLED_UM)
    if len(rough):
        low, high, *_ = halved(low[rough], high[rough], rough, _MORE_HALVINGS)
        z[rough] = (low + high) / 2
    moved = np.zeros(surface.shape)
    moved[rows, cols] = z
    return moved


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

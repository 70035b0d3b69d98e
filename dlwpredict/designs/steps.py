"""Plateaus, posts and pads: heights and widths in steps."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from dlwpredict.designs.base import Base, Footprint, design, inside, number, um
from dlwpredict.errors import InputError

FEATURES = np.array([1.0, 0.75, 0.5, 0.25])  # widths of mesas and wells upwards, as parts of the widest


@design("plateaus of rising height with mesas and wells on them", size_um=80.0)
def stairs(
    at: Footprint,
    *,
    base_um: Annotated[float, um(0.0, 500.0, "height of the lowest plateau")] = 4.0,
    height_um: Annotated[float, um(0.0, 500.0, "rise from the lowest to the highest plateau")] = 9.0,
    count: Annotated[int, number(2, 100, "plateaus")] = 4,
    feature_um: Annotated[
        float | None, um(0.0, 1000.0, "width of the widest mesa and well, a tenth of the side unless given; 0 = none")
    ] = None,
    feature_height_um: Annotated[float, um(0.0, 500.0, "height of the mesas, depth of the wells")] = 1.5,
) -> np.ndarray:
    """Strips along y that rise with x, at the defaults 4, 7, 10 and 13 µm.

    Down the middle of each strip stand four square mesas (upper half) and four wells (lower half), from top to bottom
    a quarter, half, three quarters and the whole of ``feature_um`` wide.

    Raises
    ------
    InputError
        A feature is wider than its place, or deeper than the lowest plateau.
    """
    column, row, across, along = at.cells(count, 2 * FEATURES.size)
    plateaus = base_um + height_um * column / (count - 1) + 0 * along
    if feature_um is None:
        feature_um = min(at.width_um, at.depth_um) / 10
    if feature_um == 0:
        return plateaus
    place = min(at.width_um / count, at.depth_um / (2 * FEATURES.size))
    if feature_um > place:
        raise InputError(f"found {feature_um:g}", key="feature_um", allowed=f"at most {place:g} µm here")
    if feature_height_um > base_um:
        raise InputError(
            f"found {feature_height_um:g}", key="feature_height_um", allowed=f"at most base_um = {base_um:g}"
        )
    width = feature_um * np.tile(FEATURES, 2)[row]
    sign = np.where(row >= FEATURES.size, 1.0, -1.0)
    return plateaus + feature_height_um * sign * inside(np.maximum(abs(across), abs(along)), width / 2)


@design("posts: widths grow with x, heights with y", size_um=60.0)
def posts(
    at: Footprint,
    *,
    base_um: Base = 0.0,
    height_um: Annotated[float, um(0.0, 500.0, "height of the tallest posts, top row")] = 10.0,
    count: Annotated[int, number(1, 100, "posts along each side")] = 4,
    width_min_um: Annotated[float, um(0.01, 1000.0, "width of the posts in the left column")] = 2.0,
    width_max_um: Annotated[float, um(0.01, 1000.0, "width of the posts in the right column")] = 8.0,
    square: Annotated[bool, number(0, 1, "square instead of round")] = False,
) -> np.ndarray:
    """``count`` x ``count`` posts, the width in equal steps along x, the height in equal steps of height/count along y.

    Raises
    ------
    InputError
        A post is below one pixel or wider than its cell, or the widths are in the wrong order.
    """
    cell = at.side_um / count
    at.require_resolved("half of width_min_um", 2 * width_min_um)
    if not width_min_um <= width_max_um <= cell:
        raise InputError(
            f"found {width_max_um:g}", key="width_max_um", allowed=f"allowed {width_min_um:g} to {cell:g} µm here"
        )
    column, row, across, along = at.cells(count, count)
    width = width_min_um + (width_max_um - width_min_um) * column / max(count - 1, 1)
    distance = np.maximum(abs(across), abs(along)) if square else np.hypot(across, along)
    return base_um + height_um * (row + 1) / count * inside(distance, width / 2)


@design("grid of square pads at two heights, chequered", size_um=100.0)
def pads(
    at: Footprint,
    *,
    base_um: Base = 0.0,
    height_um: Annotated[float, um(0.0, 500.0, "height of the tall pads, corners included")] = 10.0,
    low_um: Annotated[float, um(0.0, 500.0, "height of the low pads")] = 4.0,
    count: Annotated[int, number(1, 100, "pads along each side")] = 5,
    width_um: Annotated[float, um(0.01, 1000.0, "width of a pad")] = 10.0,
) -> np.ndarray:
    """``count`` x ``count`` equal pads in square cells, tall and low in turn: height against place in the field.

    Raises
    ------
    InputError
        A pad is below one pixel, or wider than its cell.
    """
    cell = at.side_um / count
    at.require_resolved("half of width_um", 2 * width_um)
    if width_um > cell:
        raise InputError(f"found {width_um:g}", key="width_um", allowed=f"at most {cell:g} µm here")
    column, row, across, along = at.cells(count, count)
    height = np.where((column + row) % 2 == 0, height_um, low_um)
    return base_um + height * inside(np.maximum(abs(across), abs(along)), width_um / 2)

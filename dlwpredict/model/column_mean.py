"""The mean of cross-linking over every column, from Chebyshev levels in z on pixels no finer than needed."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import chebyshev

from dlwpredict.model.layers import Columns, Layers, nominal
from dlwpredict.model.states import Crosslinked
from dlwpredict.numerics.parallel import corners, each
from dlwpredict.numerics.smoothing import BLOCK_PX, COARSE_PIXELS_PER_SIGMA, FWHM_PER_SIGMA, block_mean, sparse_means

CONVERSION_LAYER_UM = 0.5
"""Thickness of the layers of local conversion; as with those of dose, it must not depend on any parameter."""

LEVELS_AT_ONCE = 8
"""Levels worked on at once where the dose differs from place to place and from layer to layer."""

STRIP_PX = 16
"""Coarse rows worked on at once: their modes then stay in the cache."""

_NEAR = 1e-7
"""Weights of an interpolation that count: a height's error stays far below a nanometre."""


def column_mean(crosslinked: Crosslinked, reference: str, threads: int) -> np.ndarray:
    """Average normalised cross-linking over 0 … e(x, y).

    m_cl at Chebyshev levels ζ_j is G_xy ⊛ [Φ(ζ_j/s_z) − Φ((ζ_j − e)/s_z)], on pixels no finer than needed; its
    running mean M(ζ) = (1/ζ) ∫₀^ζ u dz is smooth in all three coordinates and is evaluated at ζ = e(x, y).
    """
    surface = crosslinked.exposed.surface
    top = float(surface.heights_um.max())
    if top == 0:
        return np.zeros(surface.shape)
    levels = _chebyshev_levels(top, crosslinked.fwhm_z_um / FWHM_PER_SIGMA)
    values, rows, cols = _crosslink_stack(crosslinked, levels, threads)
    if reference == "structure_maximum":
        values = values / _largest(np.tensordot(_to_modes(len(levels)), values, axes=1))
    for curve in crosslinked.curves:
        values = curve(np.clip(values, 0, 1))
    mean = _significant(np.tensordot(_to_modes(len(levels)) @ _running_mean(len(levels)), values, axes=1))
    place, found = 2 * surface.heights_um / top - 1, np.empty(surface.shape)

    def read_off(corner: tuple[int, int]) -> None:
        tile = tuple(slice(start, start + BLOCK_PX) for start in corner)
        up_y, up_x = rows[tile[0]], cols[tile[1]]
        near_y, near_x = _near(up_y), _near(up_x)
        modes = up_y[:, near_y] @ mean[:, near_y, near_x] @ up_x[:, near_x].T
        found[tile] = chebyshev.chebval(place[tile], modes, tensor=False)

    each(read_off, corners(surface.shape, BLOCK_PX), threads)
    return found


def _near(up: np.ndarray) -> slice:
    """Return the points that count in an interpolation (pixels, points)."""
    used = np.flatnonzero(np.abs(up).max(axis=0) > _NEAR)
    return slice(used[0], used[-1] + 1)


def coarse_factor(fwhm_xy_um: float, pitch_um: float) -> int:
    """Return how many pixels along one axis are taken together for cross-linking."""
    return max(int(fwhm_xy_um / FWHM_PER_SIGMA / COARSE_PIXELS_PER_SIGMA / pitch_um), 1)


def _chebyshev_levels(top_um: float, sigma_um: float) -> np.ndarray:
    """Return Chebyshev nodes on 0 … top, enough for the profile of a Gaussian edge of this width to about 1e-5."""
    count = 8 + int(np.ceil(2.5 * top_um / sigma_um))
    return top_um * (chebyshev.chebpts1(count) + 1) / 2


def _crosslink_stack(
    crosslinked: Crosslinked, levels: np.ndarray, threads: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return m_cl (level, coarse rows, coarse cols) and the matrices that interpolate rows and columns back."""
    surface = crosslinked.exposed.surface
    sigma_um = crosslinked.fwhm_xy_um / FWHM_PER_SIGMA
    pitches = (surface.dy_um, surface.dx_um)
    factors = [coarse_factor(crosslinked.fwhm_xy_um, pitch) for pitch in pitches]
    # averaging over m pixels already widens by (m² − 1)/12 pixels²
    sigmas = [np.sqrt(max((sigma_um / p) ** 2 - (m**2 - 1) / 12, 0)) / m for p, m in zip(pitches, factors, strict=True)]
    whole = [(0, -n % m) for n, m in zip(surface.shape, factors, strict=True)]
    heights = np.pad(surface.heights_um, whole)
    source = _source(crosslinked, heights, whole, factors, levels, threads)
    (down_y, up_y), (down_x, up_x) = (
        sparse_means(n // m, float(s), m) for n, m, s in zip(heights.shape, factors, sigmas, strict=True)
    )
    return (
        down_y.astype(source.dtype) @ source @ down_x.astype(source.dtype).T,
        up_y[: surface.shape[0]],
        up_x[: surface.shape[1]],
    )


def _source(
    crosslinked: Crosslinked,
    heights: np.ndarray,
    padding: list[tuple[int, int]],
    factors: list[int],
    levels: np.ndarray,
    threads: int,
) -> np.ndarray:
    """Return the axial convolution of the exposed resin, weighted by conversion: (level, coarse rows, coarse cols)."""
    sigmas = np.full(len(levels), crosslinked.fwhm_z_um / FWHM_PER_SIGMA)
    layers = nominal(CONVERSION_LAYER_UM)
    if crosslinked.converts:
        layers = Layers.of(crosslinked.source_weight, float(heights.max()), CONVERSION_LAYER_UM, threads)
        layers = layers.padded(padding)
    if layers.factors:
        plane, along = layers.factors
        profile = Columns(along, levels[None], from_glass=False).convolved(levels, sigmas)[:, 0]
        return _by_height(profile, np.broadcast_to(plane, heights.shape), heights, factors, threads)
    columns = Columns(layers, heights, from_glass=False, reduce=lambda planes: block_mean(planes, factors))
    some = [slice(i, i + LEVELS_AT_ONCE) for i in range(0, len(levels), LEVELS_AT_ONCE)]
    return np.concatenate(each(lambda s: columns.convolved(levels[s], sigmas[s]), some, threads))


def _by_height(
    profile: np.ndarray, weight: np.ndarray, heights: np.ndarray, factors: list[int], threads: int
) -> np.ndarray:
    """Return the block means of w(x, y) · f_ζ(h) at all levels ζ, given f (levels ζ, heights h) at Chebyshev nodes.

    f is as smooth in h as in ζ: the block means of the Chebyshev polynomials of h hold all levels at once.
    """
    top = float(heights.max())
    weights = (profile @ _to_modes(len(profile)).T).astype(np.float32)

    def means(first: int) -> np.ndarray:
        x = (2 * heights[first : first + rows] / top - 1).astype(np.float32)
        at = weight[first : first + rows].astype(np.float32)
        before, found = x * at, []
        for _ in profile:
            found.append(block_mean(at, factors))
            before, at = at, 2 * x * at - before
        return np.tensordot(weights, np.stack(found), axes=1)

    rows = STRIP_PX * factors[0]
    return np.concatenate(each(means, range(0, len(heights), rows), threads), axis=1)


def _to_modes(count: int) -> np.ndarray:
    """Return the matrix from values at the Chebyshev nodes of the first kind to Chebyshev coefficients."""
    return np.linalg.inv(chebyshev.chebvander(chebyshev.chebpts1(count), count - 1))


def _running_mean(count: int) -> np.ndarray:
    """Return the matrix from values f(ζ) to (1/ζ) ∫₀^ζ f dz, both at the Chebyshev nodes ζ of 0 … top."""
    nodes = chebyshev.chebpts1(count)
    integral = chebyshev.chebint(np.eye(count), lbnd=-1, axis=0)
    return chebyshev.chebvander(nodes, count) @ integral / (nodes + 1)[:, None] @ _to_modes(count)


def _significant(modes: np.ndarray) -> np.ndarray:
    """Drop the highest modes that together stay below 1e-6 of the largest: in a small part all of them are small."""
    sizes = np.abs(modes).max(axis=(1, 2))
    tail = np.cumsum(sizes[::-1])[::-1]
    return modes[: max(int(np.sum(tail > 1e-6 * sizes.max())), 2)]


def _largest(modes: np.ndarray) -> float:
    """Return the largest value of a stack of Chebyshev modes (mode, rows, cols), between its nodes and pixels too."""
    grid = chebyshev.chebvander(np.linspace(-1, 1, 4 * len(modes) + 1), len(modes) - 1)
    values = np.tensordot(grid, modes, axes=1).max(axis=0)
    row, col = np.clip(np.unravel_index(np.argmax(values), values.shape), 1, np.array(values.shape) - 2)
    dense = chebyshev.chebvander(np.linspace(-1, 1, 1001), len(modes) - 1)
    around = np.tensordot(dense, modes[:, row - 1 : row + 2, col - 1 : col + 2], axes=1).max(axis=0)
    return float(around[1, 1] + sum(_peak_above(line) for line in (around[1], around[:, 1])))


def _peak_above(line: np.ndarray) -> float:
    """Return how far the parabola through three points rises above the middle one."""
    slope, bend = (line[2] - line[0]) / 2, line[0] - 2 * line[1] + line[2]
    return -(slope**2) / (2 * bend) if bend < 0 and abs(slope) <= -bend else 0.0

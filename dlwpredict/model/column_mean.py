"""The mean of cross-linking over every column, from Chebyshev levels in z on pixels no finer than needed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial import chebyshev

from dlwpredict.model.layers import Columns, Layers, nominal
from dlwpredict.model.states import Crosslinked
from dlwpredict.numerics.parallel import each
from dlwpredict.numerics.smoothing import (
    BLOCK_PX,
    COARSE_PIXELS_PER_SIGMA,
    FWHM_PER_SIGMA,
    banded,
    block_mean,
    sparse_means,
)

CONVERSION_LAYER_UM = 0.5
"""Thickness of the layers of local conversion; as with those of dose, it must not depend on any parameter."""

LEVELS_AT_ONCE = 8
"""Levels worked on at once where the dose differs from place to place and from layer to layer."""

STRIP_PX = 16
"""Coarse rows worked on at once: their modes then stay in the cache."""


def column_mean(crosslinked: Crosslinked, reference: str, threads: int) -> np.ndarray:
    """Average normalised cross-linking over 0 … e(x, y).

    m_cl at Chebyshev levels ζ_j is G_xy ⊛ [Φ(ζ_j/s_z) − Φ((ζ_j − e)/s_z)], on pixels no finer than needed; its
    running mean M(ζ) = (1/ζ) ∫₀^ζ u dz is smooth in all three coordinates and is evaluated at ζ = e(x, y). Planes are
    kept as (rows, levels, cols), so that each product along an axis is one of matrices; in single precision, whose
    1e-6 of the mean is a hundredth of a nanometre.
    """
    surface = crosslinked.exposed.surface
    top = float(surface.heights_um.max())
    if top == 0:
        return np.zeros(surface.shape)
    levels = _chebyshev_levels(top, crosslinked.fwhm_z_um / FWHM_PER_SIGMA)
    values, rows, cols = _crosslink_stack(crosslinked, levels, threads)
    if reference == "structure_maximum":
        values /= _largest(values)
    for curve in crosslinked.curves:
        values = curve(np.clip(values, 0, 1)).astype(np.float32)
    modes = _significant((_to_modes(len(levels)) @ _running_mean(len(levels))).astype(np.float32) @ values)
    place, mean = (2 * surface.heights_um / top - 1).astype(np.float32), np.empty(surface.shape)

    def read_off(first: int) -> None:
        block = slice(first, first + BLOCK_PX)
        along_rows = banded(rows[block], modes)
        for start in range(0, len(cols), BLOCK_PX):
            tile = block, slice(start, start + BLOCK_PX)
            mean[tile] = _chebyshev_sum(banded(cols[tile[1]], along_rows, axis=-1), place[tile])

    each(read_off, range(0, len(rows), BLOCK_PX), threads)
    return mean


def _chebyshev_sum(modes: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return Σ c_k T_k(x) by Clenshaw's recurrence, coefficients (rows, modes, cols) at places (rows, cols)."""
    after, last = modes[:, -1], modes[:, -2]
    twice = 2 * x
    for k in range(modes.shape[1] - 3, -1, -1):
        last, after = modes[:, k] - after, last + after * twice
    return last + after * x


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
    """Return m_cl (points along y, levels, points along x) and the matrices that interpolate rows and columns back."""
    surface = crosslinked.exposed.surface
    sigma_um = crosslinked.fwhm_xy_um / FWHM_PER_SIGMA
    pitches = (surface.dy_um, surface.dx_um)
    factors = [coarse_factor(crosslinked.fwhm_xy_um, pitch) for pitch in pitches]
    # averaging over m pixels already widens by (m² − 1)/12 pixels²
    sigmas = [np.sqrt(max((sigma_um / p) ** 2 - (m**2 - 1) / 12, 0)) / m for p, m in zip(pitches, factors, strict=True)]
    whole = [(0, -n % m) for n, m in zip(surface.shape, factors, strict=True)]
    heights = np.pad(surface.heights_um, whole)
    (down_y, up_y), (down_x, up_x) = (
        [matrix.astype(np.float32) for matrix in sparse_means(n // m, float(s), m)]
        for n, m, s in zip(heights.shape, factors, sigmas, strict=True)
    )
    source = _Source(heights, factors, down_x, threads)
    spread = banded(down_y, _exposed_resin(crosslinked, source, whole, levels))
    return spread, up_y[: surface.shape[0]], up_x[: surface.shape[1]]


@dataclass(frozen=True, eq=False)
class _Source:
    """The exposed resin of every column, on coarse pixels along y and on the points of the means along x.

    Parameters
    ----------
    heights_um : numpy.ndarray, shape (rows, cols)
    factors : list of int
        Pixels taken together along y and x.
    down_x : numpy.ndarray, shape (points, coarse cols)
        Gaussian means along x.
    threads : int
    """

    heights_um: np.ndarray
    factors: list[int]
    down_x: np.ndarray
    threads: int

    def reduced(self, planes: np.ndarray) -> np.ndarray:
        """Return planes (levels, rows, cols) as means (coarse rows, levels, points along x)."""
        return banded(self.down_x, block_mean(planes, self.factors), axis=-1).swapaxes(0, 1)

    def of_columns(self, columns: Columns, levels: np.ndarray, sigmas: np.ndarray) -> np.ndarray:
        """Return the axial convolution of weighted columns at all levels, (coarse rows, levels, points along x)."""
        some = [slice(i, i + LEVELS_AT_ONCE) for i in range(0, len(levels), LEVELS_AT_ONCE)]
        planes = each(lambda s: columns.convolved(levels[s], sigmas[s]), some, self.threads)
        return np.concatenate([banded(self.down_x, part, axis=-1).swapaxes(0, 1) for part in planes], axis=1)

    def by_height(self, profile: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Return the means of w(x, y) · f_ζ(h) at all levels ζ, given f (levels ζ, heights h) at Chebyshev nodes.

        f is as smooth in h as in ζ: the means of the Chebyshev polynomials of h hold all levels at once.
        """
        heights, top = self.heights_um, float(self.heights_um.max())
        weights = (profile @ _to_modes(len(profile)).T).astype(np.float32)
        rows = STRIP_PX * self.factors[0]

        def means(first: int) -> np.ndarray:
            x = (2 * heights[first : first + rows] / top - 1).astype(np.float32)
            planes = np.empty((len(profile), *x.shape), np.float32)
            planes[0] = weight[first : first + rows]
            np.multiply(x, planes[0], out=planes[1])
            x *= 2
            for k in range(2, len(planes)):
                np.multiply(x, planes[k - 1], out=planes[k])
                planes[k] -= planes[k - 2]
            return weights @ self.reduced(planes)

        return np.concatenate(each(means, range(0, len(heights), rows), self.threads))


def _exposed_resin(
    crosslinked: Crosslinked, source: _Source, padding: list[tuple[int, int]], levels: np.ndarray
) -> np.ndarray:
    """Return the axial convolution of the exposed resin, weighted by conversion, as `_Source` does."""
    heights, sigmas = source.heights_um, np.full(len(levels), crosslinked.fwhm_z_um / FWHM_PER_SIGMA)
    layers = nominal(CONVERSION_LAYER_UM)
    if crosslinked.converts:
        layers = Layers.of(crosslinked.source_weight, float(heights.max()), CONVERSION_LAYER_UM, source.threads)
        layers = layers.padded(padding)
    if layers.factors:
        plane, along = layers.factors
        profile = Columns(along, levels[None], from_glass=False).convolved(levels, sigmas)[:, 0]
        return source.by_height(profile, np.broadcast_to(plane, heights.shape))
    columns = Columns(layers, heights, from_glass=False, reduce=lambda planes: block_mean(planes, source.factors))
    return source.of_columns(columns, levels, sigmas)


@cache
def _to_modes(count: int) -> np.ndarray:
    """Return the matrix from values at the Chebyshev nodes of the first kind to Chebyshev coefficients."""
    return np.linalg.inv(chebyshev.chebvander(chebyshev.chebpts1(count), count - 1))


@cache
def _between(count: int, points: int) -> np.ndarray:
    """Return the matrix from values at the Chebyshev nodes to values at evenly spaced places."""
    return chebyshev.chebvander(np.linspace(-1, 1, points), count - 1) @ _to_modes(count)


@cache
def _running_mean(count: int) -> np.ndarray:
    """Return the matrix from values f(ζ) to (1/ζ) ∫₀^ζ f dz, both at the Chebyshev nodes ζ of 0 … top."""
    nodes = chebyshev.chebpts1(count)
    integral = chebyshev.chebint(np.eye(count), lbnd=-1, axis=0)
    return chebyshev.chebvander(nodes, count) @ integral / (nodes + 1)[:, None] @ _to_modes(count)


def _significant(modes: np.ndarray) -> np.ndarray:
    """Drop the highest modes that together stay below 1e-6 of the largest: in a small part all of them are small."""
    sizes = np.abs(modes).max(axis=(0, 2))
    tail = np.cumsum(sizes[::-1])[::-1]
    return modes[:, : max(int(np.sum(tail > 1e-6 * sizes.max())), 2)]


def _largest(values: np.ndarray) -> float:
    """Return the largest value of levels (points, levels, points), between its nodes and points too."""
    count = values.shape[1]
    highest = (_between(count, 4 * count + 1).astype(np.float32) @ values).max(axis=1)
    row, col = np.clip(np.unravel_index(np.argmax(highest), highest.shape), 1, np.array(highest.shape) - 2)
    around = (_between(count, 1001) @ values[row - 1 : row + 2, :, col - 1 : col + 2]).max(axis=1)
    return float(around[1, 1] + sum(_peak_above(line) for line in (around[1], around[:, 1])))


def _peak_above(line: np.ndarray) -> float:
    """Return how far the parabola through three points rises above the middle one."""
    slope, bend = (line[2] - line[0]) / 2, line[0] - 2 * line[1] + line[2]
    return -(slope**2) / (2 * bend) if bend < 0 and abs(slope) <= -bend else 0.0

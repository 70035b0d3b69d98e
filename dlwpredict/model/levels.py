"""Fast numerics: a few smooth levels in z, convolutions in (x, y) only, no voxels.

The solid under a height map h is one interval per column, so its axial convolution is closed: Φ((h − z)/s_z). What
remains at each level z is two-dimensional. Exposure falls monotonically with z, so the exposed resin is a height
map e(x, y) again, and the same holds for cross-linking. This is the limit that voxels reach as their slice goes to 0.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.polynomial import chebyshev
from scipy.interpolate import make_interp_spline
from scipy.special import ndtr, ndtri

from dlwpredict.heightmap import HeightMap
from dlwpredict.model.states import Crosslinked, Dose, Exposed, Focus
from dlwpredict.smoothing import FWHM_PER_SIGMA, REACH_SIGMAS, blur

LEVEL_STEP_SIGMAS = 0.6
"""Distance of exposure levels in axial standard deviations; the surface then errs by about 1 nm."""

COARSE_PIXELS_PER_SIGMA = 5.0
"""Cross-linking is computed on pixels this fine against its lateral standard deviation."""

TILE_PX = 192
_TINY = 1e-12


@dataclass(frozen=True)
class Levels:
    """The fast numerics.

    Parameters
    ----------
    threads : int
        Tiles computed at once.
    """

    threads: int = 2

    def exposed(self, dose: Dose, threshold: float, reference: str) -> Exposed:
        """Solve exposure = threshold for the height of every column.

        Per tile: levels z_k that span the tile's heights, E_k = Σ weight · G_xy ⊛ Φ((h − z_k)/s_z), then the root of
        ndtri(E) − ndtri(P') between levels, by a cubic. P' is the threshold over the local relative dose.
        """
        written = dose.written
        heights = written.heights_um
        if reference == "structure_maximum":
            threshold = threshold * float(_exposure(dose.focus, heights, 0.0, written).max())
        tile = max(written.shape) if dose.intensity or dose.threshold_factor else TILE_PX
        reach = [_reach_px(dose.focus, pitch) for pitch in (written.dy_um, written.dx_um)]
        surface = np.zeros(written.shape)

        def solve(corner: tuple[int, int]) -> None:
            inner = tuple(slice(start, start + tile) for start in corner)
            outer = tuple(slice(max(start - r, 0), start + tile + r) for start, r in zip(corner, reach, strict=True))
            part = heights[outer]
            if part.any():
                found = _surface_of_tile(dose, part, threshold)
                offset = [s.start - o.start for s, o in zip(inner, outer, strict=True)]
                rows, cols = surface[inner].shape
                surface[inner] = found[offset[0] : offset[0] + rows, offset[1] : offset[1] + cols]

        corners = [(r, c) for r in range(0, written.shape[0], tile) for c in range(0, written.shape[1], tile)]
        with ThreadPoolExecutor(self.threads) as pool:
            list(pool.map(solve, corners))
        return Exposed(written.with_heights(surface), dose)

    def column_mean(self, crosslinked: Crosslinked, reference: str) -> np.ndarray:
        """Average normalised cross-linking over 0 … e(x, y).

        m_cl at Chebyshev levels ζ_j is G_xy ⊛ [Φ(ζ_j/s_z) − Φ((ζ_j − e)/s_z)], on pixels no finer than needed; its
        running mean M(ζ) = (1/ζ) ∫₀^ζ u dz is smooth in all three coordinates and is evaluated at ζ = e(x, y).
        """
        surface = crosslinked.exposed.surface
        top = float(surface.heights_um.max())
        if top == 0:
            return np.zeros(surface.shape)
        levels = _chebyshev_levels(top, crosslinked.fwhm_z_um / FWHM_PER_SIGMA)
        values, rows, cols = _crosslink_stack(crosslinked, levels, self.threads)
        if reference == "structure_maximum":
            values = values / _largest(np.tensordot(_to_modes(len(levels)), values, axes=1))
        for curve in crosslinked.curves:
            values = curve(np.clip(values, 0, 1))
        mean = _significant(np.tensordot(_to_modes(len(levels)) @ _running_mean(len(levels)), values, axes=1))
        return chebyshev.chebval(2 * surface.heights_um / top - 1, rows @ mean @ cols.T, tensor=False)


def _reach_px(focus: tuple[Focus, ...], pitch_um: float) -> int:
    widest = max(max(part.fwhm_x_um, part.fwhm_y_um) for part in focus)
    return int(np.ceil(REACH_SIGMAS * widest / FWHM_PER_SIGMA / pitch_um)) + 1


def _exposure(focus: tuple[Focus, ...], heights: np.ndarray, z_um: float, grid: HeightMap) -> np.ndarray:
    """Return the nominal exposure at one level, 1 inside a large block; nothing is written where h = 0."""
    written = heights > 0
    return sum(
        part.weight
        * part.spread(np.where(written, ndtr((heights - z_um) / part.sigma_z_um(z_um)), 0.0), grid.dx_um, grid.dy_um)
        for part in focus
    )


def _surface_of_tile(dose: Dose, heights: np.ndarray, threshold: float) -> np.ndarray:
    """Return the exposed height over one tile (rows, cols), from four successive levels around each crossing."""
    levels = _levels_around(dose, heights, threshold)
    surface = np.zeros(heights.shape)
    exposures: list[np.ndarray] = []
    wanted: list[np.ndarray] = []
    for k, z in enumerate(levels):
        exposures = [*exposures[-3:], _exposure(dose.focus, heights, z, dose.written)]
        wanted = [*wanted[-3:], np.asarray(threshold * dose.relative_threshold(max(z, 0.0)))]
        if k < 3:
            continue
        crossing = (exposures[1] >= wanted[1]) & (exposures[2] < wanted[2])
        if crossing.any():
            inside = _cubic_root(*(_margin(e, w, crossing) for e, w in zip(exposures, wanted, strict=True)))
            surface[crossing] = levels[k - 2] + inside * (levels[1] - levels[0])
    return np.maximum(surface, 0.0)


def _levels_around(dose: Dose, heights: np.ndarray, threshold: float) -> np.ndarray:
    """Return levels that enclose every crossing: exposure is level 4 s_z below the lowest written height."""
    finest = min(part.sigma_z_um(0.0) for part in dose.focus)
    widest = max(part.sigma_z_um(heights.max()) for part in dose.focus)
    step = LEVEL_STEP_SIGMAS * finest
    varying = bool(dose.intensity or dose.threshold_factor)
    above = 5 * widest if varying else max(-ndtri(threshold) * widest, 0.0)
    low = max(heights[heights > 0].min() - 4 * widest, 0.0)
    return low + step * np.arange(-1, np.ceil((heights.max() + above - low) / step) + 3)


def _margin(exposure: np.ndarray, wanted: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Return ndtri(E) − ndtri(P') at the given points; nearly a straight line in z, and 0 at the surface."""
    wanted = wanted[where] if wanted.ndim else wanted
    return ndtri(np.clip(exposure[where], _TINY, 1 - 1e-9)) - ndtri(np.clip(wanted, _TINY, 1 - 1e-9))


def _cubic_root(before: np.ndarray, left: np.ndarray, right: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the root in 0 … 1 of the cubic through values at −1, 0, 1, 2, where left ≥ 0 > right."""
    c = -before / 3 - left / 2 + right - after / 6
    b = before / 2 - left + right / 2
    a = -before / 6 + left / 2 - right / 2 + after / 6
    t = left / (left - right)
    for _ in range(4):
        slope = (3 * a * t + 2 * b) * t + c
        t = np.clip(t - (((a * t + b) * t + c) * t + left) / np.where(slope < 0, slope, right - left), 0, 1)
    return t


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
    sigma_z = crosslinked.fwhm_z_um / FWHM_PER_SIGMA
    pitches = (surface.dy_um, surface.dx_um)
    factors = [max(int(sigma_um / COARSE_PIXELS_PER_SIGMA / pitch), 1) for pitch in pitches]
    # averaging over m pixels already widens by (m² − 1)/12 pixels²
    sigmas = [np.sqrt(max((sigma_um / p) ** 2 - (m**2 - 1) / 12, 0)) / m for p, m in zip(pitches, factors, strict=True)]
    reach = [int(np.ceil(2 * REACH_SIGMAS * s / 5)) + 2 for s in sigmas]
    padding = [(m * r, m * r + (-n) % m) for n, m, r in zip(surface.shape, factors, reach, strict=True)]
    heights = np.pad(surface.heights_um, padding)
    source = _source(crosslinked.exposed.dose, heights, padding, sigma_z)
    with ThreadPoolExecutor(threads) as pool:
        stack = np.stack(list(pool.map(lambda z: blur(_block_mean(source(z), factors), *sigmas), levels)))
    matrices = [
        _interpolation((np.arange(n) + before + 0.5) / m - 0.5, size)
        for n, (before, _), m, size in zip(surface.shape, padding, factors, stack.shape[1:], strict=True)
    ]
    return stack, *matrices


def _source(dose: Dose, heights: np.ndarray, padding: list[tuple[int, int]], sigma_z: float):
    """Return the function of ζ: axial convolution of the exposed resin, weighted by its conversion, at level ζ."""
    if not (dose.conversion and dose.intensity):
        return lambda z: ndtr(z / sigma_z) - ndtr((z - heights) / sigma_z)
    count = max(int(np.ceil(heights.max() / (0.35 * sigma_z))), 4)
    edges = np.linspace(0, heights.max(), count + 1)
    tops = [np.minimum(heights, edge) for edge in edges]
    weights = [
        np.pad(np.broadcast_to(dose.source_weight((a + b) / 2), dose.written.shape), padding, mode="edge")
        for a, b in pairwise(edges)
    ]

    def at(z: float) -> np.ndarray:
        steps = [ndtr((z - top) / sigma_z) for top in tops]
        return sum(w * (below - above) for w, (below, above) in zip(weights, pairwise(steps), strict=True))

    return at


def _block_mean(plane: np.ndarray, factors: list[int]) -> np.ndarray:
    rows, cols = (n // m for n, m in zip(plane.shape, factors, strict=True))
    return plane.reshape(rows, factors[0], cols, factors[1]).mean(axis=(1, 3))


def _interpolation(positions: np.ndarray, size: int) -> np.ndarray:
    """Return the matrix (positions, size) of cubic-spline interpolation from nodes 0 … size − 1."""
    return make_interp_spline(np.arange(size), np.eye(size), k=3)(positions)


def _to_modes(count: int) -> np.ndarray:
    """Return the matrix from values at the Chebyshev nodes of the first kind to Chebyshev coefficients."""
    return np.linalg.inv(chebyshev.chebvander(chebyshev.chebpts1(count), count - 1))


def _running_mean(count: int) -> np.ndarray:
    """Return the matrix from values f(ζ) to (1/ζ) ∫₀^ζ f dz, both at the Chebyshev nodes ζ of 0 … top."""
    nodes = chebyshev.chebpts1(count)
    integral = chebyshev.chebint(np.eye(count), lbnd=-1, axis=0)
    return chebyshev.chebvander(nodes, count) @ integral / (nodes + 1)[:, None] @ _to_modes(count)


def _significant(modes: np.ndarray) -> np.ndarray:
    """Drop the highest modes that together stay below 1e-6."""
    tail = np.cumsum(np.abs(modes).max(axis=(1, 2))[::-1])[::-1]
    return modes[: max(int(np.sum(tail > 1e-6)), 2)]


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

"""Fast numerics: a few smooth levels in z, convolutions in (x, y) only, no voxels.

The solid under a height map h is one interval per column, so its axial convolution is closed: Φ((h − z)/s_z). What
remains at each level z is two-dimensional. Exposure falls monotonically with z, so the exposed resin is a height
map e(x, y) again, and the same holds for cross-linking. This is the limit that voxels reach as their slice goes to 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from scipy.special import ndtr, ndtri

from dlwpredict.model.layers import Columns, Layers
from dlwpredict.model.states import Crosslinked, Dose, Exposed, Focus
from dlwpredict.parallel import each
from dlwpredict.smoothing import COARSE_PIXELS_PER_SIGMA, FWHM_PER_SIGMA, block_mean, sparse_means

LEVEL_STEP_SIGMAS = 0.4
"""Distance of exposure levels in axial standard deviations; the surface then errs by about 1 nm."""

DOSE_LAYER_UM, CONVERSION_LAYER_UM = 0.2, 0.5
"""Thickness of the layers of local dose and of local conversion. It must not depend on any parameter: where the outline
of a layer is hard, moving layers would make the prediction jump by nanometres under a fit."""

ABOVE_SIGMAS = 2.5
"""Levels end this many axial standard deviations above the part where the local dose can lift its surface."""

LARGEST_FRACTION = 0.95
"""Largest threshold as a fraction of the local dose at which ndtri still sees a straight line."""

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
        ndtri(E/D) − ndtri(P/D) between levels, by a cubic. Where the dose differs from layer to layer, Φ becomes the
        sum over the layers, and D is the largest dose of the column.
        """
        written = dose.written
        heights = written.heights_um
        if reference == "structure_maximum":
            nominal = _Exposure(dose.focus, heights, written.dx_um, written.dy_um)
            threshold = threshold * float(nominal.at(0.0).max())
        step = LEVEL_STEP_SIGMAS * min(part.sigma_z_um(0.0) for part in dose.focus)
        layers, thresholds = _local(dose, step, self.threads)
        reach = [_reach_px(dose.focus, pitch) for pitch in (written.dy_um, written.dx_um)]
        surface = np.zeros(written.shape)

        def solve(corner: tuple[int, int]) -> None:
            inner = tuple(slice(start, start + TILE_PX) for start in corner)
            outer = tuple(slice(max(start - r, 0), start + TILE_PX + r) for start, r in zip(corner, reach, strict=True))
            part = heights[outer]
            if part.any():
                columns = None if layers is None else Columns(layers[outer], part, from_glass=True)
                exposure = _Exposure(dose.focus, part, written.dx_um, written.dy_um, columns)
                local = threshold if thresholds is None else threshold * thresholds[outer].weights
                found = _surface_of_tile(exposure, local, step)
                offset = [s.start - o.start for s, o in zip(inner, outer, strict=True)]
                rows, cols = surface[inner].shape
                surface[inner] = found[offset[0] : offset[0] + rows, offset[1] : offset[1] + cols]

        corners = [(r, c) for r in range(0, written.shape[0], TILE_PX) for c in range(0, written.shape[1], TILE_PX)]
        each(solve, corners, self.threads)
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
    return int(np.ceil(max(part.reach_um for part in focus) / pitch_um)) + 1


def _local(dose: Dose, step: float, threads: int) -> tuple[Layers | None, Layers | None]:
    """Return the relative dose and the relative threshold on layers, None where they are 1 throughout."""
    top = float(dose.written.heights_um.max())
    room = ABOVE_SIGMAS * max(part.sigma_z_um(top) for part in dose.focus) + 3 * step
    return (
        Layers.of(dose.relative_dose, top, DOSE_LAYER_UM, threads) if dose.intensity else None,
        Layers.of(dose.relative_threshold, top + room, DOSE_LAYER_UM, threads).every(step)
        if dose.threshold_factor
        else None,
    )


@dataclass(frozen=True, eq=False)
class _Exposure:
    """The exposure of a height map (rows, cols): 1 inside a large block at nominal dose, 0 where nothing is written."""

    focus: tuple[Focus, ...]
    heights_um: np.ndarray
    dx_um: float
    dy_um: float
    columns: Columns | None = None

    def at(self, z_um: float) -> np.ndarray:
        """Return the exposure at one level."""

        def axial(sigma_um: float) -> np.ndarray:
            if self.columns is not None:
                return self.columns.convolved(z_um, sigma_um)
            return np.where(self.heights_um > 0, ndtr((self.heights_um - z_um) / sigma_um), 0.0)

        return self._spread(lambda part: axial(part.sigma_z_um(z_um)))

    def highest_dose(self) -> np.ndarray | float:
        """Return the largest relative dose of each column as the focus sees it: exposure stays below it."""
        if self.columns is None:
            return 1.0
        written = (self.heights_um > 0).astype(float)
        nominal = np.maximum(self._spread(lambda part: written), _TINY)
        return np.maximum(self._spread(lambda part: self.columns.highest) / nominal, _TINY)

    def _spread(self, plane_of: Callable[[Focus], np.ndarray]) -> np.ndarray:
        return sum(part.weight * part.spread(plane_of(part), self.dx_um, self.dy_um) for part in self.focus)


def _surface_of_tile(exposure: _Exposure, threshold: np.ndarray | float, step: float) -> np.ndarray:
    """Return the exposed height over one tile (rows, cols), from four successive levels around each crossing.

    The threshold is one number, or a stack over the levels j · step, j ≥ 0.
    """
    first, last = _levels_around(exposure, np.min(threshold), step)
    dose = np.maximum(exposure.highest_dose(), np.max(threshold) / LARGEST_FRACTION)
    surface = np.zeros(exposure.heights_um.shape)
    exposures: list[np.ndarray] = []
    wanted: list[np.ndarray] = []
    for k in range(first, last):
        local = threshold[np.clip(k, 0, len(threshold) - 1)] if np.ndim(threshold) else threshold
        exposures = [*exposures[-3:], exposure.at(k * step) / dose]
        wanted = [*wanted[-3:], np.asarray(local / dose)]
        if k < first + 3:
            continue
        crossing = (exposures[1] >= wanted[1]) & (exposures[2] < wanted[2])
        if crossing.any():
            inside = _cubic_root(*(_margin(e, w, crossing) for e, w in zip(exposures, wanted, strict=True)))
            surface[crossing] = (k - 2 + inside) * step
    return np.maximum(surface, 0.0)


def _levels_around(exposure: _Exposure, threshold: float, step: float) -> tuple[int, int]:
    """Return the range of levels that encloses every crossing: exposure is level 4 s_z below the lowest height.

    All tiles share one grid of levels, with and without effects, so that neither leaves a trace in the result.
    """
    heights = exposure.heights_um
    widest = max(part.sigma_z_um(heights.max()) for part in exposure.focus)
    above = ABOVE_SIGMAS * widest if exposure.columns is not None else max(-ndtri(threshold) * widest, 0.0)
    low = max(heights[heights > 0].min() - 4 * widest, 0.0)
    return int(low / step) - 1, int(np.ceil((heights.max() + above) / step)) + 3


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
    source = _source(crosslinked, heights, whole, factors, threads)
    (down_y, up_y), (down_x, up_x) = (
        sparse_means(n // m, float(s), m) for n, m, s in zip(heights.shape, factors, sigmas, strict=True)
    )
    stack = np.stack(each(lambda z: down_y @ source(z) @ down_x.T, levels, threads))
    return stack, up_y[: surface.shape[0]], up_x[: surface.shape[1]]


def _source(
    crosslinked: Crosslinked, heights: np.ndarray, padding: list[tuple[int, int]], factors: list[int], threads: int
) -> Callable[[float], np.ndarray]:
    """Return the function of ζ: axial convolution of the exposed resin, weighted by conversion, on coarse pixels."""
    sigma = crosslinked.fwhm_z_um / FWHM_PER_SIGMA
    if not crosslinked.converts:
        return lambda z: block_mean(ndtr(z / sigma) - ndtr((z - heights) / sigma), factors)
    layers = Layers.of(crosslinked.source_weight, float(heights.max()), CONVERSION_LAYER_UM, threads).padded(padding)
    columns = Columns(layers, heights, from_glass=False, reduce=lambda plane: block_mean(plane, factors))
    return lambda z: columns.convolved(z, sigma)


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

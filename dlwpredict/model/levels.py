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
from scipy import special

from dlwpredict.model.layers import Columns, Layers
from dlwpredict.model.states import Crosslinked, Dose, Exposed, Focus
from dlwpredict.parallel import each
from dlwpredict.smoothing import BLOCK_PX, COARSE_PIXELS_PER_SIGMA, FWHM_PER_SIGMA, block_mean, ndtr, sparse_means

LEVEL_STEP_SIGMAS = 0.5
"""Distance of exposure levels in axial standard deviations; the surface then errs by 0.1 nm rms, 3 nm beside walls."""

STEPS_PER_OCTAVE = 4
"""The nearest step of this ladder is taken, so that the levels mostly stay where they are while the focus is fitted.
Else they would make the prediction jump by 0.02 nm rms with every change, as much as the last steps of a fit gain."""

DOSE_LAYER_UM, CONVERSION_LAYER_UM = 0.2, 0.5
"""Thickness of the layers of local dose and of local conversion. It must not depend on any parameter: where the outline
of a layer is hard, moving layers would make the prediction jump by nanometres under a fit."""

ABOVE_SIGMAS = 2.5
"""Levels end this many axial standard deviations above the part where the local dose can lift its surface."""

LARGEST_FRACTION = 0.95
"""Largest threshold as a fraction of the local dose at which the logit is still smooth in z."""

TILE_PX = 168
STRIP_PX = 16
"""Coarse rows worked on at once: their modes then stay in the cache."""

_NEAR = 1e-7
"""Weights of an interpolation that count: a height's error stays far below a nanometre."""

_ROUNDING = 0.01  # of a level: a flat top may lie on one
_TINY, _BELOW_ONE = 1e-12, float(np.nextafter(np.float32(1), np.float32(0)))


@dataclass(frozen=True)
class Levels:
    """The fast numerics.

    Parameters
    ----------
    threads : int
        Tiles computed at once. The steps of a tile are short, and two threads mostly wait for the interpreter: on two
        cores they take longer than one. Processes do better (`batch`).
    """

    threads: int = 1

    def exposed(self, dose: Dose, threshold: float, reference: str) -> Exposed:
        """Solve exposure = threshold for the height of every column.

        Per tile: levels z_k that span the tile's heights, E_k = Σ weight · G_xy ⊛ Φ((h − z_k)/s_z), then the root of
        logit(E/D) − logit(P/D) between levels, by a cubic: logit Φ(t) is a cubic in t to 1e-3. Where the dose differs
        from layer to layer, Φ becomes the sum over the layers, and D is the largest dose of the column. Single
        precision: its 1e-7 of the full dose is a ten thousandth of a nanometre.
        """
        written = dose.written
        heights = written.heights_um
        if reference == "structure_maximum":
            nominal = _Exposure(dose.focus, heights, written.dx_um, written.dy_um)
            threshold = threshold * float(nominal.at(0.0).max())
        step = _level_step_um(dose.focus)
        layers, thresholds = _local(dose, step, self.threads)
        reach = [_reach_px(dose.focus, pitch) for pitch in (written.dy_um, written.dx_um)]
        surface = np.zeros(written.shape)

        def solve(corner: tuple[int, int]) -> None:
            inner = tuple(slice(start, start + TILE_PX) for start in corner)
            outer = tuple(slice(max(start - r, 0), start + TILE_PX + r) for start, r in zip(corner, reach, strict=True))
            part = heights[outer]
            if part.any():
                columns = None if layers is None else Columns(layers[outer], part, from_glass=True)
                kept = tuple(slice(s.start - o.start, s.stop - o.start) for s, o in zip(inner, outer, strict=True))
                exposure = _Exposure(dose.focus, part, written.dx_um, written.dy_um, columns, kept)
                local = threshold if thresholds is None else threshold * thresholds[inner].weights
                surface[inner] = _surface_of_tile(exposure, local, step)

        each(solve, _corners(written.shape, TILE_PX), self.threads)
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
        place, found = 2 * surface.heights_um / top - 1, np.empty(surface.shape)

        def read_off(corner: tuple[int, int]) -> None:
            tile = tuple(slice(start, start + BLOCK_PX) for start in corner)
            up_y, up_x = rows[tile[0]], cols[tile[1]]
            near_y, near_x = _near(up_y), _near(up_x)
            modes = up_y[:, near_y] @ mean[:, near_y, near_x] @ up_x[:, near_x].T
            found[tile] = chebyshev.chebval(place[tile], modes, tensor=False)

        each(read_off, _corners(surface.shape, BLOCK_PX), self.threads)
        return found


def _corners(shape: tuple[int, int], side_px: int) -> list[tuple[int, int]]:
    return [(row, col) for row in range(0, shape[0], side_px) for col in range(0, shape[1], side_px)]


def _near(up: np.ndarray) -> slice:
    """Return the points that count in an interpolation (pixels, points)."""
    used = np.flatnonzero(np.abs(up).max(axis=0) > _NEAR)
    return slice(used[0], used[-1] + 1)


def _reach_px(focus: tuple[Focus, ...], pitch_um: float) -> int:
    return int(np.ceil(max(part.reach_um for part in focus) / pitch_um)) + 1


def _level_step_um(focus: tuple[Focus, ...]) -> float:
    """Return the distance of exposure levels, a power of 2^(1/4)."""
    width = LEVEL_STEP_SIGMAS * min(part.sigma_z_um(0.0) for part in focus)
    return float(2 ** (np.round(STEPS_PER_OCTAVE * np.log2(width)) / STEPS_PER_OCTAVE))


def _local(dose: Dose, step: float, threads: int) -> tuple[Layers | None, Layers | None]:
    """Return the relative dose and the relative threshold on layers, None where they are 1 throughout."""
    top = float(dose.written.heights_um.max())
    room = ABOVE_SIGMAS * max(part.sigma_z_um(top) for part in dose.focus) + 3 * step
    return (
        Layers.of(dose.relative_dose, top, DOSE_LAYER_UM, threads) if dose.intensity else None,
        Layers.of(dose.relative_threshold, top + room, DOSE_LAYER_UM, threads).every(step)
        if dose.threshold_factor or dose.background
        else None,
    )


@dataclass(frozen=True, eq=False)
class _Exposure:
    """The exposure of a height map: 1 inside a large block at nominal dose, 0 where nothing is written.

    Only the part that is kept is returned: beyond it the map need not be complete.
    """

    focus: tuple[Focus, ...]
    heights_um: np.ndarray
    dx_um: float
    dy_um: float
    columns: Columns | None = None
    kept: tuple[slice, slice] = (slice(None), slice(None))

    def at(self, z_um: float) -> np.ndarray:
        """Return the exposure at one level."""

        def axial(sigma_um: float) -> np.ndarray:
            if self.columns is not None:
                return self.columns.convolved(z_um, sigma_um)
            depth = ((self.heights_um - z_um) / sigma_um).astype(np.float32)
            return np.where(self.heights_um > 0, ndtr(depth), 0)

        return self._spread(lambda part: axial(part.sigma_z_um(z_um)))

    def highest_dose(self) -> np.ndarray | float:
        """Return the largest relative dose of each column as the focus sees it: exposure stays below it."""
        if self.columns is None:
            return 1.0
        written = (self.heights_um > 0).astype(float)
        nominal = np.maximum(self._spread(lambda part: written), _TINY)
        return np.maximum(self._spread(lambda part: self.columns.highest) / nominal, _TINY)

    def _spread(self, plane_of: Callable[[Focus], np.ndarray]) -> np.ndarray:
        return sum(part.weight * part.spread(plane_of(part), self.dx_um, self.dy_um)[self.kept] for part in self.focus)


def _surface_of_tile(exposure: _Exposure, threshold: np.ndarray | float, step: float) -> np.ndarray:
    """Return the exposed height over one tile (rows, cols), from four successive levels around each crossing.

    The threshold is one number, or a stack over the levels j · step, j ≥ 0.
    """
    first, last = _levels_around(exposure, threshold, step)
    shape = exposure.heights_um[exposure.kept].shape
    dose = np.maximum(exposure.highest_dose(), np.max(threshold) / LARGEST_FRACTION)
    dose = np.broadcast_to(dose.astype(np.float32), shape)
    surface = np.zeros(np.prod(shape))
    around: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for k in range(first, last):
        wanted = threshold[np.clip(k, 0, len(threshold) - 1)] if np.ndim(threshold) else np.float32(threshold)
        exposed = exposure.at(k * step)
        around = [*around[-3:], (exposed, np.broadcast_to(wanted, shape), exposed >= wanted)]
        if k < first + 3:
            continue
        crossing = np.flatnonzero(around[1][2] & ~around[2][2])
        if len(crossing):
            top = dose.take(crossing)
            inside = _cubic_root(*(_margin(e.take(crossing) / top, w.take(crossing) / top) for e, w, _ in around))
            surface[crossing] = (k - 2 + inside.astype(float)) * step
    return np.maximum(surface, 0.0).reshape(shape)


def _levels_around(exposure: _Exposure, threshold: np.ndarray | float, step: float) -> tuple[int, int]:
    """Return the range of levels that encloses every crossing.

    Exposure is a mean of Φ((h − z)/s) over the heights h around. At nominal dose, and with no empty point among them,
    it crosses the threshold where Φ of the lowest and of the highest do, or between. Else only this is known: it is
    level 4 s_z below the lowest height. All tiles share one grid of levels, with and without effects, so that neither
    leaves a trace in the result.
    """
    heights = exposure.heights_um
    lowest, highest = float(heights.min()), float(heights.max())
    widest = max(part.sigma_z_um(z) for part in exposure.focus for z in (0.0, highest))
    above, below = ABOVE_SIGMAS * widest, 4 * widest
    if exposure.columns is None:
        above = max(-special.ndtri(np.min(threshold)) * widest, 0.0)
        below = below if lowest == 0 else max(special.ndtri(np.max(threshold)) * widest, 0.0)
    lowest = lowest or float(heights[heights > 0].min())
    bottom, top = max(lowest - below, 0) / step, (highest + above) / step
    return int(bottom - _ROUNDING) - 1, int(top + _ROUNDING) + 3


def _margin(exposure: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return logit(E) − logit(P), 0 at the surface."""
    e, p = (np.clip(share, _TINY, _BELOW_ONE) for share in (exposure, wanted))
    return np.log(e * (1 - p) / (p * (1 - e)))


def _cubic_root(before: np.ndarray, left: np.ndarray, right: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the root in 0 … 1 of the cubic through values at −1, 0, 1, 2, where left ≥ 0 > right."""
    c = -before / 3 - left / 2 + right - after / 6
    b = before / 2 - left + right / 2
    a = -before / 6 + left / 2 - right / 2 + after / 6
    t = left / (left - right)
    for _ in range(3):
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
    source = _source(crosslinked, heights, whole, factors, levels, threads)
    (down_y, up_y), (down_x, up_x) = (
        sparse_means(n // m, float(s), m) for n, m, s in zip(heights.shape, factors, sigmas, strict=True)
    )
    return down_y @ source @ down_x.T, up_y[: surface.shape[0]], up_x[: surface.shape[1]]


def _source(
    crosslinked: Crosslinked,
    heights: np.ndarray,
    padding: list[tuple[int, int]],
    factors: list[int],
    levels: np.ndarray,
    threads: int,
) -> np.ndarray:
    """Return the axial convolution of the exposed resin, weighted by conversion: (level, coarse rows, coarse cols)."""
    sigma = crosslinked.fwhm_z_um / FWHM_PER_SIGMA
    if not crosslinked.converts:
        return _unweighted(heights, sigma, factors, levels, threads)
    layers = Layers.of(crosslinked.source_weight, float(heights.max()), CONVERSION_LAYER_UM, threads).padded(padding)
    columns = Columns(layers, heights, from_glass=False, reduce=lambda plane: block_mean(plane, factors))
    return np.stack(each(lambda z: columns.convolved(z, sigma), levels, threads))


def _unweighted(
    heights: np.ndarray, sigma_um: float, factors: list[int], levels: np.ndarray, threads: int
) -> np.ndarray:
    """Return the block means of Φ(ζ/s) − Φ((ζ − h)/s) at all levels ζ.

    It is as smooth in h as in ζ: the block means of the Chebyshev polynomials of h hold all levels at once.
    """
    top = float(heights.max())
    profile = special.ndtr(levels / sigma_um)[:, None] - special.ndtr((levels[:, None] - levels) / sigma_um)
    weights = (profile @ _to_modes(len(levels)).T).astype(np.float32)

    def means(first: int) -> np.ndarray:
        x = (2 * heights[first : first + rows] / top - 1).astype(np.float32)
        before, at, found = x, np.ones_like(x), []
        for _ in levels:
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

"""The height map of exposed resin: the root of exposure = threshold between a few smooth levels in z."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from dlwpredict.heightmap import HeightMap
from dlwpredict.model.edges import Edges, near_steps, taken
from dlwpredict.model.layers import Columns, Layers
from dlwpredict.model.states import Dose, Focus
from dlwpredict.model.steps import WALL
from dlwpredict.numerics.normal import ndtr
from dlwpredict.numerics.parallel import corners, each
from dlwpredict.numerics.smoothing import FWHM_PER_SIGMA

LEVEL_STEP_SIGMAS = 0.5
"""Distance of exposure levels in axial standard deviations; the surface then errs by 0.1 nm rms, 3 nm beside walls."""

STEPS_PER_OCTAVE = 4
"""The nearest step of this ladder is taken, so that the levels mostly stay where they are while the focus is fitted.
Else they would make the prediction jump by 0.02 nm rms with every change, as much as the last steps of a fit gain."""

DOSE_LAYER_UM = 0.2
"""Thickness of the layers of local dose. It must not depend on any parameter: where the outline of a layer is hard,
moving layers would make the prediction jump by nanometres under a fit."""

ABOVE_SIGMAS = 2.5
"""Levels end this many axial standard deviations above the part where the local dose can lift its surface."""

WALL_SIGMAS, WALL_LAGS = 2.0, 3.0
"""The edge stays so near to the step, in lateral standard deviations and lags: thresholds are 0.05 to 0.95."""

WALL_Z_SIGMAS = 1.5
"""So far below the lowest surface and above the highest a pixel beside a wall may still seem to have an edge."""

LARGEST_FRACTION = 0.95
"""Largest threshold as a fraction of the local dose at which the logit is still smooth in z."""

TILE_PX = 168

LEVELS_AT_ONCE = 6
"""Exposure is evaluated on so many levels together: few enough that what lies between stays in the cache."""

LAYERS_BELOW_SIGMAS = 5.5
"""Layers of dose further below the lowest level than this many axial standard deviations reach no level: 2e-8."""

_ROUNDING = 0.1  # of a level: a flat top may lie on one, and the sampled tail of a focus lifts one by as much
_TINY, _BELOW_ONE = 1e-12, float(np.nextafter(np.float32(1), np.float32(0)))


def exposed_surface(
    dose: Dose, threshold: float, reference: str, threads: int, *, whole_pixels: bool = False
) -> HeightMap:
    """Solve exposure = threshold for the height of every column.

    Per tile: levels z_k that span the tile's heights, E_k = Σ weight · G_xy ⊛ Φ((h − z_k)/s_z), then the root of
    logit(E/D) − logit(P/D) between levels, by a cubic: logit Φ(t) is a cubic in t to 1e-3. Where the dose differs
    from layer to layer, Φ becomes the sum over the layers, and D is the largest dose of the column. Single
    precision: its 1e-7 of the full dose is a ten thousandth of a nanometre. Where the edge of the exposed resin runs
    through a pixel, the height is that of the column's exposed share (`edges`), unless pixels are to be whole.
    """
    written = dose.written
    heights = written.heights_um
    if reference == "structure_maximum":
        nominal = _Exposure(dose.focus, heights, written.dx_um, written.dy_um)
        threshold = threshold * float(nominal.at([0.0]).max())
    step = _level_step_um(dose.focus)
    layers, thresholds = _local(dose, step, threads)
    reach = [_reach_px(dose.focus, pitch) for pitch in (written.dy_um, written.dx_um)]
    surface = np.zeros(written.shape)

    def solve(corner: tuple[int, int]) -> None:
        inner = tuple(slice(max(start - 1, 0), start + TILE_PX + 1) for start in corner)
        outer = tuple(slice(max(start - r, 0), start + TILE_PX + r) for start, r in zip(corner, reach, strict=True))
        part = heights[outer]
        if part.any():
            columns = None if layers is None else Columns(layers[outer], part, from_glass=True)
            rows, cols = (slice(s.start - o.start, s.stop - o.start) for s, o in zip(inner, outer, strict=True))
            exposure = _Exposure(dose.focus, part, written.dx_um, written.dy_um, columns, (rows, cols))
            factors = None if thresholds is None else thresholds[inner]
            kept = tuple(slice(min(start, 1), min(start, 1) + TILE_PX) for start in corner)
            tile = tuple(slice(start, start + TILE_PX) for start in corner)
            surface[tile] = _surface_of_tile(exposure, threshold, factors, step, whole_pixels)[kept]

    each(solve, corners(written.shape, TILE_PX), threads)
    return written.with_heights(surface)


def _reach_px(focus: tuple[Focus, ...], pitch_um: float) -> int:
    """Return how far around a tile heights matter to it: the focus reaches there, and a pixel has neighbours."""
    return int(np.ceil(max(part.reach_um for part in focus) / pitch_um)) + 2


def _level_step_um(focus: tuple[Focus, ...]) -> float:
    """Return the distance of exposure levels, a power of 2^(1/4)."""
    width = LEVEL_STEP_SIGMAS * min(part.sigma_z_um(0.0) for part in focus)
    return float(2 ** (np.round(STEPS_PER_OCTAVE * np.log2(width)) / STEPS_PER_OCTAVE))


def _local(dose: Dose, step: float, threads: int) -> tuple[Layers | None, Layers | None]:
    """Return the relative dose and the relative threshold on layers, None where they are 1 throughout."""
    heights = dose.written.heights_um
    top = float(heights.max())
    widest = _widest_um(dose.focus, top)
    lowest = _lowest_level(heights, widest, step) * step
    return (
        Layers.of(dose.relative_dose, top, DOSE_LAYER_UM, threads, lowest - LAYERS_BELOW_SIGMAS * widest)
        if dose.intensity
        else None,
        Layers.of(dose.relative_threshold, top + ABOVE_SIGMAS * widest + 3 * step, step, threads, lowest)
        if dose.threshold_factor or dose.background
        else None,
    )


def _widest_um(focus: tuple[Focus, ...], highest_um: float) -> float:
    return max(part.sigma_z_um(z) for part in focus for z in (0.0, highest_um))


def _lowest_level(heights_um: np.ndarray, widest_um: float, step: float) -> int:
    """Return the index of a level below every crossing: the lowest height less 4 axial standard deviations."""
    lowest = float(np.min(heights_um, where=heights_um > 0, initial=heights_um.max()))
    return int(max(lowest - 4 * widest_um, 0) / step - _ROUNDING) - 1


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

    def at(self, z_um: Sequence[float]) -> np.ndarray:
        """Return the exposure at some levels, shape (levels, rows, cols)."""

        def axial(part: Focus) -> np.ndarray:
            sigmas = [part.sigma_z_um(z) for z in z_um]
            if self.columns is not None:
                return self.columns.convolved(z_um, sigmas)
            z, sigma = (np.array(values, dtype=np.float32)[:, None, None] for values in (z_um, sigmas))
            solid = ndtr((self.heights_um.astype(np.float32) - z) / sigma)
            solid *= self.heights_um > 0
            return solid

        return self._spread(axial)

    def highest_dose(self) -> np.ndarray | float:
        """Return the largest relative dose of each column as the focus sees it: exposure stays below it."""
        columns = self.columns
        if columns is None:
            return 1.0
        written = (self.heights_um > 0).astype(np.float32)
        nominal = np.maximum(self._spread(lambda part: written), _TINY)
        return np.maximum(self._spread(lambda part: columns.highest) / nominal, _TINY)

    def near_walls(self) -> np.ndarray:
        """Return how much it counts that the edge of the exposed resin may run through a pixel, shape (rows, cols)."""
        away = sum(
            part.weight
            * (WALL_SIGMAS * max(part.fwhm_x_um, part.fwhm_y_um) / FWHM_PER_SIGMA + WALL_LAGS * abs(part.lag_y_um))
            for part in self.focus
        )
        pitches = self.dy_um, self.dx_um
        steps, reach = [WALL * pitch for pitch in pitches], [away / pitch for pitch in pitches]
        return near_steps(self.heights_um, steps, reach)[self.kept]

    def _spread(self, plane_of: Callable[[Focus], np.ndarray]) -> np.ndarray:
        parts = (
            part.weight * part.spread(plane_of(part), self.dx_um, self.dy_um)[..., *self.kept] for part in self.focus
        )
        return reduce(np.add, parts)


def _surface_of_tile(
    exposure: _Exposure, threshold: float, factors: Layers | None, step: float, whole_pixels: bool
) -> np.ndarray:
    """Return the exposed height over one tile (rows, cols): that at the pixels' centres, and what edges add to it.

    The factors on the threshold lie on the same levels.
    """
    least, most = (1.0, 1.0) if factors is None else (float(factors.weights.min()), float(factors.weights.max()))
    highest = exposure.highest_dose()
    walls = np.zeros((1, 1)) if whole_pixels else exposure.near_walls()
    beside = WALL_Z_SIGMAS if walls.any() else 0.0
    first, last = _levels_around(exposure, threshold * least, threshold * most, float(np.max(highest)), step, beside)
    shape = exposure.heights_um[exposure.kept].shape
    dose = np.maximum(highest, threshold * most / LARGEST_FRACTION)
    dose = np.atleast_2d(dose.astype(np.float32))
    crossings, edges, around = _Crossings(), Edges(walls, dose), list[_Level]()
    for start in range(first, last, LEVELS_AT_ONCE):
        some = range(start, min(start + LEVELS_AT_ONCE, last))
        exposures = exposure.at([k * step for k in some])
        factor = np.ones((len(some), 1, 1), np.float32) if factors is None else np.stack([factors.at(k) for k in some])
        thresholds = np.float32(threshold) * factor
        exposed = exposures >= thresholds
        if len(edges.places):
            edges.rise(exposures, thresholds, exposed)
        for k, *planes in zip(some, exposures, thresholds, exposed, strict=True):
            level = _Level(*planes)
            around = [*around[-3:], level] if around else [level, level]  # below the first all is as there
            if len(around) == 4:
                crossings.add(k - 2, around, dose)
    surface = np.maximum(crossings.heights(shape), 0)
    if len(edges.places):
        surface.flat[edges.places] += edges.steps(first)
    return np.maximum(surface, 0) * step


class _Level(NamedTuple):
    """Exposure, threshold and which pixels' centres are exposed on one level of a tile, (rows, cols) or (1, 1)."""

    exposure: np.ndarray
    threshold: np.ndarray
    exposed: np.ndarray


class _Crossings:
    """Where columns leave the exposed resin upwards, each with the exposure on four levels around."""

    def __init__(self) -> None:
        self.places: list[np.ndarray] = []
        self.levels: list[np.ndarray] = []
        self.margins: list[np.ndarray] = []

    def add(self, index: int, around: Sequence[_Level], dose: np.ndarray) -> None:
        """Take the columns that leave between the second and the third of four levels; the second has this index."""
        places = np.flatnonzero(around[1].exposed & ~around[2].exposed)
        self.places.append(places)
        self.levels.append(np.full(len(places), index))
        if len(places):
            full = taken(dose, places)
            exposures, thresholds = (
                np.stack([taken(plane, places) / full for plane in planes])
                for planes in zip(*(one[:2] for one in around), strict=True)
            )
            self.margins.append(_margin(exposures, thresholds))

    def heights(self, shape: tuple[int, ...]) -> np.ndarray:
        """Return the highest crossing of every column in steps of the levels, shape (rows, cols), 0 where none is."""
        surface = np.zeros(np.prod(shape))
        if self.margins:  # the highest last
            roots = _cubic_root(*np.concatenate(self.margins, axis=-1)).astype(float)
            surface[np.concatenate(self.places)] = np.concatenate(self.levels) + roots
        return surface.reshape(shape)


def _levels_around(
    exposure: _Exposure, least: float, most: float, dose: float, step: float, beside_sigmas: float
) -> tuple[int, int]:
    """Return the range of levels that encloses every crossing of thresholds from the least to the most.

    Exposure is a mean of Φ((h − z)/s) over the heights h around, times a dose up to the highest one. At nominal dose,
    and with no empty point among them, it crosses the threshold where Φ of the lowest and of the highest do, or
    between. Else only this is known below: it is level 4 s_z below the lowest height. All tiles share one grid of
    levels, with and without effects, so that neither leaves a trace in the result.
    """
    heights = exposure.heights_um
    lowest, highest = float(heights.min()), float(heights.max())
    widest = _widest_um(exposure.focus, highest)
    above = min(max(-_quantile(min(least / dose, 0.5)), 0.0), ABOVE_SIGMAS) * widest
    if lowest > 0 and exposure.columns is None:
        bottom = int(max(lowest - (max(_quantile(most), 0.0) + beside_sigmas) * widest, 0) / step - _ROUNDING) - 1
    else:
        bottom = _lowest_level(heights, widest, step)
    return bottom, int((highest + above + beside_sigmas * widest) / step + _ROUNDING) + 3


def _quantile(share: float) -> float:
    """Return Φ⁻¹; seven standard deviations stand for all that lies beyond."""
    return NormalDist().inv_cdf(min(max(share, _TINY), 1 - _TINY))


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

"""How alike two surfaces are: deviations, correlation, roughness, and the response of the height axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.errors import InputError, ResultError
from dlwpredict.heightmap import HeightMap, require_same_grid
from dlwpredict.metrology.walls import near_walls_or_rim

MATERIAL_RATIO_RANGE = (0.05, 0.95)


@dataclass(frozen=True)
class Score:
    """Figures of a test surface against its reference; None where a figure is undefined.

    Parameters
    ----------
    rmse_um, rmse_offset_free_um, mean_difference_um : float
        Of test − reference: root mean square, the same about its mean, and that mean;
        rmse² = rmse_offset_free² + mean_difference².
    cc : float or None
        MATLAB's corr2; None where a map is constant.
    sa_um, sq_um, sz_um : float
        Mean and root mean square deviation from the mean height, and range, of the test surface; nothing is filtered.
    alpha_z, l_z_um : float or None
        Slope of, and largest distance from, the regression line of the response over ``material_ratio_range``.
    material_ratio_range : tuple of float
    alpha_z_full, l_z_full_um : float or None
        The same over all heights, 0 to 1.
    region : {"map", "part"}
        What the figures stand for: the whole map, or the points where the reference is higher than the substrate.
    valid_fraction : float
        Compared points among the points of the region.
    points : int
        Compared points: a height in both maps, neither of them filled.
    filled_points, filled_points_entered : int
        Points of the region that were filled in either map, and how many of them entered (0 unless asked for).
    substrate_fraction : float
        Compared points at which the reference is bare substrate (height 0).
    height_reference : str
        "relative" if either map has no absolute zero: then the mean difference, and rmse with it, say nothing.
    """

    rmse_um: float
    rmse_offset_free_um: float
    cc: float | None
    mean_difference_um: float
    sa_um: float
    sq_um: float
    sz_um: float
    alpha_z: float | None
    l_z_um: float | None
    material_ratio_range: tuple[float, float]
    alpha_z_full: float | None
    l_z_full_um: float | None
    region: str
    valid_fraction: float
    points: int
    filled_points: int
    filled_points_entered: int
    substrate_fraction: float
    height_reference: str


def score(
    reference: HeightMap,
    test: HeightMap,
    *,
    material_ratio_range: tuple[float, float] = MATERIAL_RATIO_RANGE,
    part_only: bool = False,
    include_filled: bool = False,
    wall_px: int = 0,
    left_out: np.ndarray | None = None,
) -> Score:
    """Compare a test surface with its reference, point by point and by height distribution.

    Parameters
    ----------
    reference, test : HeightMap
        On the same grid.
    material_ratio_range : tuple of float
        Material ratios between which α_z and l_z are taken.
    part_only : bool
        Leave out the points where the reference is bare substrate (height 0 or less).
    include_filled : bool
        Let points enter that were interpolated, not measured.
    wall_px : int
        Leave out the points this near to walls of the reference and to the map's rim.
    left_out : numpy.ndarray of bool, shape (rows, cols), optional
        Further points that do not belong to the region.

    Raises
    ------
    InputError
        The grids differ, or the range is not within 0 to 1.
    ResultError
        No point can be compared.
    """
    require_same_grid(reference, test, ("reference", "test"))
    low, high = material_ratio_range
    if not 0 <= low < high <= 1:
        raise InputError(f"found {low:g} {high:g}", key="material_ratio_range", allowed="two rising numbers in 0 to 1")
    region = reference.heights_um > 0 if part_only else np.ones(reference.shape, dtype=bool)
    if wall_px:
        region = region & ~near_walls_or_rim(reference, wall_px)
    if left_out is not None:
        region = region & ~left_out
    known = ~np.isnan(reference.heights_um) & ~np.isnan(test.heights_um) & region
    filled = known & ~(reference.measured & test.measured)
    compared = known if include_filled else known & ~filled
    if not compared.any():
        raise ResultError("no point has a measured height in both maps", key="heights")
    x, y = reference.heights_um[compared], test.heights_um[compared]
    sa, sq, sz = roughness(y)
    alpha, linearity = response(x, y, low, high)
    alpha_full, linearity_full = response(x, y, 0.0, 1.0)
    return Score(
        rmse_um=float(np.sqrt(np.mean((y - x) ** 2))),
        rmse_offset_free_um=float(np.std(y - x)),
        cc=corr2(x, y),
        mean_difference_um=float(np.mean(y - x)),
        sa_um=sa,
        sq_um=sq,
        sz_um=sz,
        alpha_z=alpha,
        l_z_um=linearity,
        material_ratio_range=(float(low), float(high)),
        alpha_z_full=alpha_full,
        l_z_full_um=linearity_full,
        region="part" if part_only else "map",
        valid_fraction=float(compared.sum() / region.sum()),
        points=int(compared.sum()),
        filled_points=int(filled.sum()),
        filled_points_entered=int(filled.sum()) if include_filled else 0,
        substrate_fraction=float(np.mean(x == 0)),
        height_reference="relative"
        if "relative" in (reference.height_reference, test.height_reference)
        else "substrate",
    )


def corr2(a: np.ndarray, b: np.ndarray) -> float | None:
    """Return the correlation coefficient of MATLAB's ``corr2``; None if either array is constant.

    CC = Σ(a − ā)(b − b̄)/√(Σ(a − ā)²·Σ(b − b̄)²), Lang et al. 2022. Blind to gain and offset.

    Examples
    --------
    >>> corr2(np.array([0.0, 1.0, 2.0]), np.array([5.0, 4.0, 3.0]))
    -1.0
    """
    if np.ptp(a) == 0 or np.ptp(b) == 0:
        return None
    a, b = a - a.mean(), b - b.mean()
    return float(np.clip(np.sum(a * b) / np.sqrt(np.sum(a**2) * np.sum(b**2)), -1, 1))


def roughness(heights_um: np.ndarray) -> tuple[float, float, float]:
    """Return Sa, Sq and Sz about the mean height (ISO 25178-2, without filter or levelling), µm."""
    deviation = heights_um - heights_um.mean()
    return float(np.mean(abs(deviation))), float(np.sqrt(np.mean(deviation**2))), float(np.ptp(heights_um))


def abbott_curve(heights_um: np.ndarray, ratios: np.ndarray) -> np.ndarray:
    """Return the height that the fraction p of the points reaches or exceeds: C(p) = the (1 − p) quantile, µm.

    The k-th lowest of N heights, k from 1, is the (k − ½)/N quantile; straight lines between.
    """
    ordered = np.sort(heights_um, axis=None)
    return np.interp(1 - ratios, (np.arange(ordered.size) + 0.5) / ordered.size, ordered)


def response(x_um: np.ndarray, y_um: np.ndarray, low: float, high: float) -> tuple[float | None, float | None]:
    """Return amplification coefficient α_z and linearity deviation l_z (ISO 25178-600) between two material ratios.

    Heights of equal material ratio p_i = low + (high − low)(i − ½)/N are paired, x_i = C_reference(p_i),
    y_i = C_test(p_i), N the number of points; α_z is the slope of the regression of y on x, l_z the largest distance of
    a y_i from that line. Needs no lateral registration and sees no lateral error.

    Returns
    -------
    alpha_z, l_z_um : float or None
        None if the reference has one height only within the range.

    Examples
    --------
    >>> heights = np.linspace(0, 2, 101)
    >>> alpha, l = response(heights, 0.8 * heights + 3, 0.05, 0.95)
    >>> round(alpha, 9), round(l, 9)
    (0.8, 0.0)
    """
    ratios = low + (high - low) * (np.arange(x_um.size) + 0.5) / x_um.size
    x, y = abbott_curve(x_um, ratios), abbott_curve(y_um, ratios)
    if np.ptp(x) == 0:
        return None, None
    x, y = x - x.mean(), y - y.mean()
    alpha = np.sum(x * y) / np.sum(x**2)
    return float(alpha), float(np.max(abs(y - alpha * x)))

"""What several effects need of the plane: field radius, layers, footprint, edges, slopes, resampling."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from dlwpredict.heightmap import HeightMap
from dlwpredict.model.steps import WALL
from dlwpredict.numerics.interpolation import read_locally
from dlwpredict.numerics.normal import ndtr
from dlwpredict.numerics.smoothing import FWHM_PER_SIGMA, REACH_SIGMAS, blur, wide_blur

FIELD_RADIUS_UM = 50.0
"""Distance from the field's centre at which field-dependent effects are stated (ρ = 1)."""


def field_coordinates(
    grid: HeightMap, centre_x_um: float = 0.0, centre_y_um: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return x (cols,) and y (rows, 1) from the field's centre, in units of 50 µm; ρ² = x² + y²."""
    x = (grid.x_um - centre_x_um) / FIELD_RADIUS_UM
    y = (grid.y_um[:, None] - centre_y_um) / FIELD_RADIUS_UM
    return x, y


def where_written(target: HeightMap, heights_um: np.ndarray) -> np.ndarray:
    """Keep changed heights at 0 or above, and at 0 where nothing was written."""
    return np.where(target.heights_um > 0, np.maximum(heights_um, 0), 0)


def occupied(written: HeightMap, z_um: float | np.ndarray) -> np.ndarray:
    """Tell where the layer at height z is written, (rows, cols) of 0 and 1; several for heights of shape (n, 1, 1)."""
    return ((written.heights_um > 0) & (written.heights_um >= z_um)).astype(np.float32)


def up_to_surface(written: HeightMap, z_um: float | np.ndarray, sigma_um: float) -> np.ndarray:
    """Return Φ((h − z)/σ), 0 beside the part: what is written and the glass under it, convolved along z."""
    depth = ((written.heights_um - z_um) / sigma_um).astype(np.float32)
    return ndtr(depth) * (written.heights_um > 0)


def gaussian_um(planes: np.ndarray, grid: HeightMap, fwhm_um: float) -> np.ndarray:
    """Convolve planes (..., rows, cols) with a lateral Gaussian of this FWHM; outside them there is nothing."""
    return wide_blur(planes, fwhm_um / FWHM_PER_SIGMA / grid.dy_um, fwhm_um / FWHM_PER_SIGMA / grid.dx_um)


def blurred_recording(recording: HeightMap, fwhm_um: float) -> np.ndarray:
    """Return G ⊛ t over the measured points, NaN elsewhere; around the map it goes on as at its rim.

    The substrate there need not be at 0: an instrument's field is curved, a sample tilted, a map cut out of a part.
    """
    sigmas = (fwhm_um / FWHM_PER_SIGMA / recording.dy_um, fwhm_um / FWHM_PER_SIGMA / recording.dx_um)
    around = [int(np.ceil(REACH_SIGMAS * sigma)) for sigma in sigmas]
    heights = np.pad(recording.heights_um, [(n, n) for n in around], mode="edge")
    inner = tuple(slice(n, n + size) for n, size in zip(around, recording.shape, strict=True))
    missing = np.isnan(heights)
    smooth = blur(np.where(missing, 0, heights), *sigmas)[inner]
    if not missing.any():
        return smooth
    known = np.maximum(1 - blur(missing.astype(float), *sigmas)[inner], 1e-9)
    return np.where(missing[inner], np.nan, smooth / known)


def slopes(recording: HeightMap) -> tuple[np.ndarray, np.ndarray]:
    """Return ∂t/∂x and ∂t/∂y (y upwards) by central differences, gaps closed by their nearest neighbours."""
    down, right = np.gradient(nearest(recording.heights_um, ~np.isnan(recording.heights_um)))
    return right / recording.dx_um, -down / recording.dy_um


def own_slope(bend: np.ndarray, pitch_um: float) -> np.ndarray:
    """Return by how much the slope on the upper side of a pixel exceeds the central one; on the lower side it is less.

    b/2 · s/(1 + s) of a bend b, with s = (b/(WALL · pitch))⁸. Nothing on smooth ground, so that a small step up counts
    like one down; half of the bend beside a wall, which is then straight from pixel to pixel, and nothing overshoots.

    Parameters
    ----------
    bend : numpy.ndarray
        Second difference of the heights, µm; the result is in µm per pixel.
    pitch_um : float
    """
    steep = np.minimum(np.square(np.square(np.square(bend / (WALL * pitch_um)))), 1e9)
    return bend / 2 * steep / (1 + steep)


def nearest(plane: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return the plane with every unknown point taken from the nearest known one (0 if none is known)."""
    if known.all():
        return plane
    if not known.any():
        return np.zeros(plane.shape)
    rows, cols = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return plane[rows, cols]


def standing(surface: HeightMap) -> np.ndarray:
    """Return the footprint of a part: wherever it has height, but for columns of its outline less than half full.

    A wall that runs through a pixel leaves a lower column there, beside empty ground. What is low inside the outline, a
    base round a tower, is no edge of the part, however low.
    """
    heights = surface.heights_um
    full = heights >= ndimage.maximum_filter(heights, 3, mode="nearest") / 2
    inside = ndimage.minimum_filter(heights, 3, mode="nearest") > 0
    footprint: np.ndarray = (heights > 0) & (full | inside)
    return footprint


def edge_distance_um(footprint: np.ndarray, grid: HeightMap) -> np.ndarray:
    """Return the distance of every pixel's centre to the edge of the footprint, half a pixel beyond its last pixel."""
    inside = np.pad(footprint, 1)
    distance = ndimage.distance_transform_edt(inside, sampling=(grid.dy_um, grid.dx_um))[1:-1, 1:-1]
    return np.maximum(distance - min(grid.dx_um, grid.dy_um) / 2, 0)


def centroid_um(footprint: np.ndarray, grid: HeightMap) -> tuple[float, float]:
    """Return x and y of the footprint's centroid, µm."""
    count = max(footprint.sum(), 1)
    return float(footprint.sum(axis=0) @ grid.x_um / count), float(footprint.sum(axis=1) @ grid.y_um / count)


def half_width_um(footprint: np.ndarray, grid: HeightMap) -> float:
    """Return half the footprint's extent, the mean over x and y, µm."""
    extents = [
        (line[-1] - line[0] + 1) * pitch
        for line, pitch in ((np.flatnonzero(footprint.any(axis=a)), p) for a, p in ((0, grid.dx_um), (1, grid.dy_um)))
    ]
    return sum(extents) / 4


def pixel_of(grid: HeightMap, x_um: np.ndarray, y_um: np.ndarray) -> np.ndarray:
    """Return rows and columns, as numbers with fractions, of points given from the map's centre."""
    rows, cols = grid.shape
    return np.array([(rows - 1) / 2 - y_um / grid.dy_um, (cols - 1) / 2 + x_um / grid.dx_um])


def resampled(recording: HeightMap, x_um: np.ndarray, y_um: np.ndarray) -> np.ndarray:
    """Read a map at other points, locally; NaN next to gaps, around the map as high as at its rim."""
    known = ~np.isnan(recording.heights_um)
    place = pixel_of(recording, x_um, y_um)
    read = read_locally(nearest(recording.heights_um, known), place, pixels=6)
    if known.all():
        return read
    return np.where(ndimage.map_coordinates(1.0 * known, place, order=1, mode="nearest") >= 0.5, read, np.nan)

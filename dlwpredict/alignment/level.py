"""Tilt and zero of height: a plane through the substrate, or on the difference to the target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from dlwpredict.alignment.plane import plane_columns, robust_fit
from dlwpredict.alignment.uncertainty import layouts, widest_covariance
from dlwpredict.heightmap import HeightMap, HeightReference

FLANK_UM = 1.5  # three default exposure FWHMs: farther out the print's flank has ended
LEAST_POINTS = 50
MOST_LEVERAGE = 30.0


@dataclass(frozen=True)
class Plane:
    """Plane a + b·x + c·y in the target's frame with its covariance, and what it was fitted to."""

    coefficients: np.ndarray
    covariance: np.ndarray
    reference: HeightReference
    gain: float

    def at(self, x_um: np.ndarray, y_um: np.ndarray) -> np.ndarray:
        """Height of the plane, µm."""
        a, b, c = self.coefficients
        return a + b * x_um + c * y_um


def substrate(target: HeightMap, margin_um: float) -> np.ndarray:
    """Mark where nothing was written and no flank reaches: target 0, ``margin_um`` or more from the part.

    Examples
    --------
    >>> row = HeightMap(np.tile([0.0, 0, 0, 0, 1, 1], (2, 1)), dx_um=1.0, dy_um=1.0)
    >>> substrate(row, 2.0)[0].tolist()
    [True, True, True, False, False, False]
    """
    heights = target.heights_um
    empty = np.abs(heights) <= 1e-3 * max(np.nanmax(np.abs(heights)), 1e-12)
    if not empty.any() or empty.all():
        return empty
    distance = ndimage.distance_transform_edt(empty, sampling=(target.dy_um, target.dx_um))
    return distance >= margin_um


def find_plane(aligned: HeightMap, target: HeightMap, margin_um: float) -> Plane:
    """Fit the plane that levels a recording on its target's grid.

    On the substrate where it is in view and holds the whole part, i.e. where the plane's leverage over the target stays
    below 30 (its standard error there at most √30 ≈ 5 times that of a mean). Else a + b·x + c·y + gain·target is
    fitted to everything measured and the plane part returned: "relative". Both by Tukey's weights; nothing but a
    plane is ever taken out, so bends and domes of the print stay.
    """
    x, y = np.meshgrid(target.x_um, target.y_um)
    measured = aligned.measured & ~np.isnan(target.heights_um)
    bare = measured & substrate(target, margin_um)
    reference: HeightReference
    if bare.sum() >= LEAST_POINTS and _leverage(x, y, bare) <= MOST_LEVERAGE:
        columns, use, reference = plane_columns(x[bare], y[bare]), bare, "substrate"
    else:
        columns = np.column_stack([plane_columns(x[measured], y[measured]), target.heights_um[measured]])
        use, reference = measured, "relative"
    values = aligned.heights_um[use]
    coefficients, weights = robust_fit(columns, values)
    blocks = [layout[use.ravel()] for layout in layouts(target.shape)]
    covariance, _ = widest_covariance(columns, weights, values - columns @ coefficients, blocks)
    gain = _gain(aligned, target, measured) if reference == "substrate" else float(coefficients[3])
    return Plane(coefficients[:3], covariance[:3, :3], reference, gain)


def _leverage(x: np.ndarray, y: np.ndarray, bare: np.ndarray) -> float:
    columns = plane_columns(x[bare], y[bare])
    normal = columns.T @ columns / len(columns)
    if np.linalg.matrix_rank(normal, hermitian=True) < 3:
        return np.inf
    corners = plane_columns(x[[0, 0, -1, -1], [0, -1, 0, -1]], y[[0, 0, -1, -1], [0, -1, 0, -1]])
    return float(np.max(np.sum(corners @ np.linalg.inv(normal) * corners, axis=1)))


def _gain(aligned: HeightMap, target: HeightMap, measured: np.ndarray) -> float:
    x, y = np.meshgrid(target.x_um, target.y_um)
    columns = np.column_stack([plane_columns(x[measured], y[measured]), target.heights_um[measured]])
    return float(np.linalg.lstsq(columns, aligned.heights_um[measured], rcond=None)[0][3])

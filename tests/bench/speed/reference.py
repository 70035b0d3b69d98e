"""The paper's chain as one would write it down with SciPy: a 3-D grid, `gaussian_filter`, nothing else.

Imports nothing of the program. Single precision; 2048² pixels and 165 slices take 7 GB.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

TRUNCATE = 4.0
"""SciPy's default end of a kernel, in standard deviations."""

FWHM_PER_SIGMA = 2 * np.sqrt(2 * np.log(2))


def predict(heights_um: np.ndarray, pitch_um: float, slice_um: float, paper) -> np.ndarray:
    """Return the printed heights, µm, shape (rows, cols).

    Parameters
    ----------
    heights_um : numpy.ndarray, shape (rows, cols)
        With room of empty resin around the part.
    pitch_um, slice_um : float
        Sides of a voxel.
    paper : object with the paper's seven parameters
    """
    focus, crosslink = (
        (z / FWHM_PER_SIGMA / slice_um, *2 * [xy / FWHM_PER_SIGMA / pitch_um])
        for z, xy in (
            (paper.exposure_fwhm_z_um, paper.exposure_fwhm_xy_um),
            (paper.crosslink_fwhm_z_um, paper.crosslink_fwhm_xy_um),
        )
    )
    glass = int(TRUNCATE * focus[0] + 0.5)  # slices: writing starts inside the glass
    above = int(np.ceil(heights_um.max() / slice_um)) + glass
    z = (np.arange(-glass, above) + 0.5) * slice_um
    solid = ((z[:, None, None] < heights_um) & (heights_um > 0)).astype(np.float32)
    exposed = gaussian_filter(solid, focus, mode="constant", truncate=TRUNCATE)[glass:] >= paper.threshold
    del solid
    m_cl = gaussian_filter(exposed.astype(np.float32), crosslink, mode="constant", truncate=TRUNCATE)
    count = exposed.sum(axis=0)
    mean = np.sum(m_cl, axis=0, where=exposed) / np.maximum(count, 1) / m_cl.max()
    return (paper.shrinkage_min + (paper.shrinkage_max - paper.shrinkage_min) * mean) * count * slice_um

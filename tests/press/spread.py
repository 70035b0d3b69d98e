"""A Gaussian neighbourhood of what is written."""

import numpy as np
from scipy.special import ndtr

from tests.press.focus import Lobe, axial_weights
from tests.press.gauss import SIGMA_PER_FWHM, along_z, lateral


def spread(scene, fwhm_um, *, below):
    """Return G_fwhm * written in every voxel; with `below` the written columns continue into the glass."""
    s = fwhm_um * SIGMA_PER_FWHM
    grid = scene.grid
    weights, rest = axial_weights(Lobe(s, s, lambda u: ndtr(u / s)), grid.z, grid.dz)
    stack = along_z(scene.fill if below else scene.written, weights)
    if below:
        stack += rest[:, None, None].astype(np.float32) * scene.fill[:1]
    return lateral(stack, s, s, grid)

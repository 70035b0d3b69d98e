"""Dose proximity: neighbouring voxels add background dose, without a preferred direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.effects.base import DoseEffect
from dlwpredict.effects.plane import gaussian_um, up_to_surface
from dlwpredict.heightmap import HeightMap
from dlwpredict.model.states import Dose
from dlwpredict.numerics.normal import ndtr
from dlwpredict.numerics.smoothing import FWHM_PER_SIGMA
from dlwpredict.parameters import declare


def neighbourhood(written: HeightMap, z_um: float | np.ndarray, fwhm_um: float) -> np.ndarray:
    """Return the share of written resin around each point, G ⊛ occupancy in three dimensions, 0–1.

    Of shape (rows, cols), or (n, rows, cols) for heights of shape (n, 1, 1).

    A column is written for 0 ≤ z′ < h, so along z the Gaussian gives Φ((h − z)/s) − Φ(−z/s). The glass adds nothing:
    scattered light, heat and radicals come from resin, which begins at z = 0. Waller & von Freymann, Polymers 8, 297
    (2016); Lang et al. 2022 name proximity.

    Parameters
    ----------
    written : HeightMap
    z_um : float, or numpy.ndarray of shape (n, 1, 1)
        Height of the layer.
    fwhm_um : float
        FWHM of the neighbourhood, along all three axes.
    """
    sigma = fwhm_um / FWHM_PER_SIGMA
    below = ndtr(np.asarray(-z_um / sigma, dtype=np.float32)) * (written.heights_um > 0)
    return gaussian_um(up_to_surface(written, z_um, sigma) - below, written, fwhm_um)


@dataclass(frozen=True)
class DoseProximity(DoseEffect):
    """D = 1 + gain · (share of written resin around)."""

    name = "dose-proximity"
    meaning = "neighbouring structure adds background dose: dense and tall regions grow, edges stay low"
    frame = "sample"
    source = "Lang 2022 (named there); Waller & von Freymann, Polymers 8, 297 (2016)"
    confused_with = ("psf-wings", "edge-inhibition", "edge-drying")
    separated_by = "isolated features against dense arrays, or footprints of 10 to 100 µm"

    gain: float = declare(0.0, "1", 0.0, 0.5, "additional intensity deep inside a large part", typical=0.1)
    fwhm_um: float = declare(10.0, "µm", 1, 60, "width of the neighbourhood that counts")

    def act(self, state: Dose) -> Dose:
        """Return the dose with this background: it reaches the resin, wherever the focus is."""
        return self.added(state, background=self.intensity)

    def intensity(self, written: HeightMap, z_um: float | np.ndarray) -> np.ndarray:
        """Return D at height z."""
        return 1 + self.gain * neighbourhood(written, z_um, self.fwhm_um)

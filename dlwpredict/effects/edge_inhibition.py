"""Edge inhibition: fresh oxygen from unexposed resin raises the threshold near every free surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.effects.base import ThresholdEffect
from dlwpredict.effects.plane import gaussian_um, up_to_surface
from dlwpredict.heightmap import HeightMap
from dlwpredict.numerics.smoothing import FWHM_PER_SIGMA
from dlwpredict.parameters import declare


def unexposed_share(written: HeightMap, z_um: float | np.ndarray, fwhm_um: float) -> np.ndarray:
    """Return the share of unexposed resin around each point, 1 − G ⊛ occupancy in three dimensions.

    Of shape (rows, cols), or (n, rows, cols) for heights of shape (n, 1, 1).

    Oxygen diffuses in from where resin stays unexposed, the top included. The glass holds none: below z = 0 counts as
    occupied under the part, so along z the Gaussian gives Φ((h − z)/s).

    Parameters
    ----------
    written : HeightMap
    z_um : float, or numpy.ndarray of shape (n, 1, 1)
        Height of the layer.
    fwhm_um : float
        FWHM of the diffusion, along all three axes.
    """
    column = up_to_surface(written, z_um, fwhm_um / FWHM_PER_SIGMA)
    return 1 - gaussian_um(column, written, fwhm_um)


@dataclass(frozen=True)
class EdgeInhibition(ThresholdEffect):
    """P → P · (1 + gain · (share of unexposed resin around))."""

    name = "edge-inhibition"
    meaning = "oxygen from unexposed resin inhibits polymerisation near edges: edges, corners and tops come out low"
    frame = "sample"
    source = "inhibition kinetics (Mueller et al., Adv. Mater. 2014); form of the Gaussian is ours"
    confused_with = ("psf-wings", "dose-proximity", "edge-drying")
    separated_by = "features of 1 to 20 µm on one print, or a dose series"

    gain: float = declare(0.0, "1", 0.0, 0.8, "relative rise of the threshold in unexposed surroundings", typical=0.1)
    fwhm_um: float = declare(3.0, "µm", 0.3, 20, "width over which oxygen diffuses in")

    def factor(self, written: HeightMap, z_um: float | np.ndarray) -> np.ndarray:
        """Return the factor on P at height z."""
        return 1 + self.gain * unexposed_share(written, z_um, self.fwhm_um)

"""Dose proximity: neighbouring voxels add dose. D = 1 + gain (G_fwhm * written), in three dimensions.

Nothing is written in the glass, so resin at the substrate has neighbours on one side only; `below_substrate: true` lets
the solid continue there, as it does for the exposure.
"""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect
from tests.press.spread import spread


@effect("dose-proximity")
@dataclass(frozen=True)
class DoseProximity(PrintEffect):
    """Gain without unit, FWHM in um."""

    gain: float = 0.0
    fwhm_um: float = 10.0
    conversion: float | None = None
    below_substrate: bool = False

    def dose(self, scene):
        if self.gain == 0:
            return None
        return np.float32(1) + np.float32(self.gain) * spread(scene, self.fwhm_um, below=self.below_substrate)

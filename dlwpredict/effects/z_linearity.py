"""Z linearity: the microscope's height scale is bent, or has a periodic error."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dlwpredict.effects.base import MapEffect
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import declare


def scale_error(
    heights_um: np.ndarray, quadratic_um: float, periodic_um: float, period_um: float, phase_rad: float
) -> np.ndarray:
    """Return quadratic · ((t − t₀)/Z)² + periodic · sin(2πt/period + phase), µm.

    t₀ is the mean of the recording and Z half of its range: a scale is set by what is in view. The linearity deviation
    l_z of ISO 25178-600.

    Parameters
    ----------
    heights_um : numpy.ndarray
        Recording, NaN where not measured.
    quadratic_um, periodic_um : float
    period_um, phase_rad : float
    """
    low, high = np.nanmin(heights_um), np.nanmax(heights_um)
    share = (heights_um - np.nanmean(heights_um)) / max((high - low) / 2, 1e-9)
    return quadratic_um * share**2 + periodic_um * np.sin(2 * np.pi * heights_um / period_um + phase_rad)


@dataclass(frozen=True)
class ZLinearity(MapEffect):
    """The height read depends on the height alone, but not linearly."""

    name = "z-linearity"
    meaning = "the microscope's height scale is bent or has a periodic error"
    side = "measurement"
    frame = "instrument"
    stage = "recording"
    source = "ISO 25178-600, linearity deviation l_z; ranges are ours"
    confused_with = ("z-drift", "shrinkage-nonlinearity", "power-drift")
    separated_by = "certified steps, or the sample moved in z by half a period under the microscope"

    quadratic_um: float = declare(
        0.0, "µm", -1, 1, "deviation half the range of heights away from their mean", typical=0.05
    )
    periodic_um: float = declare(0.0, "µm", 0.0, 0.5, "amplitude of the periodic error", typical=0.05)
    period_um: float = declare(3.0, "µm", 0.2, 50, "its period in height")
    phase_rad: float = declare(0.0, "rad", -np.pi, np.pi, "its phase at height 0", cyclic=True)

    def elsewhere(self) -> ZLinearity:
        """Turn the phase from one end of its range to the other."""
        return replace(self, phase_rad=-self.phase_rad) if abs(self.phase_rad) == np.pi else self

    def heights(self, state: HeightMap) -> np.ndarray:
        """Return the recording with its scale error."""
        t = state.heights_um
        return t + scale_error(t, self.quadratic_um, self.periodic_um, self.period_um, self.phase_rad)

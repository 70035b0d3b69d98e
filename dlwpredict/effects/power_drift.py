"""Power drift: the laser power changes while the part is written, layer after layer."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from dlwpredict.effects.base import DoseEffect
from dlwpredict.heightmap import HeightMap
from dlwpredict.model.states import Dose
from dlwpredict.parameters import declare


@dataclass(frozen=True)
class PowerDrift(DoseEffect):
    """D = 1 + drift · z/h_max: layers are written in order, so time is height."""

    name = "power-drift"
    meaning = "the laser power changes during the print: upper layers get more (or less) dose"
    frame = "printer"
    source = "general knowledge; a power log shows it"
    confused_with = ("interface-offset", "z-drift", "spherical-aberration")
    separated_by = "a twin printed from the top layer down, marker pads written first and last, or a power log"

    drift: float = declare(
        0.0, "1", -0.25, 0.25, "change of intensity from the substrate to the highest layer", typical=0.03
    )

    def act(self, state: Dose) -> Dose:
        """Return the dose with the drift over the layers that are written, wherever D is asked for."""
        drift = partial(self.along, highest_um=state.written.heights_um.max())
        return self.added(state, intensity=drift)

    def along(self, written: HeightMap, z_um: float | np.ndarray, *, highest_um: float) -> float | np.ndarray:
        """Return D at height z, the same on the whole plane."""
        return 1 + self.drift * z_um / highest_um

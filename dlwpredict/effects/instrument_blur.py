"""Instrument blur: the microscope has a limited lateral resolution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.effects.base import MapEffect
from dlwpredict.effects.plane import blurred_recording
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import declare


@dataclass(frozen=True)
class InstrumentBlur(MapEffect):
    """t → G_fwhm ⊛ t over the measured points."""

    name = "instrument-blur"
    meaning = "limited resolution of the microscope: short periods are lost, edges look round"
    side = "measurement"
    frame = "instrument"
    stage = "recording"
    source = "ISO 25178-600, topographic spatial resolution W_R"
    confused_with = ("batwings", "astigmatism", "psf-wings")
    separated_by = "the same sample recorded with a second objective or an AFM"

    fwhm_um: float = declare(0.0, "µm", 0.0, 5.0, "FWHM of the instrument's lateral response", typical=1.0)

    def heights(self, state: HeightMap) -> np.ndarray:
        """Return the blurred recording."""
        return blurred_recording(state, self.fwhm_um)

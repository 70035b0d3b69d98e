"""Batwings: optical profilers overshoot on both sides of a steep edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from dlwpredict.effects.base import MapEffect
from dlwpredict.effects.plane import blurred_recording, slopes
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import declare


def steepness(slope_x: np.ndarray, slope_y: np.ndarray) -> np.ndarray:
    """Return s³²/(1 + s³²), s = |∇t|: 0 on gentle, 1 on steep ground, ½ at 45°; from 0.1 to 0.9 within 7 % of s = 1."""
    return special.expit(16 * np.log(np.maximum(slope_x**2 + slope_y**2, 1e-30)))


@dataclass(frozen=True)
class Batwings(MapEffect):
    """t → t + gain · (t − G_fwhm ⊛ t) where the slope exceeds 1.

    Light from both sides of an edge interferes. The border at slope 1 is softened, so that nothing jumps.
    """

    name = "batwings"
    meaning = "the microscope overshoots on both sides of steep edges"
    side = "measurement"
    frame = "instrument"
    stage = "recording"
    source = "Adv. Photonics Nexus 3, 016013; Opt. Express 20(18), 19936; form is ours"
    confused_with = ("instrument-blur", "line-end-pileup", "edge-drying")
    separated_by = "the same sample recorded with a second aperture or another kind of instrument"

    gain: float = declare(0.0, "1", 0.0, 2.0, "overshoot over the height lost by blurring", typical=0.3)
    fwhm_um: float = declare(1.5, "µm", 0.2, 10, "width of the overshoot")

    def heights(self, state: HeightMap) -> np.ndarray:
        """Return the recording with overshoot."""
        detail = state.heights_um - blurred_recording(state, self.fwhm_um)
        return state.heights_um + self.gain * steepness(*slopes(state)) * detail

"""Spherical aberration: with depth the focus gets longer, weaker and displaced."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dlwpredict.effects.base import DoseEffect
from dlwpredict.heightmap import HeightMap
from dlwpredict.model.states import Dose, depth_um
from dlwpredict.parameters import declare

LEAST = 0.05
"""No layer gets less than this share of the intensity."""


@dataclass(frozen=True)
class SphericalAberration(DoseEffect):
    """The indices of resin and immersion differ, and the error of the wavefront grows in proportion to the height z.

    FWHM_z(z) = FWHM_z · (1 + broadening · ẑ), D = 1 − loss · ẑ with ẑ = z · (z / 10 µm)^(power − 1), and the focus lies
    at z · (1 + focus_shift). Power 1 is the common description. Of a small error of the wavefront, length and intensity
    of the focus know only the square (Maréchal 1947), which is power 2; a large one comes nearer to 1.
    """

    name = "spherical-aberration"
    meaning = "index mismatch: with height the focus gets longer, weaker and displaced"
    frame = "printer"
    source = "gardner-lab/printimage (lists its compensation); ranges are ours"
    confused_with = ("power-drift", "interface-offset", "z-drift", "z-amplification")
    separated_by = "the same relief on bases of 3, 6, 12 and 24 µm with the substrate in view"

    broadening_per_um: float = declare(
        0.0, "1/µm", 0.0, 0.2, "relative growth of the axial FWHM per µm of height", typical=0.02
    )
    loss_per_um: float = declare(0.0, "1/µm", 0.0, 0.05, "loss of intensity per µm of height", typical=0.005)
    depth_power: float = declare(1.0, "1", 1.0, 2.0, "power of the height that broadening and loss grow with")
    focus_shift: float = declare(0.0, "1", -0.1, 0.1, "relative displacement of the focus along z", typical=0.01)

    def act(self, state: Dose) -> Dose:
        """Return the dose with longer, weaker and displaced foci."""
        if self.focus_shift:
            state = replace(
                state, written=state.written.with_heights(state.written.heights_um * (1 + self.focus_shift))
            )
        focus = tuple(
            replace(
                part,
                broadening_per_um=part.broadening_per_um + self.broadening_per_um,
                depth_power=self.depth_power,
            )
            for part in state.focus
        )
        state = replace(state, focus=focus)
        return super().act(state) if self.loss_per_um else state

    def intensity(self, written: HeightMap, z_um: float | np.ndarray) -> np.ndarray:
        """Return D = 1 − loss · ẑ, at least a twentieth, the same on the whole plane."""
        return np.maximum(1 - self.loss_per_um * depth_um(z_um, self.depth_power), LEAST)

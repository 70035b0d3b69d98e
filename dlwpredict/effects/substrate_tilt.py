"""Substrate tilt: the glass is not parallel to the printer's focal plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.effects.base import MapEffect
from dlwpredict.effects.plane import where_written
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import declare


@dataclass(frozen=True)
class SubstrateTilt(MapEffect):
    """h → max(h − tilt · (x, y), 0) where h > 0, x and y from the centre of the field."""

    name = "substrate-tilt"
    meaning = "the glass is tilted against the printer: the part is written as a wedge"
    frame = "printer"
    stage = "target"
    source = "Lang 2022 (removes a plane: fabrication and measurement are not parallel); general knowledge"
    confused_with = ("print-field-curvature", "dose-memory")
    separated_by = "the substrate in view, heights levelled on it"

    tilt_x_mrad: float = declare(0.0, "mrad", -20, 20, "rise of the glass along x", typical=5.0)
    tilt_y_mrad: float = declare(0.0, "mrad", -20, 20, "rise of the glass along y", typical=5.0)

    def heights(self, state: HeightMap) -> np.ndarray:
        """Return the heights written above the tilted glass."""
        glass = 1e-3 * (self.tilt_x_mrad * state.x_um + self.tilt_y_mrad * state.y_um[:, None])
        return where_written(state, state.heights_um - glass)

"""Field curvature: the microscope sees a flat surface bent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.effects.base import MapEffect
from dlwpredict.effects.plane import field_coordinates
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import declare


def reference_surface(x: np.ndarray, y: np.ndarray, sag_um: float, coma_um: tuple[float, float]) -> np.ndarray:
    """Return sag · ρ² + ρ² · (coma_x · x + coma_y · y), µm, shape (rows, cols).

    The flatness deviation z_FLT of ISO 25178-600 in its lowest two orders; a flat mirror shows it.

    Parameters
    ----------
    x, y : numpy.ndarray, shapes (cols,) and (rows, 1)
        Position from the centre of the instrument's field, in units of 50 µm.
    sag_um : float
        Deviation at 50 µm.
    coma_um : (float, float)
        Deviation at 50 µm towards +x and +y.
    """
    rho_squared = x**2 + y**2
    return rho_squared * (sag_um + coma_um[0] * x + coma_um[1] * y)


@dataclass(frozen=True)
class FieldCurvature(MapEffect):
    """t → t + the instrument's own form, the same on every sample."""

    name = "field-curvature"
    meaning = "the microscope shows every sample bent by the same smooth form"
    side = "measurement"
    frame = "instrument"
    stage = "recording"
    source = "ISO 25178-600, flatness deviation z_FLT"
    confused_with = ("vignetting", "print-field-curvature", "curl", "dose-memory")
    separated_by = "a recording of a flat mirror, or the part recorded away from the instrument's centre"

    sag_um: float = declare(0.0, "µm", -2, 2, "deviation at 50 µm from the centre", typical=0.1)
    coma_x_um: float = declare(0.0, "µm", -2, 2, "odd deviation at 50 µm towards +x", typical=0.1)
    coma_y_um: float = declare(0.0, "µm", -2, 2, "odd deviation at 50 µm towards +y", typical=0.1)
    centre_x_um: float = declare(0.0, "µm", -50, 50, "centre of the instrument's field, x from the map's centre")
    centre_y_um: float = declare(0.0, "µm", -50, 50, "centre of the instrument's field, y from the map's centre")

    def heights(self, state: HeightMap) -> np.ndarray:
        """Return the bent recording, substrate included."""
        x, y = field_coordinates(state, self.centre_x_um, self.centre_y_um)
        return state.heights_um + reference_surface(x, y, self.sag_um, (self.coma_x_um, self.coma_y_um))

"""Print-field curvature: the printer focuses onto a bent or tilted surface, and every field is written bent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.effects.base import MapEffect
from dlwpredict.effects.plane import FIELD_RADIUS_UM, field_coordinates, where_written
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import declare


def focal_surface(x: np.ndarray, y: np.ndarray, sag_um: float, tilt_mrad: tuple[float, float]) -> np.ndarray:
    """Return the height of the focal surface, sag · ρ² + tilt · (x, y), µm, shape (rows, cols).

    Ellingen et al., J. Opt. Microsyst. 3, 043501 (2023): curvature and tilt of a commercial writer.

    Parameters
    ----------
    x, y : numpy.ndarray, shapes (cols,) and (rows, 1)
        Position from the field's centre, in units of 50 µm.
    sag_um : float
        Rise at 50 µm.
    tilt_mrad : (float, float)
        Slope along x and y.
    """
    slope_x, slope_y = (1e-3 * FIELD_RADIUS_UM * t for t in tilt_mrad)
    return sag_um * (x**2 + y**2) + slope_x * x + slope_y * y


@dataclass(frozen=True)
class PrintFieldCurvature(MapEffect):
    """The part is written on a bent focal surface; what would lie below the substrate is lost."""

    name = "print-field-curvature"
    meaning = "the printer focuses onto a bent or tilted surface, so each field is written bent"
    frame = "printer"
    stage = "target"
    source = "Ellingen et al., J. Opt. Microsyst. 3(4), 043501 (2023)"
    confused_with = ("vignetting", "field-curvature", "curl", "substrate-tilt")
    separated_by = "several fields side by side (the bend repeats in each), heights referenced to the substrate"

    sag_um: float = declare(0.0, "µm", -2, 2, "rise of the focal surface at 50 µm from the centre", typical=0.1)
    tilt_x_mrad: float = declare(0.0, "mrad", -20, 20, "rise of the focal surface along x", typical=2.0)
    tilt_y_mrad: float = declare(0.0, "mrad", -20, 20, "rise of the focal surface along y", typical=2.0)
    centre_x_um: float = declare(0.0, "µm", -50, 50, "centre of the printer's field, x from the map's centre")
    centre_y_um: float = declare(0.0, "µm", -50, 50, "centre of the printer's field, y from the map's centre")

    def heights(self, state: HeightMap) -> np.ndarray:
        """Return the heights written, h + focal surface, ≥ 0, only where h > 0."""
        x, y = field_coordinates(state, self.centre_x_um, self.centre_y_um)
        bend = focal_surface(x, y, self.sag_um, (self.tilt_x_mrad, self.tilt_y_mrad))
        return where_written(state, state.heights_um + bend)

"""Vignetting: the focus is weaker away from the centre of the printer's field."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.effects.base import DoseEffect
from dlwpredict.effects.plane import field_coordinates
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import declare


def field_intensity(x: np.ndarray, y: np.ndarray, strength: float) -> np.ndarray:
    """Return D = 1 − strength · ρ², ρ² = x² + y².

    Clipping of the pupil and aberration of the scan lens weaken the focus off axis; to second order in the field
    radius both are this parabola (cos⁴ too). Named in Lang et al. 2022.

    Parameters
    ----------
    x, y : numpy.ndarray, shapes (cols,) and (rows, 1)
        Position from the field's centre, in units of 50 µm.
    strength : float
        Loss of intensity at 50 µm.
    """
    return 1 - strength * (x**2 + y**2)


@dataclass(frozen=True)
class Vignetting(DoseEffect):
    """Focus intensity falls with the field radius."""

    name = "vignetting"
    meaning = "the laser focus is weaker away from the centre of the printer's field"
    frame = "printer"
    source = "Lang 2022 (named there); compensated with a cos^4 fit in gardner-lab/printimage"
    confused_with = ("print-field-curvature", "field-curvature", "curl")
    separated_by = (
        "pads of two heights over the whole field, each recorded at the instrument's centre with the substrate in view"
    )

    strength: float = declare(0.0, "1", 0.0, 0.3, "loss of intensity at 50 µm from the centre", typical=0.05)
    centre_x_um: float = declare(0.0, "µm", -50, 50, "centre of the printer's field, x from the map's centre")
    centre_y_um: float = declare(0.0, "µm", -50, 50, "centre of the printer's field, y from the map's centre")

    def intensity(self, written: HeightMap, z_um: float | np.ndarray) -> np.ndarray:
        """Return D, the same at every height."""
        return field_intensity(*field_coordinates(written, self.centre_x_um, self.centre_y_um), self.strength)

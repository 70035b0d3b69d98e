"""Flatness deviation of the instrument: t + sag rho^2 + (coma_x cos + coma_y sin) rho^3, rho = radius / 50 um."""

from dataclasses import dataclass

from tests.press.effect import MeasureEffect, effect
from tests.press.grid import FIELD_RADIUS_UM


@effect("field-curvature")
@dataclass(frozen=True)
class FieldCurvature(MeasureEffect):
    """Sag and coma in um at 50 um radius, centre in um from the recording's centre."""

    stage = 60
    sag_um: float = 0.0
    coma_x_um: float = 0.0
    coma_y_um: float = 0.0
    centre_x_um: float = 0.0
    centre_y_um: float = 0.0

    def record(self, heights, grid):
        square = grid.radius(self.centre_x_um, self.centre_y_um) ** 2
        x, y = (grid.x[None, :] - self.centre_x_um), (grid.y[:, None] - self.centre_y_um)
        lever = (self.coma_x_um * x + self.coma_y_um * y) / FIELD_RADIUS_UM
        return heights + square * (self.sag_um + lever)

"""Lateral resolution of the instrument: t -> G_fwhm * t."""

from dataclasses import dataclass

from tests.press.effect import MeasureEffect, effect
from tests.press.gauss import SIGMA_PER_FWHM, on_map


@effect("instrument-blur")
@dataclass(frozen=True)
class InstrumentBlur(MeasureEffect):
    """FWHM in um."""

    stage = 10
    fwhm_um: float = 0.0

    def record(self, heights, grid):
        return on_map(heights, self.fwhm_um * SIGMA_PER_FWHM, grid) if self.fwhm_um > 0 else heights

"""Astigmatism: the lateral widths are e^(+q) and e^(-q) times nominal along two axes turned by an angle."""

from dataclasses import dataclass, replace

import numpy as np

from tests.press.effect import PrintEffect, effect


@effect("astigmatism")
@dataclass(frozen=True)
class Astigmatism(PrintEffect):
    """log_ratio q without unit; angle_deg from x to the e^(+q) axis, counter-clockwise."""

    log_ratio: float = 0.0
    angle_deg: float = 0.0

    def lobes(self, lobes):
        if self.log_ratio == 0:
            return lobes
        wide, narrow = np.exp(self.log_ratio), np.exp(-self.log_ratio)
        return [
            replace(lobe, s_x_um=lobe.s_x_um * wide, s_y_um=lobe.s_y_um * narrow, angle_deg=self.angle_deg)
            for lobe in lobes
        ]

"""Vignetting: the focus is weaker away from the field centre.

literal: D = 1 - strength rho^2, rho the distance to the centre / 50 um.
pupil:   two apertures, the beam (Gaussian, waist `fill` of the pupil radius) walks off the second by an amount
         proportional to rho; D = (overlap of the amplitude)^2, with D = 1 - strength at rho = 1.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from tests.press.effect import PrintEffect, effect

WEAKEST = 0.05


@effect("vignetting")
@dataclass(frozen=True)
class Vignetting(PrintEffect):
    """Strength without unit at 50 um; centre in um."""

    strength: float = 0.0
    centre_x_um: float = 0.0
    centre_y_um: float = 0.0
    conversion: float | None = None
    model: str = "literal"  # or pupil
    fill: float = 0.8

    def dose(self, scene):
        radius = scene.grid.radius(self.centre_x_um, self.centre_y_um)
        if self.model == "pupil" and self.strength > 0:
            return through_pupil(radius, self.strength, self.fill)[None]
        return np.maximum(1 - self.strength * radius**2, WEAKEST)[None]


def overlap(walk, fill, count=161):
    """Return the share of focal intensity when the beam walks `walk` pupil radii off a second aperture."""
    u = np.linspace(-1, 1, count)
    amplitude = np.exp(-(u[None, :] ** 2 + u[:, None] ** 2) / fill**2) * (np.hypot(u[None, :], u[:, None]) <= 1)
    rim = np.hypot(u[None, :] - walk, u[:, None])
    passed = np.clip((1 - rim) * count / 2 + 0.5, 0, 1)
    centred = np.clip((1 - np.hypot(u[None, :], u[:, None])) * count / 2 + 0.5, 0, 1)
    return float(((amplitude * passed).sum() / (amplitude * centred).sum()) ** 2)


def through_pupil(radius, strength, fill):
    """Return D at a radius in units of 50 um."""
    walk = brentq(lambda value: overlap(value, fill) - (1 - min(strength, 0.9)), 0, 1.9)
    nodes = np.linspace(0, max(radius.max(), 1e-6), 60)
    return np.maximum(np.interp(radius, nodes, [overlap(walk * node, fill) for node in nodes]), WEAKEST)

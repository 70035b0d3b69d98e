"""Misregistration: the microscope's picture is displaced, turned, scaled or sheared against the target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.effects.base import MapEffect
from dlwpredict.effects.plane import resampled
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import declare


def mapping(rotation_deg: float, scale: tuple[float, float], shear_mrad: float) -> np.ndarray:
    """Return the matrix R(rotation) · diag(scale) · [[1, shear], [0, 1]], shape (2, 2).

    The point (x, y) of the target, from its centre, y up, is recorded at shift + matrix · (x, y): the pose of
    align.yaml, with a shear first. Rotation is counter-clockwise.
    """
    angle = np.deg2rad(rotation_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return turn @ np.diag(scale) @ np.array([[1, 1e-3 * shear_mrad], [0, 1]])


@dataclass(frozen=True)
class Misregistration(MapEffect):
    """Recorded(shift + A·p) = t(p)."""

    name = "misregistration"
    meaning = "the recording is displaced, turned, scaled or sheared against the target"
    side = "measurement"
    frame = "instrument"
    stage = "recording"
    source = "ISO 25178-600, lateral mapping deviations"
    confused_with = ("galvo-lag", "lateral-shrinkage")
    separated_by = "fiducial marks on the substrate, and the certificate of the instrument's lateral scale"
    isotropic = False

    shift_x_um: float = declare(0.0, "µm", -5, 5, "displacement along x", typical=0.1)
    shift_y_um: float = declare(0.0, "µm", -5, 5, "displacement along y", typical=0.1)
    rotation_deg: float = declare(0.0, "°", -5, 5, "rotation, counter-clockwise", typical=0.1)
    scale_x: float = declare(1.0, "1", 0.9, 1.1, "magnification along x", typical=1.005)
    scale_y: float = declare(1.0, "1", 0.9, 1.1, "magnification along y", typical=1.005)
    shear_mrad: float = declare(0.0, "mrad", -50, 50, "shear, displacement along +x per y", typical=2.0)

    def heights(self, state: HeightMap) -> np.ndarray:
        """Return the recording read where the instrument put it."""
        back = np.linalg.inv(mapping(self.rotation_deg, (self.scale_x, self.scale_y), self.shear_mrad))
        x, y = np.meshgrid(state.x_um - self.shift_x_um, state.y_um - self.shift_y_um)
        return resampled(state, back[0, 0] * x + back[0, 1] * y, back[1, 0] * x + back[1, 1] * y)

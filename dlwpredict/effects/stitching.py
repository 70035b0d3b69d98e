"""Stitching: blocks written one after the other do not join perfectly."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from dlwpredict.effects.base import DoseEffect
from dlwpredict.effects.plane import nearest, pixel_of, where_written
from dlwpredict.heightmap import HeightMap
from dlwpredict.model.states import Dose
from dlwpredict.parameters import declare


def across(grid: HeightMap, angle_deg: float, seam_um: float) -> np.ndarray:
    """Return the distance from the seam, positive behind it, µm, shape (rows, cols)."""
    angle = np.deg2rad(angle_deg)
    return np.cos(angle) * grid.x_um + np.sin(angle) * grid.y_um[:, None] - seam_um


def shifted(target: HeightMap, shift_x_um: float, shift_y_um: float) -> np.ndarray:
    """Return the heights displaced sideways, µm; the footprint moves by whole pixels.

    Heights are interpolated from written points alone: a wall smeared over a pixel would be written as a lower column.
    """
    footprint = target.heights_um > 0
    place = pixel_of(target, *np.meshgrid(target.x_um - shift_x_um, target.y_um - shift_y_um))
    relief = ndimage.map_coordinates(nearest(target.heights_um, footprint), place, order=3, mode="nearest")
    written = ndimage.map_coordinates(footprint, place, order=0, mode="constant")
    return np.where(written, np.maximum(relief, 0), 0)


@dataclass(frozen=True)
class Stitching(DoseEffect):
    """Every second block is displaced, and a strip along each seam is written twice, D = 1 + overlap.

    A pixel that a seam cuts has step and shift with the part of it that lies behind.
    """

    name = "stitching"
    meaning = "blocks written one after the other join with a step, a shift or a double-exposed strip"
    frame = "printer"
    source = "general knowledge; fields that repeat tilt and curvature: Ellingen et al. 2023"
    separated_by = "two heights across one seam (a dose step grows with the focus, a height step does not change)"
    confused_with = ("substrate-tilt",)
    isotropic = False

    step_um: float = declare(0.0, "µm", -1, 1, "height of the blocks behind a seam over those before it", typical=0.1)
    shift_x_um: float = declare(0.0, "µm", -1, 1, "sideways displacement of these blocks along x", typical=0.1)
    shift_y_um: float = declare(0.0, "µm", -1, 1, "sideways displacement of these blocks along y", typical=0.1)
    overlap: float = declare(0.0, "1", 0.0, 1.0, "additional intensity in the strip along a seam", typical=0.03)
    width_um: float = declare(1.0, "µm", 0.1, 10, "width of the strip")
    seam_um: float = declare(0.0, "µm", -1000, 1000, "position of a seam from the map's centre", fitted=False)
    period_um: float = declare(0.0, "µm", 0.0, 1000, "distance of the seams; 0 = a single one", fitted=False)
    angle_deg: float = declare(
        0.0, "°", -180, 180, "direction across the seams, counter-clockwise from x (0: seams run along y)", fitted=False
    )

    def act(self, state: Dose) -> Dose:
        """Return the dose with blocks displaced and seams exposed twice."""
        state = replace(state, written=state.written.with_heights(self._displaced(state.written)))
        return super().act(state) if self.overlap else state

    def _displaced(self, target: HeightMap) -> np.ndarray:
        distance, pixel = across(target, self.angle_deg, self.seam_um), self._pixel_um(target)
        if self.period_um:
            # to the nearer end of the block, positive in every second one
            half = self.period_um / 2
            distance = half - np.abs((distance + half) % (4 * half) - 2 * half)
        behind = np.clip(distance / pixel + 0.5, 0, 1)
        heights = target.heights_um
        if self.shift_x_um or self.shift_y_um:
            there = shifted(target, self.shift_x_um, self.shift_y_um)
            both = (there > 0) & (heights > 0)
            heights = np.where(both, heights + behind * (there - heights), np.where(behind >= 0.5, there, heights))
        moved = target.with_heights(heights)
        return where_written(moved, heights + self.step_um * behind)

    def intensity(self, written: HeightMap, z_um: float | np.ndarray) -> np.ndarray:
        """Return D, 1 + overlap in the strips; a pixel counts with the part of it that lies inside."""
        distance = across(written, self.angle_deg, self.seam_um)
        if self.period_um:
            distance = (distance + self.period_um / 2) % self.period_um - self.period_um / 2
        pixel = self._pixel_um(written)
        upper = np.minimum(distance + pixel / 2, self.width_um / 2)
        lower = np.maximum(distance - pixel / 2, -self.width_um / 2)
        return 1 + self.overlap * np.maximum(upper - lower, 0) / pixel

    def _pixel_um(self, grid: HeightMap) -> float:
        """Return the extent of a pixel across the seam, µm."""
        angle = np.deg2rad(self.angle_deg)
        return abs(np.cos(angle)) * grid.dx_um + abs(np.sin(angle)) * grid.dy_um

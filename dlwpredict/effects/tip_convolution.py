"""Tip convolution: a probe touches beside the place that it stands over, and records its own shape."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from dlwpredict.effects.base import MapEffect
from dlwpredict.effects.plane import own_slope
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import declare

NEAR_PX = 4
"""A cone is built up from cones of so many pixels: 0.8 % too steep in the worst direction."""


def uphill(heights: np.ndarray, pitch_um: float, axis: int) -> np.ndarray:
    """Return the slope at every pixel towards its higher side along an axis, 0 on a top and in front of a gap.

    It is the size of the central slope; where the slope changes as at a wall (`own_slope`), that of the higher side, so
    that the foot of a wall has the wall's slope and its upper edge none.
    """
    line = np.moveaxis(heights, axis, 0)
    around = np.pad(line, [(1, 1), *[(0, 0)] * (line.ndim - 1)], mode="edge")
    before, after = (np.where(np.isnan(side), line, side) for side in (around[:-2], around[2:]))
    central, bend = (after - before) / 2, before - 2 * line + after
    slope = own_slope(bend, pitch_um)
    return np.moveaxis(np.maximum(np.maximum(central + slope, slope - central), 0) / pitch_um, 0, axis)


def touched_by_ball(heights: np.ndarray, dx_um: float, dy_um: float, radius_um: float) -> np.ndarray:
    """Return where a ball's lowest point stands while it touches, t + R·(√(1 + |∇t|²) − 1), µm.

    Exact on a plane; no higher than the highest point within the radius.
    """
    steepness = np.hypot(uphill(heights, dx_um, 1), uphill(heights, dy_um, 0))
    raised = heights + radius_um * (np.sqrt(1 + steepness**2) - 1)
    reach = [int(np.ceil(radius_um / pitch)) for pitch in (dy_um, dx_um)]
    around = product(*(range(-r, r + 1) for r in reach))
    highest = np.fmax.reduce([_moved(heights, *step) for step in around])
    return np.minimum(raised, np.maximum(highest, heights))


def touched_by_cone(heights: np.ndarray, dx_um: float, dy_um: float, half_angle_deg: float) -> np.ndarray:
    """Return the lowest surface above the heights that is nowhere steeper than the flank of a cone, µm."""
    slope = 1 / np.tan(np.deg2rad(half_angle_deg))
    steps = range(-NEAR_PX, NEAR_PX + 1)
    around = [step for step in product(steps, steps) if 0 < np.hypot(*step) < NEAR_PX + 0.5]
    flank = {(r, c): slope * np.hypot(r * dy_um, c * dx_um) for r, c in around}
    tallest = np.nanmax(heights, initial=0.0) - np.nanmin(heights, initial=0.0)
    flank = {step: drop for step, drop in flank.items() if drop < tallest}
    above, rising = heights, bool(flank)
    while rising:
        last = above
        for step, drop in flank.items():
            above = np.fmax(above, _moved(last, *step) - drop)
        rising = bool((above > last + 1e-9).any())
    return above


def _moved(plane: np.ndarray, rows: int, cols: int) -> np.ndarray:
    """Return what stands so many pixels away, NaN beyond the map."""
    out = np.full(plane.shape, np.nan)
    (to_r, from_r), (to_c, from_c) = (
        (slice(max(-k, 0), n - max(k, 0)), slice(max(k, 0), n - max(-k, 0)))
        for k, n in zip((rows, cols), plane.shape, strict=True)
    )
    if abs(rows) < plane.shape[0] and abs(cols) < plane.shape[1]:
        out[to_r, to_c] = plane[from_r, from_c]
    return out


@dataclass(frozen=True)
class TipConvolution(MapEffect):
    """t → max over u of t(x − u) − s(u), the grey dilation by a tip s that is a cone with a ball at its end.

    s(u) = R − √(R² − u²) for u ≤ R·cos α, and beyond it, on the cone, (u − R·cos α)/tan α + R·(1 − sin α); all in µm.
    Such a tip is the sum of a ball and a sharp cone, so that dilation by it is that by the ball and then by the cone.
    On pixels wider than the ball the first is t + R·(√(1 + |∇t|²) − 1); the second makes a slope of cot α of every wall
    that is steeper. A needle, R = 0 and α = 0, shows what is there; each of them acts by itself. Points not measured
    stay so.
    """

    name = "tip-convolution"
    meaning = "the tip of the probe is blunt: it touches beside the place that it stands over"
    side = "measurement"
    frame = "instrument"
    stage = "recording"
    source = "grey dilation by the tip: Villarrubia, J. Res. NIST 102, 425 (1997); Keller, Surf. Sci. 253, 353 (1991)"
    confused_with = ("instrument-blur", "edge-drying")
    separated_by = "the same sample with a sharper tip, or with a microscope that does not touch it"

    radius_um: float = declare(0.0, "µm", 0.0, 0.5, "radius of the tip's end", typical=0.05)
    half_angle_deg: float = declare(
        0.0, "°", 0.0, 60.0, "angle of the tip's flank against its axis; 10 to 40 is usual", typical=20.0
    )

    def heights(self, state: HeightMap) -> np.ndarray:
        """Return the recording of a blunt tip."""
        missing, read = np.isnan(state.heights_um), state.heights_um
        if self.radius_um:
            read = touched_by_ball(read, state.dx_um, state.dy_um, self.radius_um)
        if self.half_angle_deg:
            read = touched_by_cone(read, state.dx_um, state.dy_um, self.half_angle_deg)
        return np.where(missing, np.nan, read)

"""How far the physics reaches: the halo that a tile needs, and what cannot be cut into tiles at all.

An effect whose formula asks for the structure as a whole (its highest layer, its centroid) is refused by name.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from dlwpredict.errors import InputError
from dlwpredict.heightmap import HeightMap
from dlwpredict.model.column_mean import coarse_factor
from dlwpredict.model.levels import Levels
from dlwpredict.numerics.smoothing import FWHM_PER_SIGMA, REACH_SIGMAS
from dlwpredict.numerics.trailing import LAG_REACH
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import run, steps

FADED = 8.0
"""An exponential that scales an effect of some per cent is let go after this many of its lengths, at 3e-4 of it."""


Reach = tuple[float, float]
"""Distance along y (rows) and along x (columns), µm."""


def _round(distance_um: float) -> Reach:
    return distance_um, distance_um


def _gaussian(fwhm_um: float) -> Reach:
    return _round(REACH_SIGMAS * fwhm_um / FWHM_PER_SIGMA)


REACH_UM: dict[str, Callable[[Any], Reach]] = {
    "dose-memory": lambda e: (0.0, FADED * e.length_um),
    "dose-proximity": lambda e: _gaussian(e.fwhm_um),
    "edge-drying": lambda e: _round(FADED * e.length_um),
    "edge-inhibition": lambda e: _gaussian(e.fwhm_um),
    "galvo-lag": lambda e: (LAG_REACH * e.lag_um * e.height_share, 0.0),
    "line-length-error": lambda e: (max(abs(e.start_um), abs(e.end_um)), 0.0),
    "line-end-pileup": lambda e: (FADED * e.length_um, 0.0),
    "batwings": lambda e: _gaussian(e.fwhm_um),
    "instrument-blur": lambda e: _gaussian(e.fwhm_um),
    "tip-convolution": lambda e: _round(e.radius_um),
}
"""Reach of the effects that look at their surroundings; every halo holds the next pixels, for slopes."""

LOCAL = (
    "astigmatism",
    "field-curvature",
    "interface-offset",
    "print-field-curvature",
    "psf-wings",
    "slope-error",
    "shrinkage-nonlinearity",
    "spherical-aberration",
    "stitching",
    "substrate-tilt",
    "vignetting",
    "z-amplification",
    "z-drift",
    "z-linearity",
)
"""Effects that act at a place by itself, or on the focus, whose own reach counts."""

WHOLE: dict[str, tuple[Callable[[Any], bool], str]] = {
    "curl": (lambda e: True, "bends the part about its centroid"),
    "lateral-shrinkage": (lambda e: True, "draws the part towards its centroid"),
    "misregistration": (lambda e: True, "turns and stretches the recording about its centre"),
    "power-drift": (lambda e: True, "counts from the highest layer of the part"),
    "slope-error": (lambda e: e.max_angle_deg < 90, "leaves gaps of any size with max_angle_deg below 90"),
    "stitching": (lambda e: bool(e.shift_x_um or e.shift_y_um), "moves whole blocks with shift_x_um and shift_y_um"),
    "tip-convolution": (lambda e: bool(e.half_angle_deg), "reaches as far as walls are high with half_angle_deg"),
    "z-linearity": (lambda e: bool(e.quadratic_um), "needs the whole range of heights with quadratic_um"),
}
"""Effects that need the whole map: under which settings, and why."""


WITH_CONVERSION = ("line-end-pileup", "shrinkage-nonlinearity")
"""Effects under which the largest cross-linking cannot be read off single windows once conversion follows the dose."""


def check_tileable(parameters: ParameterSet, *, as_measured: bool) -> None:
    """Refuse a process that cannot be predicted tile by tile.

    Raises
    ------
    InputError
        An effect, or a combination of settings, that needs the whole map.
    """
    active = _active(parameters, as_measured)
    normalised = parameters.readings.crosslink_reference == "structure_maximum"
    converts = normalised and any(getattr(effect, "conversion", 0) for effect in active)
    for effect in active:
        if converts and effect.name in WITH_CONVERSION:
            raise InputError(
                "with conversion above 0 and crosslink_reference structure_maximum",
                key=f"effects.{effect.name}",
                allowed="allowed for the whole map at once, --tile-px 0",
            )
        needs_all, why = WHOLE.get(effect.name, (lambda e: False, ""))
        if needs_all(effect):
            raise InputError(
                why, key=f"effects.{effect.name}", allowed="allowed for the whole map at once, --tile-px 0"
            )
    if parameters.readings.threshold_reference != "full_dose":
        raise InputError(
            f"found {parameters.readings.threshold_reference}",
            key="readings.threshold_reference",
            allowed="allowed in tiles: full_dose (or --tile-px 0)",
        )


def halo_um(parameters: ParameterSet) -> Reach:
    """Return how far around a point the exposed resin and its cross-linking depend on what is written.

    The focus reaches as far as its widest part, effects on the target and on the dose add their own reach, the latter
    once more where conversion follows the dose, and cross-linking adds its own.
    """
    spot = HeightMap(np.ones((2, 2)), 1.0, 1.0)
    dose = run([step for step in steps(parameters, Levels(1)) if step.stage == "dose"], spot)
    active = _active(parameters, False)
    written = [reach_um(e) for e in active if e.stage == "target"]
    local = [reach_um(e) for e in active if e.stage == "dose"]
    focus = _round(max(part.reach_um for part in dose.focus))
    spread = _gaussian(parameters.paper.crosslink_fwhm_xy_um)
    return _together(focus, spread, *written, *local, *(local if dose.conversion else ()))


def reach_um(effect: Any) -> Reach:
    """Return how far one effect looks."""
    return REACH_UM.get(effect.name, lambda e: _round(0.0))(effect)


def finish_reach_um(parameters: ParameterSet, *, as_measured: bool) -> Reach:
    """Return how far the effects on the printed surface and on the recording reach together."""
    active = _active(parameters, as_measured)
    return _together(*(reach_um(e) for e in active if e.stage in ("surface", "recording")))


def _together(*several: Reach) -> Reach:
    return sum(y for y, _ in several), sum(x for _, x in several)


def coarse_px(parameters: ParameterSet, dx_um: float, dy_um: float) -> tuple[int, int]:
    """Return the rows and columns of pixels that the fast numerics take together for cross-linking.

    Windows begin on this grid, so that all take the same pixels together: next to walls it shows, by up to 4 nm.
    """
    width_um = parameters.paper.crosslink_fwhm_xy_um
    return coarse_factor(width_um, dy_um), coarse_factor(width_um, dx_um)


def _active(parameters: ParameterSet, as_measured: bool) -> list[Any]:
    return [e for e in parameters.effects if not e.off and (as_measured or e.stage != "recording")]

"""A print is a list of steps: build the list from the parameters, run it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dlwpredict.errors import InputError
from dlwpredict.heightmap import TALLEST_UM, HeightMap
from dlwpredict.model.levels import Levels
from dlwpredict.model.states import SQUARE_PX, STAGES, Numerics
from dlwpredict.model.steps import CrossLinking, Exposure, PixelMean, Shrinkage, Slicing, Threshold
from dlwpredict.numerics.smoothing import FWHM_PER_SIGMA, REACH_SIGMAS
from dlwpredict.parameters import ParameterSet

WIDEST_FOCUS_PX = 1000
"""Pixels that a focus may reach over to either side. Beyond it a unit is wrong."""


@dataclass(frozen=True)
class FieldOfView:
    """What is looked at: the map without the room that was added around it for writing.

    Parameters
    ----------
    room_px : tuple of int
        Rows and columns of room on each side.
    """

    room_px: tuple[int, int]
    stage: ClassVar[str] = "recording"

    def __call__(self, printed: HeightMap) -> HeightMap:
        """Return the map in view."""
        inner = tuple(slice(r, n - r) for r, n in zip(self.room_px, printed.shape, strict=True))
        return HeightMap(printed.heights_um[inner], printed.dx_um, printed.dy_um)


def steps(
    parameters: ParameterSet, numerics: Numerics, *, as_measured: bool = False, room_px: tuple[int, int] = (0, 0)
) -> list[Any]:
    """Write the process down as the list of its steps, in the order of their stages.

    Each of the paper's steps opens its stage; the effects of that stage follow in the order of the file.

    Parameters
    ----------
    parameters : ParameterSet
    numerics : Numerics
        The way of computing, `Levels` or `Voxels`.
    as_measured : bool
        Include the effects of the measurement.
    room_px : (int, int)
        Rows and columns of room around the map, which an instrument does not see.
    """
    p, readings = parameters.paper, parameters.readings
    square = readings.square_share
    chain = [
        Slicing(parameters.writing.slicing_um),
        Exposure(p.exposure_fwhm_xy_um, p.exposure_fwhm_z_um, numerics, SQUARE_PX * np.sqrt(square)),
        Threshold(p.threshold, readings.threshold_reference),
        CrossLinking(p.crosslink_fwhm_xy_um, p.crosslink_fwhm_z_um),
        Shrinkage(p.shrinkage_min, p.shrinkage_max, readings.crosslink_reference),
        *([PixelMean(square)] if square else []),
        *([FieldOfView(room_px)] if any(room_px) else []),
    ]
    added = [effect for effect in parameters.effects if as_measured or effect.stage != "recording"]
    return sorted([*chain, *added], key=lambda step: STAGES.index(step.stage))


def run(chain: Iterable[Any], state: Any) -> Any:
    """Let every step act in turn."""
    for step in chain:
        state = step(state)
    return state


def predict(
    target: HeightMap,
    parameters: ParameterSet,
    *,
    numerics: Numerics | None = None,
    as_measured: bool = False,
) -> HeightMap:
    """Predict the printed surface of a target, or what an instrument would show of it.

    Parameters
    ----------
    target : HeightMap
        Heights to be written, ≥ 0, µm; 0 = nothing written. Around the map there is empty resin.
    parameters : ParameterSet
    numerics : Numerics, optional
        Default: the fast levels.
    as_measured : bool
        Add the effects of the measurement.

    Returns
    -------
    HeightMap
        On the target's grid.

    Raises
    ------
    InputError
        The target has points not measured, negative heights, or nothing written.
    """
    check_target(target)
    room = room_px(target, parameters)
    padded = target.with_heights(np.pad(target.heights_um, [(r, r) for r in room]))
    return run(steps(parameters, numerics or Levels(), as_measured=as_measured, room_px=room), padded)


def check_target(target: HeightMap) -> None:
    """Refuse a map that cannot be written.

    Raises
    ------
    InputError
        NaN, negative heights, heights beyond all structures, or nothing written.
    """
    heights = target.heights_um
    if np.isnan(heights).any():
        raise InputError(
            f"{np.isnan(heights).sum()} points without a height",
            key="heights",
            allowed="a target must be complete",
        )
    if heights.min() < 0:
        raise InputError(f"lowest height {heights.min():.4g} µm", key="heights", allowed="a target must be at least 0")
    if heights.max() == 0:
        raise InputError("nothing written, every height is 0", key="heights", allowed="some height above 0")
    if heights.max() > TALLEST_UM:
        raise InputError(
            f"highest height {heights.max():.4g} µm",
            key="heights",
            allowed=f"a target of at most {TALLEST_UM:g} µm; is the unit right (--z-scale)?",
        )


def room_px(target: HeightMap, parameters: ParameterSet) -> tuple[int, int]:
    """Return the rows and columns of empty resin to add on each side, so that exposure beyond the map is kept.

    Raises
    ------
    InputError
        The pitch is far too fine for this focus.
    """
    reach = REACH_SIGMAS * parameters.paper.exposure_fwhm_xy_um / FWHM_PER_SIGMA
    if min(target.dx_um, target.dy_um) < reach / WIDEST_FOCUS_PX:
        raise InputError(
            f"found {min(target.dx_um, target.dy_um):.4g} µm",
            key="pitch",
            allowed=f"at least {reach / WIDEST_FOCUS_PX:.4g} µm for this focus; is the unit right (--pitch-um)?",
        )
    return int(np.ceil(reach / target.dy_um)) + 1, int(np.ceil(reach / target.dx_um)) + 1

"""Warnings of a calibration, in words for the bench."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlwpredict.calibrate.problem import Point
from dlwpredict.calibrate.recordings import Recording
from dlwpredict.flat import Free, fittable

WEAK_SHARE = 0.3
"""A parameter is weakly known where its interval reaches further than this share of its value."""

UNKNOWN_SHARE = 0.5
"""It is not identified where the interval spans more than this share of its bounds."""


def warnings_of(
    free: Free, recordings: Sequence[Recording], point: Point, intervals: np.ndarray, directions: list[dict[str, float]]
) -> list[str]:
    """Return what the user should know before trusting the parameters."""
    said = []
    for k, name in enumerate(free.names):
        said += _about(name, fittable(free.base)[name].unit, point.vector[k], intervals[k], free.low[k], free.high[k])
    said += [f"the data leave open: {combination(free, direction)}" for direction in directions]
    return said + _about_shifts(recordings, point)


def identified(free: Free, intervals: np.ndarray) -> np.ndarray:
    """Return True for each parameter whose interval spans at most half of its bounds and touches at most one."""
    width = free.high - free.low
    spans = (intervals[:, 1] - intervals[:, 0]) / width
    both = (intervals[:, 0] <= free.low) & (intervals[:, 1] >= free.high)
    return (spans <= UNKNOWN_SHARE) & ~both


def combination(free: Free, direction: dict[str, float]) -> str:
    """Say one open direction: parameters that can move together without the fit telling."""
    moves = [f"{name} by {change:+.2g}{_unit(fittable(free.base)[name].unit)}" for name, change in direction.items()]
    return moves[0] + (" together with " + ", ".join(moves[1:]) if len(moves) > 1 else "") + " changes hardly anything"


def _about(name: str, unit: str, value: float, interval: np.ndarray, low: float, high: float) -> list[str]:
    span = f"{interval[0]:.3g} to {interval[1]:.3g}{_unit(unit)}"
    said = []
    edge = 1e-3 * (high - low)
    if value - low < edge or high - value < edge:
        bound = low if value - low < edge else high
        said.append(f"{name} is at its bound {bound:g}{_unit(unit)}: the fit wants it beyond what is physical")
    if interval[1] - interval[0] > UNKNOWN_SHARE * (high - low):
        said.append(f"{name} is not identified by these structures (95 % interval {span})")
    elif max(interval[1] - value, value - interval[0]) > WEAK_SHARE * abs(value):
        said.append(f"{name} is only weakly constrained by these structures (95 % interval {span})")
    return said


def _about_shifts(recordings: Sequence[Recording], point: Point) -> list[str]:
    said = []
    for recording, found in zip(recordings, point.nuisances, strict=True):
        values = dict(zip(recording.column_names, found, strict=True))
        pitch = max(recording.target.dx_um, recording.target.dy_um)
        shift = np.hypot(values.get("shift_x", 0.0), values.get("shift_y", 0.0))
        if shift > pitch:
            said.append(f"{recording.name} is shifted by {shift:.3g} µm against its prediction: align it again")
    return said


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"

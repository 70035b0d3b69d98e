"""Warnings of a calibration, in words for the bench."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from dlwpredict.calibrate.problem import Point
from dlwpredict.calibrate.recordings import Recording
from dlwpredict.flat import Free, fittable
from dlwpredict.smoothing import FWHM_PER_SIGMA

WEAK_SHARE = 0.3
"""A parameter is weakly known where its interval reaches further than this share of its value."""

UNKNOWN_SHARE = 0.5
"""It is not identified where the interval spans more than this share of its bounds."""

EDGE_SHARE = 1e-3
"""It is at a bound where it lies nearer to it than this share of its bounds."""


RELATIVE_ONLY = "learned from relative heights only (no substrate in view): relief is known, total height is not"


def cautions_of(recordings: Sequence[Recording]) -> list[str]:
    """Return what should be known wherever the process is used."""
    return [RELATIVE_ONLY] if all(one.measured.height_reference == "relative" for one in recordings) else []


def warnings_of(
    free: Free, recordings: Sequence[Recording], point: Point, intervals: np.ndarray, directions: list[dict[str, float]]
) -> list[str]:
    """Return what the user should know before trusting the parameters."""
    said = []
    for k, name in enumerate(free.names):
        said += _about(name, fittable(free.base)[name].unit, point.vector[k], intervals[k], free.low[k], free.high[k])
    said += [f"the data leave open: {combination(free, direction)}" for direction in directions]
    return said + _about_pixels(free, recordings, point, intervals) + _about_shifts(recordings, point)


def identified(free: Free, vector: np.ndarray, intervals: np.ndarray) -> np.ndarray:
    """Return True for each parameter away from its bounds whose interval spans at most half of them.

    At a bound the fit was stopped, not the data satisfied: that interval says nothing of where the parameter is.
    """
    width = free.high - free.low
    spans = (intervals[:, 1] - intervals[:, 0]) / width
    inside = (vector - free.low >= EDGE_SHARE * width) & (free.high - vector >= EDGE_SHARE * width)
    return (spans <= UNKNOWN_SHARE) & inside


def combination(free: Free, direction: dict[str, float]) -> str:
    """Say one open direction: parameters that can move together without the fit telling."""
    moves = [f"{name} by {change:+.2g}{_unit(fittable(free.base)[name].unit)}" for name, change in direction.items()]
    return moves[0] + (" together with " + ", ".join(moves[1:]) if len(moves) > 1 else "") + " changes hardly anything"


def _about(name: str, unit: str, value: float, interval: np.ndarray, low: float, high: float) -> list[str]:
    span = f"{interval[0]:.3g} to {interval[1]:.3g}{_unit(unit)}"
    said = []
    edge = EDGE_SHARE * (high - low)
    if value - low < edge or high - value < edge:
        bound = low if value - low < edge else high
        said.append(f"{name} is at its bound {bound:g}{_unit(unit)}: the fit wants it beyond what is physical")
    if interval[1] - interval[0] > UNKNOWN_SHARE * (high - low):
        said.append(f"{name} is not identified by these structures (95 % interval {span})")
    elif max(interval[1] - value, value - interval[0]) > WEAK_SHARE * abs(value):
        said.append(f"{name} is only weakly constrained by these structures (95 % interval {span})")
    return said


def width_if_square(fwhm_um: float, pitch_um: float) -> float:
    """Return the FWHM that prints square pixels as the given one prints a target smooth between its pixels, µm.

    A Gaussian over squares, read at their centres, has the weights Φ((n + ½)/s) − Φ((n − ½)/s), s in pixels. Their
    variance is made equal to that of the given Gaussian; for wide ones it is s² + 1/12.

    Examples
    --------
    >>> [round(width_if_square(fwhm, 0.5), 3) for fwhm in (0.4, 0.6, 2.0)]
    [0.374, 0.52, 1.971]
    """
    variance = (fwhm_um / FWHM_PER_SIGMA / pitch_um) ** 2
    pixels = np.arange(-np.ceil(8 * np.sqrt(variance)) - 8, np.ceil(8 * np.sqrt(variance)) + 9)
    edges = np.append(pixels - 0.5, pixels[-1] + 0.5)
    sigma = brentq(lambda s: np.diff(ndtr(edges / s)) @ pixels**2 - variance, 1e-3, np.sqrt(variance) + 1)
    return float(sigma * FWHM_PER_SIGMA * pitch_um)


def _about_pixels(free: Free, recordings: Sequence[Recording], point: Point, intervals: np.ndarray) -> list[str]:
    """Say where the reading of a pixel moves the width of the focus out of its interval."""
    place = free.index("exposure_fwhm_xy_um")
    if place is None:
        return []
    pitch = max(max(r.target.dx_um, r.target.dy_um) for r in recordings)
    other = width_if_square(point.vector[place], pitch)
    if intervals[place, 0] <= other <= intervals[place, 1]:
        return []
    return [
        f"exposure_fwhm_xy_um rests on how pixels of {pitch:.3g} µm are read: here the part is smooth between them; "
        f"were they written as squares, it would be {other:.2g} µm"
    ]


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

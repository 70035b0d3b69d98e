"""Warnings of a calibration, in words for the bench."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from dlwpredict.infer.free import Free, fittable
from dlwpredict.infer.intervals import Intervals
from dlwpredict.infer.objective import Fit
from dlwpredict.infer.priors import LEVELLING, SHIFTS, Prior
from dlwpredict.infer.recording import Recording
from dlwpredict.numerics.smoothing import FWHM_PER_SIGMA

WEAK_SHARE = 0.3
"""A parameter is weakly known where its interval reaches further than this share of its value."""

UNKNOWN_SHARE = 0.5
"""It is not identified where the interval spans more than this share of its bounds."""

PRIOR_SHARE = np.sqrt(0.5)
"""Nor where its standard deviation is more than this share of its prior's: then the prior says more than the data."""

EDGE_SHARE = 1e-3
"""It is at a bound where it lies nearer to it than this share of its bounds."""

SHIFTED_UM = 0.25
"""A recording lies off its target where it is shifted by more than this, or by a pixel: an alignment leaves less."""

OPEN, WEAK = "not identified by these structures", "only weakly known"

RELATIVE_ONLY = "learned from relative heights only (no substrate in view): relief is known, total height is not"


def cautions_of(recordings: Sequence[Recording]) -> list[str]:
    """Return what should be known wherever the process is used."""
    return [RELATIVE_ONLY] if all(recording.measured.height_reference == "relative" for recording in recordings) else []


def warnings_of(
    end: Fit, intervals: Intervals, determined: np.ndarray, directions: Sequence[Mapping[str, float]]
) -> list[str]:
    """Return what the user should know before trusting the parameters: at most three sentences.

    Each says what is the matter, what it means, and what to do: of parameters at their bounds, of those that these
    structures hardly tell, and of the recordings and how they were read.

    Parameters
    ----------
    end : Fit
    intervals : Intervals
    determined : numpy.ndarray of bool, shape (parameters,)
        From `identified`.
    directions : sequence of mapping
        Changes that are left open, name to µm or 1.
    """
    free = end.free
    known = zip(free.names, end.vector, intervals.ends, free.low, free.high, determined, strict=True)
    kinds: dict[str, list[str]] = {"bound": [], "open": [], "weak": []}
    for name, value, interval, low, high, told in known:
        kind, text = _about(name, float(value), interval, (float(low), float(high)), determined=bool(told))
        if kind:
            kinds[kind].append(f"{name} {text}{_unit(fittable(free.base)[name].unit)}")
    return [
        *_about_bounds(kinds["bound"]),
        *_about_knowledge(free, kinds, directions),
        *_about_recordings(end, intervals),
    ]


def _about_bounds(stopped: list[str]) -> list[str]:
    if not stopped:
        return []
    return [
        f"at a bound: {', '.join(stopped)}: the fit was stopped there, so that the value stands in for something that "
        "the model lacks; diagnose says what, or widen the bounds if they are not physical"
    ]


def _about_knowledge(
    free: Free, kinds: Mapping[str, list[str]], directions: Sequence[Mapping[str, float]]
) -> list[str]:
    said = [f"{words}: {', '.join(kinds[kind])}" for kind, words in (("open", OPEN), ("weak", WEAK)) if kinds[kind]]
    together = [f"the data leave open {combination(free, direction)}" for direction in directions[:1]]
    if not said and not together:
        return []
    return [
        f"{'; '.join([*said, *together])}: parts like these are predicted all the same, taller or finer ones may not "
        "be; add a recording with other heights and widths (design stairs)"
    ]


def identified(free: Free, vector: np.ndarray, intervals: Intervals, known: Mapping[str, Prior]) -> np.ndarray:
    """Return True for each parameter that the data determine, shape (parameters,).

    It lies away from its bounds, its interval spans at most half of them, and is narrower than what was known before.
    At a bound the fit was stopped, not the data satisfied: that interval says nothing of where the parameter is.
    """
    width = free.high - free.low
    spans = (intervals.ends[:, 1] - intervals.ends[:, 0]) / width
    inside = (vector - free.low >= EDGE_SHARE * width) & (free.high - vector >= EDGE_SHARE * width)
    before = [
        known[name].sd_at(value) if name in known else np.inf for name, value in zip(free.names, vector, strict=True)
    ]
    return (spans <= UNKNOWN_SHARE) & inside & (intervals.sd < PRIOR_SHARE * np.array(before))


def nuisances_um(end: Fit, k: int) -> dict[str, float]:
    """Return what recording k was levelled and moved by, µm: what turns or grows outwards by what it is at the rim."""
    item = end.data[k]
    half_x, half_y = (size / 2 for size in item.recording.target.size_um)
    lever = dict.fromkeys((*LEVELLING, *SHIFTS), 1.0)
    lever |= {"rotation": max(half_x, half_y), "scale_x": half_x, "scale_y": half_y, "shear": half_y}
    fitted = zip(item.nuisances, item.known() + end.coefficients[k], strict=True)
    return {name: float(value) * lever[name] for name, value in fitted}


def combination(free: Free, direction: Mapping[str, float]) -> str:
    """Say one open direction: parameters that can move together without the fit telling."""
    moves = [f"{name} by {change:+.2g}{_unit(fittable(free.base)[name].unit)}" for name, change in direction.items()]
    return moves[0] + (" together with " + ", ".join(moves[1:]) if len(moves) > 1 else "")


def _about(
    name: str, value: float, interval: np.ndarray, bounds: tuple[float, float], *, determined: bool
) -> tuple[str, str]:
    """Return whether a parameter is at a bound, open or weak (else nothing), and its value or interval."""
    low, high = bounds
    edge, wide = EDGE_SHARE * (high - low), interval[1] - interval[0] > UNKNOWN_SHARE * (high - low)
    if value - low < edge or high - value < edge:
        return "bound", f"{low if value - low < edge else high:g}"
    span = f"{interval[0]:.3g} to {interval[1]:.3g}"
    if wide or not determined:
        return "open", span
    return ("weak", span) if max(interval[1] - value, value - interval[0]) > WEAK_SHARE * abs(value) else ("", "")


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


def _about_recordings(end: Fit, intervals: Intervals) -> list[str]:
    """Say which recordings lie off their targets, and where the reading of a pixel moves the width of the focus."""
    said = [*_about_shifts(end), *_about_pixels(end, intervals)]
    return ["; ".join(said)] if said else []


def _about_pixels(end: Fit, intervals: Intervals) -> list[str]:
    place = end.free.index("exposure_fwhm_xy_um")
    if place is None or end.parameters.readings.pixels != "points":
        return []
    targets = [item.recording.target for item in end.data]
    pitch = max(max(target.dx_um, target.dy_um) for target in targets)
    if_square_um = width_if_square(end.vector[place], pitch)
    if intervals.ends[place, 0] <= if_square_um <= intervals.ends[place, 1]:
        return []
    return [
        f"exposure_fwhm_xy_um rests on how pixels of {pitch:.3g} µm are read: it would be {if_square_um:.2g} µm, "
        "were they written as squares (then say readings: {pixels: squares}) and not smooth between them"
    ]


def _about_shifts(end: Fit) -> list[str]:
    said = []
    for k, item in enumerate(end.data):
        moved, target = nuisances_um(end, k), item.recording.target
        most = min(max(target.dx_um, target.dy_um), SHIFTED_UM)
        x_um, y_um = (moved.get(name, 0.0) for name in SHIFTS)
        shift = np.hypot(x_um, y_um)
        if shift > most:
            said.append(f"{item.recording.name} is shifted by {shift:.3g} µm against its prediction: align it again")
    return said


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"

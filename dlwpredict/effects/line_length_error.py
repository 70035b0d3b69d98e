"""Line-length error: every written segment of every layer starts and ends too early or too late."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.effects.base import MapEffect
from dlwpredict.effects.plane import own_slope
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import declare

WALLS_ONLY = 1e-3
"""Pitch, µm, at which a step of one is a wall."""

LEAST_SHARE = 0.05
"""A column of bare glass that lines cover by less is not written; their next column takes what it would hold."""


def read_along(lines: np.ndarray, shift_px: float, pitch_um: float) -> np.ndarray:
    """Read every line (first axis) at a distance from each pixel, by cubics between the pixels.

    Both sides of a pixel have the central slope, so that a short distance counts alike in both directions; where the
    slope changes as at a wall each side has its own (`own_slope`), and nothing overshoots.

    Parameters
    ----------
    lines : numpy.ndarray, shape (n, ...)
        Heights, µm; a line goes on beyond its ends as it ends there.
    shift_px : float
        Distance towards higher indices, pixels.
    pitch_um : float

    Examples
    --------
    >>> read_along(np.arange(6.0), -0.25, 1.0)[2:5].tolist()
    [1.75, 2.75, 3.75]
    """
    whole = int(np.floor(shift_px))
    t = shift_px - whole
    first = _moved(lines, whole)
    if t == 0:
        return first
    before, second, after = (_moved(lines, whole + step) for step in (-1, 1, 2))
    leaving = (second - before) / 2 + own_slope(before - 2 * first + second, pitch_um)
    arriving = (after - first) / 2 - own_slope(first - 2 * second + after, pitch_um)
    bent = (1 - t) * leaving - t * arriving + (2 * t - 1) * (second - first)
    return first + t * (second - first) + t * (1 - t) * bent


def _moved(lines: np.ndarray, rows: int) -> np.ndarray:
    return lines[np.clip(np.arange(len(lines)) + rows, 0, len(lines) - 1)]


def ends_moved(lines: np.ndarray, start_px: float, end_px: float, pitch_um: float) -> np.ndarray:
    """Return the heights over which every segment [a, b] of every layer has become [a − start, b + end].

    Longer segments are the largest height within [y − end, y + start], a grey dilation; shorter ones the least within
    [y − |start|, y + |end|], a grey erosion. What one end gains while the other loses it moves the whole line. Heights
    are monotone in both lengths, but for what a cubic has between the two highest pixels of a top: an eighth of its
    second difference at most.

    Parameters
    ----------
    lines : numpy.ndarray, shape (n, ...)
        Heights along the writing direction, µm.
    start_px, end_px : float
        Lengths gained at the start and at the end of a segment, pixels.
    pitch_um : float

    Examples
    --------
    >>> hill = np.array([0.0, 0, 1, 2, 3, 3, 2, 1, 0, 0])
    >>> ends_moved(hill, 0.0, 1.0, 1.0).tolist()
    [0.0, 0.0, 1.0, 2.0, 3.0, 3.0, 3.0, 2.0, 1.0, 0.0]
    >>> ends_moved(hill, -1.0, 0.0, 1.0).tolist()
    [0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.0, 0.0]
    """
    if start_px * end_px < 0:
        common = np.sign(start_px) * min(abs(start_px), abs(end_px))
        lines, start_px, end_px = read_along(lines, common, pitch_um), start_px - common, end_px + common
    longer = start_px + end_px > 0
    low, high = (-end_px, start_px) if longer else (start_px, -end_px)
    within = [_moved(lines, rows) for rows in range(int(np.ceil(low)), int(np.floor(high)) + 1)]
    ends = [read_along(lines, place, pitch_um) for place in (low, high)]
    return (np.maximum if longer else np.minimum).reduce(within + ends)


def without_films(heights: np.ndarray, covered: np.ndarray, bare: np.ndarray) -> np.ndarray:
    """Return heights whose thinnest new columns are heaped on the next column of their line.

    What is written begins inside the glass, so that even the lowest of columns has an exposure: a jump where a length
    grows from 0.

    Parameters
    ----------
    heights : numpy.ndarray, shape (n, ...)
        Along the lines, µm.
    covered : numpy.ndarray
        Share of every column that lines cover.
    bare : numpy.ndarray of bool
        Where nothing was to be written.
    """
    film = np.where(bare & (covered < LEAST_SHARE), heights, 0)
    of_line_before = np.diff(covered, axis=0, prepend=0) < 0
    joined = heights - film
    joined[:-1] += (film * of_line_before)[1:]
    joined[1:] += (film * ~of_line_before)[:-1]
    return joined


@dataclass(frozen=True)
class LineLengthError(MapEffect):
    """Every segment [a, b] that is written at height z along y becomes [a − start, b + end], µm; x is left alone.

    The layer at z of the part under h is {h ≥ z}. So flanks that rise along the writing direction move by −start, those
    that fall by +end: h → h ± slope · length on a ramp, and narrow ridges and pits lose or gain at both ends. Sixteen
    AFM fields of 0.1 µm pixels (docs/real-prints.md) look as if lines came out 0.1 µm short at both ends, or as if
    the microscope did something alike: they cannot tell.

    Lengths count by parts of a pixel. A wall that moves by part of a pixel leaves a column of part of its height, which
    is what the focus and cross-linking see of it from some pixels away; there, a small length counts as much in the one
    direction as in the other.
    """

    name = "line-length-error"
    meaning = "every written line comes out too long or too short at its start and its end (y)"
    frame = "printer"
    stage = "target"
    source = "AFM fields of sixteen prints (Zheng, Zhao, So, SIGGRAPH Asia 2023; docs/real-prints.md); law is ours"
    confused_with = ("slope-error", "line-end-pileup", "galvo-lag")
    separated_by = "a recording turned by 90° under the microscope, or trace and retrace of it"
    isotropic = False

    start_um: float = declare(0.0, "µm", -0.5, 0.5, "length gained where a line starts (negative: lost)", typical=-0.1)
    end_um: float = declare(0.0, "µm", -0.5, 0.5, "length gained where a line ends (negative: lost)", typical=-0.1)
    direction: float = declare(1.0, "1", -1, 1, "writing direction, +1 towards +y, -1 towards -y", fitted=False)

    def heights(self, state: HeightMap) -> np.ndarray:
        """Return the heights that are written by lines of other lengths."""
        # rows run downwards, y upwards
        along = slice(None, None, -int(self.direction))
        lines, ends = state.heights_um[along], (self.start_um / state.dy_um, self.end_um / state.dy_um)
        moved = np.maximum(ends_moved(lines, *ends, state.dy_um), 0)
        covered = ends_moved(1.0 * (lines > 0), *ends, WALLS_ONLY)
        return without_films(moved, covered, lines == 0)[along]

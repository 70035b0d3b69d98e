"""Lines start and end too early or too late: each written segment [a, b] along y becomes [a - start, b + end].

literal:  the heights to be written: pixel maxima (or minima) along y, linear within the last pixel.
segments: every layer of voxels is cut into thin slices; in each slice the runs along y are found one by one, and voxels
          at their ends are filled or emptied by the share that the run covers, before the focus acts.
"""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect
from tests.press.lines import from_end, from_start

SLICES = 24  # of a layer that is partly filled


@effect("line-length-error")
@dataclass(frozen=True)
class LineLengthError(PrintEffect):
    """Lengths gained at start and end in um, negative: lost; direction +1 writes towards +y."""

    models = ("literal", "segments")
    start_um: float = 0.0
    end_um: float = 0.0
    direction: int = 1
    model: str = "literal"

    @property
    def _ends(self):
        """What runs gain at low and at high y."""
        return (self.start_um, self.end_um)[:: 1 if self.direction > 0 else -1]

    def target(self, heights, support, grid):
        if self.model != "literal" or self._ends == (0, 0):
            return heights, support
        low, high = self._ends
        return tuple(_stretched(_stretched(plane, high / grid.dy)[::-1], low / grid.dy)[::-1]
                     for plane in (heights, support))  # fmt: skip

    def source(self, fill, grid):
        if self.model != "segments" or self._ends == (0, 0):
            return fill
        out = fill.copy()
        for layer, changed in zip(fill, out, strict=True):
            if layer.any():
                partly = np.any((layer > 0) & (layer < 1))
                levels = (np.arange(SLICES) + 0.5) / SLICES if partly else [0.5]
                shares = [covered(layer > level, *self._ends, grid.dy) - (layer > level) for level in levels]
                changed += np.mean(shares, axis=0).astype(np.float32)
        return np.clip(out, 0, 1)


def _stretched(plane, pixels):
    """Move the falling flanks of lines upwards by so many pixels: maxima (minima) over what lies behind (ahead)."""
    turned = plane if pixels > 0 else -plane[::-1]
    whole, part = divmod(abs(pixels), 1)
    reached = turned
    for step in range(1, int(whole) + 1):
        reached = np.maximum(reached, _behind(turned, step))
    out = (1 - part) * reached + part * np.maximum(reached, _behind(turned, int(whole) + 1))
    return out if pixels > 0 else -out[::-1]


def _behind(plane, step):
    return plane[np.maximum(np.arange(len(plane)) - step, 0)]


def covered(written, low_um, high_um, pitch):
    """Return the share of each pixel that runs along y cover once they are longer by so much at low and at high y."""
    gained = np.zeros(written.shape)
    for length, distance in ((high_um, _past_a_run(written, pitch)), (low_um, _before_a_run(written, pitch))):
        gained += _share(length, distance, pitch)
    lost = _share(-low_um, from_start(written, pitch), pitch) + _share(-high_um, from_end(written, pitch), pitch)
    return np.clip(np.where(written, 1 - lost, gained), 0, 1)


def _share(length, distance, pitch):
    """Return which part of a pixel, its centre at a distance from an edge, a length from the edge covers."""
    return np.clip((length - distance) / pitch + 0.5, 0, 1) if length > 0 else 0.0


def _past_a_run(written, pitch):
    """Return the distance from the end of the last run; infinite where none came before."""
    return np.where(np.maximum.accumulate(written, axis=0), from_start(~written, pitch), np.inf)


def _before_a_run(written, pitch):
    return _past_a_run(written[::-1], pitch)[::-1]

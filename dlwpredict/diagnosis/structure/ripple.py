"""Ripples: waves of one period and direction, which no form of place or height follows and noise models absorb."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import fft

from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.structure.largest import LARGEST_OF, p_of_largest
from dlwpredict.infer.objective import Fit
from dlwpredict.infer.recording import Recording


@dataclass(frozen=True)
class Ripple:
    """The strongest wave in the whitened residuals.

    Parameters
    ----------
    pair : int
    period_um : float
    angle_deg : float
        Direction in which the waves follow each other, counter-clockwise from x, −90 to 90.
    excess : float
        Energy in units of the noise, of its sine and cosine, above its average of 2.
    p_value : float
        Probability that noise alone has as strong a wave anywhere.
    """

    kind: ClassVar[str] = "ripple"

    pair: int
    period_um: float
    angle_deg: float
    excess: float
    p_value: float

    @property
    def where(self) -> str:
        """In words: everywhere, but in waves."""
        return f"in waves of period {self.period_um:.1f} µm, at {round(self.angle_deg)}° to x"


def ripple(fitted: Fit, draws: np.ndarray) -> Ripple:
    """Test the largest ordinate of the periodogram (Fisher 1929) of every whitened residual.

    Ordinates are divided by what the null's draws have there on average, those of a draw by what the others have: by an
    average with itself in it, it would seem smaller than a residual. Waves across the lines of a known scan are not
    looked at: lines have offsets of their own, and what an alignment has read between them is no wave of a print. Nor
    are waves of fewer than three pixels: a map that was turned holds there what was read between pixels.

    Parameters
    ----------
    fitted : Fit
    draws : numpy.ndarray, shape (rows, draws)
        From `Null.beside` this fit.
    """
    ripples = []
    for k, item in enumerate(fitted.data):
        used, grid, rows = item.recording.used, item.recording.target, fitted.rows.of(k)
        fy, fx = -fft.fftfreq(used.shape[0], grid.dy_um), fft.rfftfreq(used.shape[1], grid.dx_um)
        seen = ~across_lines(item.recording, fx, fy[:, None]) & resolved(item.recording, fx, fy[:, None])
        powers = np.stack([_periodogram(draw, used) for draw in draws[rows, :LARGEST_OF].T])
        whole, others = powers.sum(axis=0), len(powers) - 1
        largest = np.where(seen, others * powers / (whole - powers), 0.0).max(axis=(1, 2))
        power = np.where(seen, _periodogram(fitted.residual[rows], used) / powers.mean(axis=0), 0.0)
        row, col = np.unravel_index(np.argmax(power), power.shape)
        fy, fx = fy[row], fx[col]
        p_value = p_of_largest(power[row, col], largest, of=len(fitted.data))
        angle = float(np.degrees(np.arctan2(fy, fx))) if fx > 0 else 90.0
        ripples.append(Ripple(k, float(1 / np.hypot(fx, fy)), angle, float(2 * power[row, col] - 2), p_value))
    return min(ripples, key=lambda wave: wave.p_value)


def across_lines(recording: Recording, fx: np.ndarray, fy: np.ndarray) -> np.ndarray:
    """Tell which waves (1/µm along x and y) lie across the lines of a scan; none where it is not known to be one."""
    fast = recording.measured.instrument.fast_axis_deg
    if fast is None:
        return np.zeros(np.broadcast_shapes(fx.shape, fy.shape), dtype=bool)
    x, y = np.cos(np.deg2rad(fast)), np.sin(np.deg2rad(fast))
    width, depth = recording.target.size_um
    return np.abs(fx * x + fy * y) * (abs(x) * width + abs(y) * depth) <= policy.ALONG_LINES


def resolved(recording: Recording, fx: np.ndarray, fy: np.ndarray) -> np.ndarray:
    """Tell which waves (1/µm along x and y) are longer than `policy.SHORTEST_PX` pixels, of map and instrument."""
    grid = recording.target
    widest_um = max(grid.dx_um, grid.dy_um, recording.measured.instrument.pitch_um or 0.0)
    return np.hypot(fx, fy) < 1 / (policy.SHORTEST_PX * widest_um)


def _periodogram(white: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Return the periodogram of whitened values on a map, zeros where nothing counts; the mean is left out."""
    plane = np.zeros(used.shape)
    plane[used] = white
    power = np.abs(fft.rfft2(plane)) ** 2 / used.sum()
    power[0, 0] = 0.0
    return np.maximum(power, 1e-12)

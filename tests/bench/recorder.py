"""A simple print and microscope for alignment trials: blur, gain, a dome, a warp known in closed form, noise, gaps.

Nothing here is shared with `dlwpredict.alignment`: the print lives on a canvas four times finer than the target and is
read by a quintic spline at 3 × 3 places per recorded pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from dlwpredict.heightmap import HeightMap

OVERSAMPLE = 4


@dataclass(frozen=True)
class Truth:
    """How a recording was made: pose as in the contract, instrument, flaws."""

    shift_um: tuple[float, float] = (0.0, 0.0)
    rotation_deg: float = 0.0
    scale: tuple[float, float] = (1.0, 1.0)
    tilt_mrad: tuple[float, float] = (0.0, 0.0)
    offset_um: float = 0.0
    pitch_um: tuple[float, float] = (0.25, 0.25)
    field_um: tuple[float, float] = (60.0, 60.0)
    gain: float = 0.9
    blur_um: float = 0.3
    dome: float = 0.1
    noise_um: float = 0.01
    missing: float = 0.0
    spikes: float = 0.0
    mirrored: bool = False


def printed(target: HeightMap, truth: Truth) -> np.ndarray:
    """Print the target on the fine canvas: edges rounded, middle of the part raised by ``dome``, heights × gain."""
    canvas = np.repeat(np.repeat(target.heights_um, OVERSAMPLE, 0), OVERSAMPLE, 1)
    sigma = truth.blur_um * OVERSAMPLE / np.array([target.dy_um, target.dx_um])
    inside = ndimage.gaussian_filter((canvas > 0).astype(float), 8 * sigma, mode="constant", truncate=3)
    rounded = ndimage.gaussian_filter(canvas, sigma, mode="constant")
    return truth.gain * rounded * (1 - truth.dome * (1 - inside))


def record(target: HeightMap, truth: Truth, rng: np.random.Generator) -> HeightMap:
    """Print a target and record it; the substrate reaches beyond the target."""
    cols, rows = (round(f / p) for f, p in zip(truth.field_um, truth.pitch_um, strict=True))
    blank = HeightMap(np.zeros((rows, cols)), *truth.pitch_um)
    x, y = np.meshgrid(blank.x_um, blank.y_um)
    canvas = ndimage.spline_filter(printed(target, truth), order=5, mode="constant")
    heights = np.zeros(x.shape)
    for i in (-1, 0, 1):
        for j in (-1, 0, 1):
            heights += _read(canvas, target, truth, x + i * blank.dx_um / 3, y + j * blank.dy_um / 3) / 9
    heights += truth.offset_um + 1e-3 * (truth.tilt_mrad[0] * x + truth.tilt_mrad[1] * y)
    heights += truth.noise_um * rng.standard_normal(x.shape)
    spiky = rng.random(x.shape) < truth.spikes
    heights[spiky] += rng.uniform(-5, 5, int(spiky.sum()))
    heights[blotches(x.shape, truth.missing, rng)] = np.nan
    return blank.with_heights(heights[:, ::-1] if truth.mirrored else heights)


def _read(canvas: np.ndarray, target: HeightMap, truth: Truth, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    angle = np.radians(truth.rotation_deg)
    x, y = x - truth.shift_um[0], y - truth.shift_um[1]
    u = (np.cos(angle) * x + np.sin(angle) * y) / truth.scale[0]
    v = (-np.sin(angle) * x + np.cos(angle) * y) / truth.scale[1]
    rows, cols = canvas.shape
    place = [
        (rows - 1) / 2 - v / target.dy_um * OVERSAMPLE,
        (cols - 1) / 2 + u / target.dx_um * OVERSAMPLE,
    ]
    return ndimage.map_coordinates(canvas, place, order=5, mode="constant", prefilter=False)


def blotches(shape: tuple[int, int], fraction: float, rng: np.random.Generator) -> np.ndarray:
    """Mark a share of the points: blotches of about 4 pixels, as steep or dull places leave them."""
    if fraction <= 0:
        return np.zeros(shape, bool)
    field = ndimage.gaussian_filter(rng.standard_normal(shape), 2, mode="wrap")
    return field < np.quantile(field, fraction)

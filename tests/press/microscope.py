"""The microscope: looks at a part at an angle, on its own pixels, with its own faults.

A part's point p (from the part's centre, y up) is recorded at q = shift + R(rotation) diag(scale) p from the
recording's centre, the meaning of align.yaml. An axis that does not move evenly believes to be at q where it is at
q + a sin(pi q / h), h half the field along it. The recorded height is then

    t = mean of the surface over the pixel + offset + 1e-3 (tilt_x q_x + tilt_y q_y)

followed by the instrument's effects in the order of their stages, noise, spikes and points that are not measured.
"""

from dataclasses import dataclass, field

import numpy as np

from tests.press.effect import MeasureEffect, make
from tests.press.grid import plane_grid
from tests.press.noise import blotches, correlated, spikes
from tests.press.sampling import Surface
from tests.press.slopes import slope


@dataclass(frozen=True)
class Pose:
    """How the part lies under the microscope."""

    shift_um: tuple = (0.0, 0.0)
    rotation_deg: float = 0.0  # counter-clockwise seen from above
    scale: tuple = (1.0, 1.0)
    mirrored: bool = False  # the file is stored with left and right exchanged
    uneven_um: tuple = (0.0, 0.0)  # by how much the axes x and y of the instrument are off, at most
    tilt_mrad: tuple = (0.0, 0.0)  # of the recording along its own x and y
    offset_um: float = 0.0


@dataclass(frozen=True)
class Noise:
    """Height noise; all standard deviations in um."""

    sigma_um: float = 0.0
    correlation_um: float = 0.0
    kind: str = "gaussian"
    white_um: float = 0.0
    row_um: float = 0.0  # one random offset per row


@dataclass(frozen=True)
class Dropouts:
    """Points without a value."""

    max_angle_deg: float = 90.0  # steeper places return no light
    fraction: float = 0.0  # besides, this share of the map in blotches
    blotch_um: float = 2.0


@dataclass(frozen=True)
class Spikes:
    """Wrong single pixels."""

    fraction: float = 0.0
    height_um: float = 1.0


@dataclass(frozen=True)
class Microscope:
    """An instrument and one way of using it."""

    pitch_um: tuple | None = None  # (x, y); None = the printed map's
    pixels: tuple | None = None  # (columns, rows); None = as many as cover `field_um`, or the printed map
    field_um: tuple | None = None
    pose: Pose = field(default_factory=Pose)
    noise: Noise = field(default_factory=Noise)
    dropouts: Dropouts = field(default_factory=Dropouts)
    spikes: Spikes = field(default_factory=Spikes)
    effects: tuple = ()
    seed: int = 0


@dataclass(frozen=True)
class Recording:
    """What comes out: heights (NaN = not measured), pitches, and the truth about the pose."""

    heights: np.ndarray
    dx_um: float
    dy_um: float
    truth: dict


def measure(printed, dx_um, dy_um, microscope=None, *, seed=None):
    """Record a printed map (row 0 at the top, um).

    Outside the map lies bare substrate. A pixel coarser than the map's is the mean over its area. With the same pixels,
    no pose and no effects the recording is the map itself, bit for bit.
    """
    scope = microscope or Microscope()
    effects = sorted((make(entry) for entry in scope.effects), key=lambda item: item.stage)
    rng = np.random.default_rng(scope.seed if seed is None else seed)
    surface = np.asarray(printed, float)[::-1]
    sample = plane_grid(surface.shape, dx_um, dy_um)
    grid = _camera(scope, sample)
    heights = _look(surface, sample, grid, scope.pose, effects)
    tilt_x, tilt_y = (1e-3 * value for value in scope.pose.tilt_mrad)
    heights = heights + scope.pose.offset_um + tilt_x * grid.x[None, :] + tilt_y * grid.y[:, None]
    for item in effects:
        heights = item.record(heights, grid)
    blind = np.isnan(heights) | _unseen(rng, np.nan_to_num(heights), grid, scope.dropouts)
    heights = heights + _noise(rng, heights.shape, grid, scope)
    heights[blind] = np.nan
    stored = heights[::-1, ::-1] if scope.pose.mirrored else heights[::-1]
    return Recording(stored.copy(), grid.dx, grid.dy, _truth(scope.pose, stored, scope.seed if seed is None else seed))


def _camera(scope, sample):
    """Return the recording's grid."""
    dx, dy = scope.pitch_um or (sample.dx, sample.dy)
    if scope.pixels:
        columns, rows = (int(count) for count in scope.pixels)
    elif scope.field_um:
        columns, rows = (round(size / pitch) for size, pitch in zip(scope.field_um, (dx, dy), strict=True))
    else:
        columns = round(len(sample.x) * sample.dx / dx)
        rows = round(len(sample.y) * sample.dy / dy)
    return plane_grid((rows, columns), dx, dy)


def _look(surface, sample, grid, pose, effects):
    """Return the mean of the surface over each recorded pixel."""
    moved = pose.shift_um != (0.0, 0.0) or pose.rotation_deg or pose.scale != (1.0, 1.0) or any(pose.uneven_um)
    warped = any(type(item).place is not MeasureEffect.place and item != type(item)() for item in effects)
    same = surface.shape == (len(grid.y), len(grid.x)) and (grid.dx, grid.dy) == (sample.dx, sample.dy)
    if same and not moved and not warped:
        return surface.copy()
    reader = Surface(surface, sample)
    parts_x, parts_y = _parts(grid.dx, sample.dx), _parts(grid.dy, sample.dy)
    total = np.zeros((len(grid.y), len(grid.x)))
    for step_y in _sub_steps(grid.dy, parts_y):
        for step_x in _sub_steps(grid.dx, parts_x):
            x, y = np.meshgrid(grid.x + step_x, grid.y + step_y)
            for item in effects:
                x, y = item.place(x, y)
            total += reader.at(*_on_part(*_reached(x, y, grid, pose), pose))
    return total / (parts_x * parts_y)


def _parts(coarse, fine):
    """Return how many points across a pixel are averaged; one where the pixel is not coarser than the map's."""
    ratio = coarse / fine
    return 1 if ratio < 1 + 1e-6 else int(np.ceil(2 * ratio))


def _sub_steps(pitch, parts):
    """Return the offsets of the sub-pixel centres."""
    return (np.arange(parts) - (parts - 1) / 2) * pitch / parts


def _reached(x, y, grid, pose):
    """Return where the instrument is when it believes to be at x and y: off by one wave over the field."""
    fields = len(grid.x) * grid.dx, len(grid.y) * grid.dy
    off = (a * np.sin(2 * np.pi * q / field) for a, q, field in zip(pose.uneven_um, (x, y), fields, strict=True))
    return tuple(q + more for q, more in zip((x, y), off, strict=True))


def _on_part(x, y, pose):
    """Return where on the part a recorded point lies: the inverse of q = shift + R diag(scale) p."""
    turn = np.radians(pose.rotation_deg)
    x, y = x - pose.shift_um[0], y - pose.shift_um[1]
    along = x * np.cos(turn) + y * np.sin(turn)
    across = y * np.cos(turn) - x * np.sin(turn)
    return along / pose.scale[0], across / pose.scale[1]


def _unseen(rng, heights, grid, dropouts):
    """Return which points are not measured: too steep, or in a blotch."""
    blind = blotches(rng, heights.shape, grid, dropouts.fraction, dropouts.blotch_um)
    if dropouts.max_angle_deg < 90:
        blind |= slope(heights, grid) > np.tan(np.radians(dropouts.max_angle_deg))
    return blind


def _noise(rng, shape, grid, scope):
    """Return the sum of all height noise."""
    noise = scope.noise
    total = noise.sigma_um * correlated(rng, shape, grid, noise.correlation_um, noise.kind) if noise.sigma_um else 0.0
    total = total + noise.white_um * rng.standard_normal(shape)
    total = total + noise.row_um * rng.standard_normal((shape[0], 1))
    return total + spikes(rng, shape, scope.spikes.fraction, scope.spikes.height_um)


def _truth(pose, stored, seed):
    """Return the pose in the words of align.yaml, and what was lost."""
    return {
        "shift_um": [float(value) for value in pose.shift_um],
        "rotation_deg": float(pose.rotation_deg),
        "scale": [float(value) for value in pose.scale],
        "mirrored": bool(pose.mirrored),
        "uneven_um": [float(value) for value in pose.uneven_um],
        "tilt_mrad": [float(value) for value in pose.tilt_mrad],
        "offset_um": float(pose.offset_um),
        "missing_fraction": float(np.isnan(stored).mean()),
        "seed": int(seed),
    }

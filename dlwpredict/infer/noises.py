"""The noise of every recording: from its repeats where there are any, else from what a fit leaves."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dlwpredict.effects.plane import nearest
from dlwpredict.heightmap import HeightMap, Instrument
from dlwpredict.infer.recording import Recording, without_outliers
from dlwpredict.infer.whitened import gradient
from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.estimate import NoiseEstimate, estimate, stride_px
from dlwpredict.noise.kinds import GRAINS_PX, SMOOTHNESSES
from dlwpredict.noise.unevenness import Ground, Uneven
from dlwpredict.numerics.parallel import ALONE, Workers

SAME = 1e-6
"""Share of the largest energy below which a direction of a design is dropped."""

TOLD = 0.5
"""Directions of a design, as a share of the points that tell the noise, at most: with more, nothing is left of it."""


def noises(
    recordings: Sequence[Recording],
    residuals_um: Sequence[np.ndarray],
    designs: Sequence[np.ndarray],
    *,
    repeats: Sequence[Sequence[HeightMap]] | None = None,
    slopes: Sequence[np.ndarray | float] | None = None,
    seed: int = 0,
    workers: Workers = ALONE,
) -> list[NoiseEstimate]:
    """Estimate them: each for itself, but that recordings of one instrument share the kind of correlation.

    On a small map two kinds may be as likely, and what they say of means over wide spots differs by half.

    Parameters
    ----------
    recordings : sequence of Recording
    residuals_um : sequence of numpy.ndarray, shape (rows, cols)
        Recording − prediction, 0 where a point does not count.
    designs : sequence of numpy.ndarray, shape (columns, rows, cols)
        What may be in the residuals besides noise.
    repeats : sequence of sequence of HeightMap, optional
        Further recordings of the same print, on the same grid, for each recording; may be empty. Noise is what a
        recording differs from their mean by.
    slopes : sequence of numpy.ndarray, shape (rows, cols), optional
        |∇f| of each recording, on which its noise may hang.
    seed : int
        Of the drawn noise.
    workers : Workers
    """
    jobs = []
    for k, (recording, residual, design) in enumerate(zip(recordings, residuals_um, designs, strict=True)):
        used, source = recording.used, "residual"
        if others := (repeats or [()] * len(recordings))[k]:
            surface = nearest(np.where(used, recording.measured.heights_um - residual, 0.0), used)
            mean = np.mean([one.heights_um for one in others], axis=0)
            difference = (recording.measured.heights_um - mean) / np.sqrt(1 + 1 / len(others))
            both = replace(recording, used=used & np.isfinite(difference))
            both = without_outliers(both, np.where(both.used, difference, 0.0), surface)
            used, source = both.used, "repeats"
            residual, design = np.where(used, difference, 0.0), between_repeats(surface, recording.target)
        pitch = recording.target.dx_um, recording.target.dy_um
        slope = slopes[k] if slopes else 0.0
        ground = Ground(slope, recording.scanned_axes, recording.lean, recording.read_px)
        jobs.append((residual, used, pitch, design, ground, source, seed + k))
    estimates = workers.each(_noise, [(*job, SMOOTHNESSES) for job in jobs])
    shared = _shared_kinds([recording.measured.instrument for recording in recordings], estimates)
    anew = [k for k, kind in enumerate(shared) if kind != estimates[k].model.even.smoothness]
    for k, noise in zip(anew, workers.each(_noise, [(*jobs[k], (shared[k],)) for k in anew]), strict=True):
        estimates[k] = noise
    return estimates


def _shared_kinds(instruments: Sequence[Instrument], estimates: Sequence[NoiseEstimate]) -> list[float]:
    """Return the kind that all recordings of an instrument together make most likely, of each recording."""
    by_instrument: dict[tuple[str, float | None], Counter[float]] = defaultdict(Counter)
    for instrument, noise in zip(instruments, estimates, strict=True):
        by_instrument[instrument.kind, instrument.pitch_um].update(noise.kinds)
    likeliest = {key: min(deviances, key=deviances.__getitem__) for key, deviances in by_instrument.items()}
    return [likeliest[instrument.kind, instrument.pitch_um] for instrument in instruments]


def plane(grid: HeightMap) -> np.ndarray:
    """Return offset and tilts, what any recording may have besides noise, shape (3, rows, cols)."""
    x, y = np.broadcast_to(grid.x_um, grid.shape), np.broadcast_to(grid.y_um[:, None], grid.shape)
    return np.stack([np.ones(grid.shape), x / grid.size_um[0], y / grid.size_um[1]])


def between_repeats(surface_um: np.ndarray, grid: HeightMap) -> np.ndarray:
    """Return what two recordings of a print differ by besides noise: levelling, and where they were laid.

    A shift is ∂f/∂x and ∂f/∂y of the surface f, shape (5, rows, cols). Trace and retrace of a scan differ so as well: a
    height misread by the slope with its sign, as a feedback that lags does, is a shift.
    """
    slopes = gradient(surface_um, grid.dx_um, 1), gradient(surface_um, grid.dy_um, 0)
    return np.concatenate([plane(grid), np.stack(slopes)])


def white(recording: Recording, sigma_um: float) -> Uneven:
    """Return white noise on a recording's grid: what is assumed before any is estimated."""
    grid = recording.target
    return Uneven(Noise(sigma_um, 0.0, grid.dx_um, grid.dx_um, grid.dy_um))


def scale_um(residual_um: np.ndarray) -> float:
    """Return the standard deviation of the bulk of residuals, 1.4826·median|r|; at least 1 nm.

    Examples
    --------
    >>> round(scale_um(np.array([-0.1, 0.1, 0.1, -0.1, 50.0])), 5)
    0.14826
    """
    return max(float(1.4826 * np.median(np.abs(residual_um))), 1e-3)


def _noise(
    residual_um: np.ndarray,
    used: np.ndarray,
    pitch_um: tuple[float, float],
    design: np.ndarray,
    ground: Ground,
    source: str,
    seed: int,
    smoothnesses: Sequence[float],
) -> NoiseEstimate:
    most = max(int(TOLD * used.sum() / stride_px(ground) ** 2), 1)
    forms, kinds = compressed(design, used, most), (smoothnesses, GRAINS_PX)
    return estimate(residual_um, used, pitch_um, forms, kinds, ground=ground, source=source, seed=seed)


def compressed(columns: np.ndarray, used: np.ndarray, most: int) -> np.ndarray:
    """Return an orthogonal set of the same span, without what is nearly a combination of the others.

    Parameters
    ----------
    columns : numpy.ndarray, shape (columns, rows, cols)
    used : numpy.ndarray of bool, shape (rows, cols)
    most : int
        Directions that are kept at most, those of the largest energies.
    """
    values = columns[:, used].T
    sizes = np.linalg.norm(values, axis=0)
    values = values[:, sizes > 0] / sizes[sizes > 0]
    energies, vectors = np.linalg.eigh(values.T @ values)
    real = (energies > SAME * energies[-1]) & (np.arange(len(energies)) >= len(energies) - most)
    maps = np.zeros((int(real.sum()), *used.shape))
    maps[:, used] = ((values @ vectors[:, real]) / np.sqrt(energies[real])).T * np.sqrt(used.sum())
    return maps

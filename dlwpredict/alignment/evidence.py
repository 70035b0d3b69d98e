"""How much better one pose explains a recording than another, wavelength by wavelength."""

from __future__ import annotations

import numpy as np

from dlwpredict.alignment.likeness import KERNEL_RATIO, gaussian_reflected
from dlwpredict.alignment.refine import Fit, Level
from dlwpredict.alignment.search import correlation_area

SAME = 1e-3  # share of a target's variance that counts as nothing
RING_RATIO = 2**0.5


def explained_evidence(fit: Fit) -> float:
    """Log-likelihood ratio of what the fit leaves against the recording itself, in nats.

    Recording (less a plane) and residual are each taken for a Gaussian field with a spectrum that is constant in
    rings of half an octave; by Whittle's likelihood L = Σ_rings n/2·ln(P_recording / P_residual), n the number of
    independent modes times the share of the field that was measured, each counted by the power that smoothing has left
    of it: beyond that there is no more of a recording than the folded remainder of its walls, which any pose may happen
    to have. Correlated residuals thus count once, and fine relief on a tall block is heard beside the block. Every
    measured point counts alike: the weights of a robust fit leave out just what a wrong pose gets wrong. Compare poses
    by it, not "match" with "none": structured maps are not Gaussian.
    """
    shape = fit.level.grid[0].shape
    weights = (fit.weights > 0).astype(float)
    heights, _ = _beyond(fit, fit.level.columns[:, :3], weights)
    ring = _rings(shape)
    counted = [np.bincount(ring, _power(field * weights, shape)) for field in (heights, fit.residual)]
    modes = np.bincount(ring, _left(fit.level)) / 2 * float(np.mean(weights))
    use = np.arange(len(modes)) > 0  # ring 0: less than one period in the field
    floor = 1e-9 * counted[0].max()
    return float(np.sum(modes[use] / 2 * np.log((counted[0][use] + floor) / (counted[1][use] + floor))))


def _power(field: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    taper = np.outer(*(np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 0.5 for n in shape))
    return np.abs(np.fft.fft2(field.reshape(shape) * taper)).ravel() ** 2


def _left(level: Level) -> np.ndarray:
    """Power that the Gaussian of a level has left of each mode, 0 to 1: exp(−4π²σ²f²)."""
    rows, cols = (np.fft.fftfreq(n, level.pitch_um) for n in level.grid[0].shape)
    return np.exp(-((2 * np.pi * level.smoothing_um) ** 2) * (rows[:, None] ** 2 + cols**2)).ravel()


def _rings(shape: tuple[int, int]) -> np.ndarray:
    """Number of the ring each mode lies in: 0 below one cycle per field, then half octaves."""
    rows, cols = (np.fft.fftfreq(n) * max(shape) for n in shape)
    radius = np.hypot(rows[:, None], cols).ravel()
    return np.maximum(np.floor(np.log(np.maximum(radius, 0.1)) / np.log(RING_RATIO)).astype(int) + 1, 0)


def correlation(fit: Fit) -> float:
    """Partial correlation of recording and target at this pose, given a plane; −1 to 1, nothing fitted but a gain."""
    recorded, wanted = _beyond(fit, fit.level.columns[:, :3], fit.weights)
    return _weighted_correlation(recorded, wanted, fit.weights)


def relief_evidence(fit: Fit) -> float | None:
    """Evidence that the recording shows what the target has beyond its outline, in nats; None if it has nothing beyond.

    Two different structures on blocks of one size agree in nearly all of their variance. So inside the footprint F,
    away from its flanks, recording and target are freed of a plane and of Gσ∗F, and what is left of both is correlated:
    −n/2·ln(1 − r²), n from the `correlation_area` of what is left; 0 where r < 0 (the negative of the relief).
    """
    shape = fit.level.grid[0].shape
    inside = fit.level.outline
    within = fit.level.inside.ravel()
    if inside.mean() > 0.99 or np.sum(fit.weights[within] > 0) < 50:
        return None
    outline = [gaussian_reflected(inside * 1.0, 1.5 * KERNEL_RATIO**k).ravel() for k in range(3)]
    columns = np.column_stack([fit.level.columns[:, :3], *outline])
    weights = np.where(within, fit.weights, 0.0)
    recorded, wanted = _beyond(fit, columns, weights)
    everything = _beyond(fit, columns[:, :3], fit.weights)[1]
    if np.average(wanted**2, weights=weights) < SAME * np.average(everything**2, weights=fit.weights):
        return None
    seen = (weights > 0).reshape(shape)
    area = max(correlation_area(field.reshape(shape), seen) for field in (recorded, wanted))
    r = _weighted_correlation(recorded, wanted, weights)
    return float(-0.5 * seen.sum() / area * np.log1p(-(min(max(r, 0.0), 0.9999) ** 2)))


def _beyond(fit: Fit, columns: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Recording and target less what a weighted fit of these columns takes up."""
    fields = np.column_stack([fit.fitted + fit.residual, fit.level.target_heights.ravel()])
    root = np.sqrt(weights)[:, None]
    return tuple((fields - columns @ np.linalg.lstsq(columns * root, fields * root, rcond=None)[0]).T)


def _weighted_correlation(first: np.ndarray, second: np.ndarray, weights: np.ndarray) -> float:
    power = np.sum(weights * first**2) * np.sum(weights * second**2)
    return float(np.sum(weights * first * second) / np.sqrt(max(power, 1e-300)))

"""Every rotation, shift and mirror image tried: masked correlation with any tilt taken out."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage

from dlwpredict.alignment.pose import Pose
from dlwpredict.alignment.surface import Surface, grid_um

TARGET_PIXELS = 64  # across the target: 3° then moves its corners by about one pixel
ANGLE_STEP_DEG = 3.0
LEAST_OVERLAP = 0.35  # of the target: two shifts of 20 % and 30 % missing points leave 0.45
PEAKS_PER_ANGLE = 3


@dataclass(frozen=True)
class Peak:
    """A pose, the correlation there, the evidence for it (nats) and the area compared (µm²)."""

    pose: Pose
    correlation: float
    evidence: float
    area_um2: float


@dataclass(frozen=True)
class Search:
    """What the search found.

    Parameters
    ----------
    peaks : list of Peak
        Local maxima of the evidence over all poses, best first.
    log_odds : float
        Natural logarithm of the mean likelihood over all poses tried against no relation at all.
    pitch_um : float
        Pitch of the maps searched, µm.
    area_um2 : float
        Area that counts as one independent point, µm².
    """

    peaks: list[Peak]
    log_odds: float
    pitch_um: float
    area_um2: float


class _Scene:
    """Transforms of a coarse recording R with its mask M: M·1, x, y, x², xy, y²; R·1, x, y, R."""

    def __init__(self, heights: np.ndarray, mask: np.ndarray, room: int) -> None:
        self.view = heights.shape
        self.shape = tuple(fft.next_fast_len(n + room, real=True) for n in heights.shape)
        row, col = np.indices(heights.shape)
        planes = (np.ones(heights.shape), col / heights.shape[1] - 0.5, row / heights.shape[0] - 0.5)
        heights = np.where(mask, heights, 0.0)
        products = [mask * planes[i] * planes[j] for i in range(3) for j in range(i, 3)]
        products += [heights * plane for plane in planes] + [heights**2]
        self.transforms = fft.rfft2(np.stack(products), self.shape, workers=1)

    def correlate(self, template: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Partial correlation given a plane, and the number of shared points, at every shift (circular lags).

        Inner products of 1, x, y, R and template T over the shared mask are Fourier correlations (Padfield, IEEE
        Trans. Image Process. 21, 2706 (2012)); eliminating 1, x, y from their Gram matrix in turn leaves the
        products of what R and T have beyond a plane. Zero where less than `LEAST_OVERLAP` is shared.
        """
        heights = np.where(mask, template, 0.0)
        m, t, tt = fft.rfft2(np.stack([mask * 1.0, heights, heights**2]), self.shape, workers=1).conj()
        f = self.transforms
        products = np.concatenate([f * m, f[[0, 1, 2, 6]] * t, f[:1] * tt])
        c = fft.irfft2(products, self.shape, workers=1)
        shared = np.where(self._whole(mask.shape), c[0], 0.0)
        use = shared >= LEAST_OVERLAP * mask.sum()
        c = c[:, use]
        one, x, y, r, t = range(5)
        gram = dict(zip([(one, one), (one, x), (one, y), (x, x), (x, y), (y, y), (one, r), (x, r), (y, r), (r, r),
                         (one, t), (x, t), (y, t), (r, t), (t, t)], c, strict=True))  # fmt: skip
        for k in (one, x, y):
            norm = np.where(gram[k, k] > 0, gram[k, k], np.inf)  # an overlap one pixel wide has no slope across
            for i, j in gram:
                if k < i:
                    gram[i, j] = gram[i, j] - gram[k, i] * gram[k, j] / norm
        power = gram[r, r] * gram[t, t]
        correlation = np.zeros(shared.shape)
        clear = power > 1e-4 * (gram[r, r] * gram[t, t]).max(initial=0.0)  # flat patches correlate by rounding only
        correlation[use] = np.where(clear, gram[r, t] / np.sqrt(np.where(clear, power, 1.0)), 0.0)
        return correlation, np.where(use, shared, 0.0)

    def lags(self) -> tuple[np.ndarray, np.ndarray]:
        """Signed lag of each circular index: rows, columns."""
        rows, cols = (
            np.where(np.arange(n) < view, np.arange(n), np.arange(n) - n)
            for n, view in zip(self.shape, self.view, strict=True)
        )
        return rows, cols

    def _whole(self, side: tuple[int, int]) -> np.ndarray:
        """Tell which circular lags stand for one lag only."""
        once = [
            (np.arange(n) < n - s + 1) | (np.arange(n) >= view)
            for n, s, view in zip(self.shape, side, self.view, strict=True)
        ]
        return once[0][:, None] & once[1]


def correlation_area(heights: np.ndarray, mask: np.ndarray) -> float:
    """Points per independent point: Σ ρ(τ)² over lags, ρ the map's autocorrelation after a plane.

    The variance of the correlation of two unrelated maps is Σ ρ_R ρ_T / n (Dutilleul, Biometrics 49, 305 (1993)).
    """
    rho, _ = _Scene(heights, mask, max(heights.shape)).correlate(heights, mask)
    return float(np.sum(np.clip(rho, -1, 1) ** 2))


def search(recording: Surface, target: Surface, *, angle_step_deg: float = ANGLE_STEP_DEG) -> Search:
    """Try every rotation at every shift, as recorded and mirrored.

    The evidence of a pose with correlation r over n independent points is −n/2·ln(1 − r²): the log-likelihood ratio
    of a straight-line relation against none, for Gaussian heights. n is the shared area divided by the
    larger `correlation_area` of the two maps, so smooth maps count few points.
    """
    pitch = search_pitch(recording, target)
    heights, mask = _coarse(recording, pitch)
    blurred = target.smoothed(0.7 * pitch)
    diagonal = float(np.hypot(*target.size_um))
    frame = grid_um((diagonal, diagonal), pitch)
    area = max(correlation_area(heights, mask), correlation_area(*_coarse(target, pitch)))
    peaks, total, count = [], -np.inf, 0
    for mirrored in (False, True):
        view = (heights[:, ::-1], mask[:, ::-1]) if mirrored else (heights, mask)
        scene = _Scene(*view, room=frame[0].shape[0] * 3 // 4)
        for angle in np.arange(0, 360, angle_step_deg):
            turned = Pose.rigid((0, 0), -angle).to_recording(*frame)
            template, support = blurred.at(*turned, "linear")
            r, shared = scene.correlate(template, support > 0.5)
            evidence = np.where(r > 0, -0.5 * shared / area * np.log1p(-(np.clip(r, 0, 0.9999) ** 2)), 0.0)
            for row, col in _tops(evidence):
                shift = _shift_um(scene, frame[0].shape, row, col, pitch)
                pose = Pose.rigid(shift, angle, mirrored=mirrored)
                peaks.append(
                    Peak(pose, float(r[row, col]), float(evidence[row, col]), float(shared[row, col]) * pitch**2)
                )
            total = np.logaddexp(total, np.logaddexp.reduce(evidence[shared > 0], initial=-np.inf))
            count += int(np.sum(shared > 0))
    return Search(
        distinct(_strongest(peaks), 3 * pitch, 2.5 * angle_step_deg),
        float(total - np.log(max(count, 1))),
        pitch,
        area * pitch**2,
    )


def search_pitch(recording: Surface, target: Surface) -> float:
    """Pitch of the search, µm: 64 points across the target, at most 256 across the recording."""
    return max(max(target.size_um) / TARGET_PIXELS, max(recording.size_um) / (4 * TARGET_PIXELS))


def _coarse(surface: Surface, pitch: float) -> tuple[np.ndarray, np.ndarray]:
    heights, support = surface.smoothed(0.7 * pitch).at(*grid_um(surface.size_um, pitch))
    return heights, support > 0.5


def _tops(evidence: np.ndarray) -> np.ndarray:
    """Row and column of the highest local maxima, best first."""
    tops = np.argwhere((evidence == ndimage.maximum_filter(evidence, 5, mode="wrap")) & (evidence > 0))
    order = np.argsort(evidence[tuple(tops.T)])[::-1]
    return tops[order[:PEAKS_PER_ANGLE]]


def _shift_um(scene: _Scene, side: tuple[int, int], row: int, col: int, pitch: float) -> tuple[float, float]:
    """Shift of the template's centre from the recording's, x right, y up, µm."""
    lag_rows, lag_cols = scene.lags()
    down = lag_rows[row] + (side[0] - scene.view[0]) / 2
    right = lag_cols[col] + (side[1] - scene.view[1]) / 2
    return float(right * pitch), float(-down * pitch)


def _strongest(peaks: list[Peak], share: float = 0.3, most: int = 200) -> list[Peak]:
    """Drop peaks that no refinement will bring to the top."""
    ordered = sorted(peaks, key=lambda p: -p.evidence)[:most]
    return [p for p in ordered if p.evidence >= share * ordered[0].evidence]


def distinct(peaks: list[Peak], reach_um: float, reach_deg: float) -> list[Peak]:
    """Keep the strongest of peaks that lie within a shift and a rotation of each other, strongest first."""
    kept: list[Peak] = []
    for peak in sorted(peaks, key=lambda p: -p.evidence):
        if not any(_near(peak.pose, stronger.pose, reach_um, reach_deg) for stronger in kept):
            kept.append(peak)
    return kept


def _near(first: Pose, second: Pose, reach_um: float, reach_deg: float) -> bool:
    turn = (first.rotation_deg - second.rotation_deg + 180) % 360 - 180
    apart = math.hypot(first.shift_um[0] - second.shift_um[0], first.shift_um[1] - second.shift_um[1])
    return first.mirrored == second.mirrored and abs(turn) <= reach_deg and apart <= reach_um

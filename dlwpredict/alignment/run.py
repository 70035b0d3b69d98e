"""Align a recording to its target: the whole chain."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dlwpredict.alignment.alignment import Alignment
from dlwpredict.alignment.choose import Choice, choose, rotations
from dlwpredict.alignment.distortion import Registration, register
from dlwpredict.alignment.evidence import correlation
from dlwpredict.alignment.fill import extend, inside_hull
from dlwpredict.alignment.level import FLANK_UM, Plane, find_plane
from dlwpredict.alignment.plane import mad_sigma
from dlwpredict.alignment.pose import Pose, Wanted
from dlwpredict.alignment.refine import Level, refine
from dlwpredict.alignment.resample import prepared, resample
from dlwpredict.alignment.spikes import confirmed_spikes, suspected_spikes
from dlwpredict.alignment.surface import Surface
from dlwpredict.alignment.uncertainty import block_index
from dlwpredict.errors import InputError, ResultError
from dlwpredict.heightmap import HeightMap

DISTORTIONS: tuple[Wanted, ...] = ("auto", "rigid", "affine", "bow", "cubic")
FINEST_POINTS = 400  # across the target on the finest level: more adds time, not precision
LEAST_COVERED = 0.5
RIM = 0.1  # width of the empty frame around a target, as a share of its size


@dataclass(frozen=True, eq=False)
class _Scene:
    """Target as searched for (perhaps with an empty frame) and its surface."""

    target: HeightMap
    surface: Surface
    frame: tuple[int, int]

    @classmethod
    def of(cls, target: HeightMap, *, framed: bool) -> _Scene:
        rows, cols = (int(np.ceil(RIM * n)) if framed else 0 for n in target.shape)
        frame = rows, cols
        heights = np.pad(target.heights_um, [(n, n) for n in frame])
        known = ~np.isnan(heights)
        surface = Surface(extend(heights), known.astype(float), target.dx_um, target.dy_um)
        return cls(HeightMap(heights, target.dx_um, target.dy_um), surface, frame)

    def crop(self, heights: HeightMap) -> HeightMap:
        """Cut the frame away again."""
        inner = tuple(slice(n, size - n) for n, size in zip(self.frame, heights.shape, strict=True))
        filled = None if heights.filled is None else heights.filled[inner]
        return replace(heights, heights_um=heights.heights_um[inner], filled=filled)


def align(
    recording: HeightMap,
    target: HeightMap,
    *,
    distortion: str = "auto",
    allow_mirror: bool = False,
    keep_missing: bool = False,
    known_part: bool = False,
) -> Alignment:
    """Find a target in a recording and bring the recording onto the target's grid, levelled.

    Parameters
    ----------
    recording, target : HeightMap
    distortion : {"auto", "rigid", "affine", "bow", "cubic"}
        What the lateral mapping may do; auto lets a test decide (`dlwpredict.alignment.distortion.register`).
    allow_mirror : bool
        Turn a mirrored recording back instead of refusing it.
    keep_missing : bool
        Leave points that were not measured NaN instead of filling them.
    known_part : bool
        Do not ask whether the recording shows the target at all: of a smooth round part no figure can tell.

    Raises
    ------
    InputError
        Unknown distortion.
    ResultError
        No reliable match, a mirrored recording, or one that is smaller than the part.
    """
    if distortion not in DISTORTIONS:
        raise InputError(f"{distortion!r}", key="distortion", allowed=f"allowed: {', '.join(DISTORTIONS)}")
    _check(recording, target)
    measured = recording.measured
    rough = extend(np.where(measured, recording.heights_um, np.nan))
    suspects = suspected_spikes(rough, measured)
    surface = prepared(recording, measured & ~suspects)
    scene, choice = _choose(surface, target, known_part)
    mirrored = choice.peak.pose.mirrored
    if mirrored and not allow_mirror:
        raise ResultError("the recording is mirrored", key="mirrored", allowed="turned back with --allow-mirror")
    if mirrored:
        turned_back = recording.with_heights(recording.heights_um[:, ::-1])
        recording = replace(turned_back, instrument=recording.instrument.mirrored())
        measured, suspects, surface = measured[:, ::-1], suspects[:, ::-1], surface.mirrored()
    pose, pixel_um = choice.peak.pose, max(target.dx_um, target.dy_um)
    registration = register(_levels(surface, scene.surface), pose, distortion, pixel_um, is_round=choice.is_round)
    spikes = confirmed_spikes(recording, suspects, registration.fit)
    if not np.array_equal(spikes, suspects):
        surface = prepared(recording, measured & ~spikes)
    laid = resample(surface, inside_hull(measured & ~spikes), scene.target, registration.fit.pose)
    _check_coverage(laid, scene.target)
    margin = max(FLANK_UM, 3 * max(recording.dx_um, recording.dy_um, target.dx_um, target.dy_um))
    plane = find_plane(laid, scene.target, margin)
    x, y = np.meshgrid(scene.target.x_um, scene.target.y_um)
    level = scene.crop(replace(laid, heights_um=laid.heights_um - plane.at(x, y), height_reference=plane.reference))
    turned = recording.instrument.turned(-registration.fit.pose.rotation_deg)
    scale = recording.instrument.scale * (_shrunk(registration.fit.pose) if distortion == "auto" else 1.0)
    facts = replace(turned, pitch_um=_pitch_um(recording, registration.fit.pose), scale=scale)
    level = replace(level, instrument=facts)
    if keep_missing:
        level = replace(level, heights_um=np.where(level.measured, level.heights_um, np.nan), filled=None)
    return _report(recording, target, level, registration, choice, plane, int(spikes.sum()))


def _pitch_um(recording: HeightMap, pose: Pose) -> float:
    """Return the pitch that a map was recorded with, µm of the target."""
    own = recording.instrument.pitch_um or 0.0
    return max(own, recording.dx_um, recording.dy_um) / min(pose.scale)


def _shrunk(pose: Pose) -> float:
    """Return by which factor a recording is narrower than its target along both axes, at least: so is a print."""
    return min(max(pose.scale), 1.0)


def _check(recording: HeightMap, target: HeightMap) -> None:
    for name, part in (("recording", recording), ("target", target)):
        heights = part.heights_um[part.measured]
        if heights.size < 64:
            raise ResultError(f"{heights.size} measured points", where=name, key="heights", allowed="needs 64 or more")
        if np.ptp(heights) <= 1e-9:
            raise ResultError("featureless: all heights are equal", where=name, key="heights", allowed="needs relief")
    part = np.nan_to_num(target.heights_um) > 1e-3 * np.nanmax(np.abs(target.heights_um))
    rows, cols = np.flatnonzero(part.any(1)), np.flatnonzero(part.any(0))
    if rows.size and cols.size:
        need = sorted(((np.ptp(cols) + 1) * target.dx_um, (np.ptp(rows) + 1) * target.dy_um))
        seen = sorted(recording.size_um)
        if any(s < 0.9 * n for s, n in zip(seen, need, strict=True)):
            raise ResultError(
                f"field of {seen[1]:.4g} x {seen[0]:.4g} µm is smaller than the part",
                where="recording", key="size", allowed=f"needs {need[1]:.4g} x {need[0]:.4g} µm",
            )  # fmt: skip


def _choose(surface: Surface, target: HeightMap, known_part: bool) -> tuple[_Scene, Choice]:
    """Choose the pose, with and without an empty frame where the part reaches the target's rim.

    Where the target ends on substrate, the frame is sure: nothing was written there. Where the part reaches the rim,
    it may be cut out of something larger or stand free: the frame is taken in if the match is better with it, or if the
    inside alone does not settle the pose. Of a known part that is round, no frame is to settle the turn.
    """
    heights = target.heights_um
    rim = np.concatenate([heights[0], heights[-1], heights[:, 0], heights[:, -1]])
    bare = np.nanmean(np.abs(rim) <= 1e-3 * np.nanmax(np.abs(heights))) > 0.9
    results, problems = [], []
    for framed in (True,) if bare else (False, True):
        scene = _Scene.of(target, framed=framed)
        try:
            results.append((scene, choose(surface, scene.surface, known_part=known_part)))
        except ResultError as problem:
            problems.append(problem)
        if results and (len(results[0][1].equivalents) == 1 or (known_part and results[0][1].is_round)):
            return (scene, results[0][1]) if framed else (_framed_if_better(surface, target, scene, results[0][1]))
    if not results:
        raise problems[0]
    return min(results, key=lambda result: len(result[1].equivalents))


def _framed_if_better(surface: Surface, target: HeightMap, bare: _Scene, choice: Choice) -> tuple[_Scene, Choice]:
    """Take the frame in where the recording agrees with it: target and frame correlate better than the target alone."""
    framed, pose = _Scene.of(target, framed=True), choice.peak.pose
    view = surface.mirrored() if pose.mirrored else surface
    fits = [refine(_levels(view, scene.surface)[0], pose, "rigid") for scene in (bare, framed)]
    return (framed if correlation(fits[1]) > correlation(fits[0]) else bare), choice


def _levels(recording: Surface, target: Surface) -> list[Level]:
    """Pyramid of levels, coarse to fine, factor 2."""
    finest = max(
        min(target.dx_um, target.dy_um), min(recording.dx_um, recording.dy_um) / 2, max(target.size_um) / FINEST_POINTS
    )
    coarsest = max(max(target.size_um) / 100, finest)
    count = int(np.ceil(np.log2(coarsest / finest) - 1e-9)) + 1
    return [Level.of(recording, target, finest * 2**k) for k in reversed(range(count))]


def _check_coverage(laid: HeightMap, target: HeightMap) -> None:
    part = np.nan_to_num(target.heights_um) > 1e-3 * np.nanmax(np.abs(target.heights_um))
    if part.any() and (seen := float(laid.measured[part].mean())) < LEAST_COVERED:
        raise ResultError(
            f"only {100 * seen:.0f} % of the part was measured", where="recording", key="size",
            allowed=f"at least {100 * LEAST_COVERED:.0f} %",
        )  # fmt: skip


def _report(
    recording: HeightMap,
    target: HeightMap,
    level: HeightMap,
    registration: Registration,
    choice: Choice,
    plane: Plane,
    spikes: int,
) -> Alignment:
    pose = registration.fit.pose
    use = level.measured & ~np.isnan(target.heights_um)
    cc, cc_error = _correlation(level.heights_um[use], target.heights_um[use], block_index(target.shape)[use.ravel()])
    # plane over the target → plane over the recording: slope_q = A⁻ᵀ·slope_p, height at the recording's centre
    inverse = np.linalg.inv(np.array(pose.matrix))
    change = np.zeros((3, 3))
    change[0] = [1.0, *(-inverse @ np.array(pose.shift_um))]
    change[1:, 1:] = inverse.T
    offset, *tilt = change @ plane.coefficients
    plane_error = np.sqrt(np.diag(change @ plane.covariance @ change.T))
    error = np.sqrt(np.diag(registration.covariance))
    residual = registration.fit.residual[registration.fit.weights > 0]
    return Alignment(
        aligned=level,
        pose=pose,
        tilt_mrad=(float(1e3 * tilt[0]), float(1e3 * tilt[1])),
        offset_um=float(offset),
        cc=cc,
        missing_fraction=float(1 - recording.measured.mean()),
        rejected_spikes=spikes,
        uncertainty=_uncertainty(error, plane_error, cc_error),
        distortion=registration.distortion,
        distortion_test=registration.tests,
        symmetry=_symmetry(registration, choice),
        quality={
            "height_gain": plane.gain,
            "correlation_explained": registration.fit.correlation,
            "residual_rms_um": float(np.sqrt(np.mean(residual**2))),
            "residual_robust_um": mad_sigma(residual),
            "match_log_odds": choice.log_odds,
            "lead_log_odds": choice.lead,
        },
    )


def _uncertainty(pose: np.ndarray, plane: np.ndarray, cc: float) -> dict:
    numbers = [float(value) for value in pose]
    return {
        "shift_um": numbers[0:2],
        "rotation_deg": numbers[2],
        "scale": numbers[3:5],
        "tilt_mrad": [float(1e3 * value) for value in plane[1:]],
        "offset_um": float(plane[0]),
        "cc": cc,
        "shear_mrad": numbers[5],
        "bow_um": {"x": numbers[6:9], "y": numbers[9:12]},
        "cubic_um": numbers[12:14],
    }


def _symmetry(registration: Registration, choice: Choice) -> str:
    if not registration.rotation_known:
        return "round"
    turns = len(rotations(choice.equivalents))
    if turns > 1:
        return f"{turns}-fold"
    if any(pose.mirrored for pose in choice.equivalents):
        return "mirror"
    return "shift" if len(choice.equivalents) > 1 else "none"


def _correlation(first: np.ndarray, second: np.ndarray, blocks: np.ndarray) -> tuple[float, float]:
    """Correlation and its standard error by leaving out one block at a time (jackknife)."""
    first, second = first - first.mean(), second - second.mean()
    terms = np.stack([np.ones_like(first), first, second, first**2, second**2, first * second])
    sums = np.stack([np.bincount(blocks, term) for term in terms])
    sums = sums[:, sums[0] > 0]

    def corr(s: np.ndarray) -> np.ndarray:
        n, a, b, aa, bb, ab = s
        spread = np.maximum((aa - a * a / n) * (bb - b * b / n), 1e-300)
        return (ab - a * b / n) / np.sqrt(spread)

    total = sums.sum(1)
    if sums.shape[1] < 2:
        return float(corr(total)), 1.0
    left_out = corr(total[:, None] - sums)
    count = len(left_out)
    return float(corr(total)), float(np.sqrt((count - 1) / count * np.sum((left_out - left_out.mean()) ** 2)))

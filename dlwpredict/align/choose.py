"""Which pose is right, and whether any is: the evidence of the best against all others."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from dlwpredict.align.pose import Pose
from dlwpredict.align.refine import Level, refine
from dlwpredict.align.search import Peak, Search, near, search
from dlwpredict.align.surface import Surface
from dlwpredict.errors import ResultError

ODDS = float(np.log(100.0))  # a match, and one pose against another, is taken at 100 : 1
PEAKS = 8
CANDIDATE_POINTS = 96


@dataclass(frozen=True)
class Choice:
    """The pose chosen.

    Parameters
    ----------
    peak : Peak
    log_odds : float
        Evidence that the maps are related at all, all poses considered (nats).
    lead : float
        Evidence of the pose over the best one that is not its symmetric equivalent (nats).
    equivalents : list of Pose
        Poses that the target's own symmetry makes equal, the chosen one included.
    """

    peak: Peak
    log_odds: float
    lead: float
    equivalents: list[Pose]


def choose(recording: Surface, target: Surface) -> Choice:
    """Search all poses, refine the best ones, and take the one that stands out.

    Two questions, both by likelihood. Are the maps related: the mean likelihood over every pose tried (a uniform
    prior) must beat "no relation" 100 : 1, so that trying many poses is paid for. Which pose: the best must beat
    every other 100 : 1, except those that the target's own symmetry makes equal; of these the unmirrored one with
    the smallest rotation is taken.

    Raises
    ------
    ResultError
        No relation, or several different poses fit equally well.
    """
    found = search(recording, target)
    if not found.peaks:
        raise ResultError("no reliable match: one of the maps has no relief", key="match", allowed="needs structure")
    peaks = _refined(recording, target, found)
    best = peaks[0]
    log_odds = found.log_odds + max(best.evidence - found.peaks[0].evidence, 0.0)
    if log_odds < ODDS:
        odds = f"{np.exp(log_odds):.3g} : 1" if log_odds > 0 else f"1 : {np.exp(-log_odds):.3g}"
        raise ResultError(
            f"no reliable match: the best of all poses correlates at {best.correlation:.2f}, odds {odds}",
            key="match",
            allowed="needed 100 : 1 (unrelated or featureless maps?)",
        )
    equal = [p for p in peaks if _equivalent(target, best, p)]
    rivals = [p for p in peaks if p not in equal]
    lead = best.evidence - rivals[0].evidence if rivals else best.evidence
    if lead < ODDS:
        raise ResultError(
            f"no reliable match: {_say(best)} and {_say(rivals[0])} fit equally well",
            key="match",
            allowed="one must stand out",
        )
    ties = [p for p in equal if best.evidence - p.evidence < ODDS]
    chosen = min(ties, key=lambda p: (p.pose.mirrored, round(abs(p.pose.rotation_deg)), np.hypot(*p.pose.shift_um)))
    return Choice(chosen, log_odds, lead, [p.pose for p in ties])


def _refined(recording: Surface, target: Surface, found: Search) -> list[Peak]:
    """Refine the best peaks of either hand at a pitch finer than the search's; best first."""
    level = Level.of(recording, target, max(target.size_um) / CANDIDATE_POINTS)
    turned = Level.of(recording.mirrored(), target, level.pitch_um)
    reach = tuple(size / 2 for size in target.size_um)
    worth = [p for p in found.peaks if p.evidence > 0.3 * found.peaks[0].evidence]
    refined: list[Peak] = []
    for mirrored in (False, True):
        for peak in [p for p in worth if p.pose.mirrored == mirrored][:PEAKS]:
            fit = refine(turned if mirrored else level, replace(peak.pose, reach_um=reach), "rigid")
            shared = float(np.sum(fit.weights > 0)) * level.pitch_um**2
            r2 = min(fit.correlation, 0.9999) ** 2
            evidence = -0.5 * shared / found.area_um2 * np.log1p(-r2)
            refined.append(Peak(fit.pose, fit.correlation, float(evidence)))
    refined.sort(key=lambda p: -p.evidence)
    kept: list[Peak] = []
    for peak in refined:
        if not any(near(peak.pose, other.pose, found.pitch_um, 2.0) for other in kept):
            kept.append(peak)
    return kept


def _equivalent(target: Surface, best: Peak, other: Peak) -> bool:
    """Tell whether going over from one pose to the other leaves the target as it is, within the match's misfit."""
    if other is best:
        return True
    x, y = Level.of(target, target, max(target.size_um) / CANDIDATE_POINTS).grid
    u, v = best.pose.to_recording(x, y)
    u, v = other.pose.to_target(-u if best.pose.mirrored != other.pose.mirrored else u, v)
    here, seen = target.at(x, y, order=1)[0], target.at(u, v, order=1)
    use = seen[1] > 0.5
    if use.mean() < 0.3:
        return False
    same = float(np.corrcoef(here[use], seen[0][use])[0, 1])
    return 1 - same**2 < max(1 - best.correlation**2, 0.02) and same > 0


def _say(peak: Peak) -> str:
    x, y = peak.pose.shift_um
    hand = "mirrored, " if peak.pose.mirrored else ""
    return f"{hand}rotation {peak.pose.rotation_deg:.0f}° shift ({x:.1f}, {y:.1f}) µm"


def rotations(poses: Iterable[Pose]) -> list[float]:
    """Distinct rotations among unmirrored poses, smallest first, degrees."""
    found = {round(pose.rotation_deg, 1) for pose in poses if not pose.mirrored}
    return sorted(found, key=abs)

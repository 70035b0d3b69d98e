"""Which pose is right, and whether any is: the evidence of the best against all others."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlwpredict.alignment.evidence import correlation, explained_evidence, relief_evidence
from dlwpredict.alignment.pose import Pose
from dlwpredict.alignment.refine import SMOOTHING, Level, refine
from dlwpredict.alignment.search import Peak, Search, distinct, search
from dlwpredict.alignment.surface import Surface, grid_um
from dlwpredict.errors import ResultError

ODDS = float(np.log(100.0))  # a match, and one pose against another, is taken at 100 : 1
PEAKS = 6
TURNS_DEG = sorted({360.0 * k / n for n in (2, 3, 4, 5, 6, 8) for k in range(n)})
TURNS = 8
ODD_TURNS_DEG = (360 / 7, 360 / 11, 360 / 13)  # no regular figure but the round one stands all of them
CANDIDATE_POINTS = 96
ALIKE = 0.9  # correlation of two humps, or of one outline
UNRELATED = "unrelated or featureless maps, or a pixel pitch that is wrong by 10 % and more?"
ROUND = "the part is round and smooth: any turn does as well, and any hump is like any other"
KNOWN = "--known-part takes the best pose where you know that it is the part"
SAME = 1e-3  # share of the target's variance that two equivalent poses may differ by: sampling alone


@dataclass(frozen=True)
class _Candidate:
    """A refined pose and the evidence of the relief there (nats)."""

    peak: Peak
    relief: float


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
    is_round : bool
        Any turn leaves the target as it is.
    """

    peak: Peak
    log_odds: float
    lead: float
    equivalents: list[Pose]
    is_round: bool


def choose(recording: Surface, target: Surface, *, known_part: bool = False) -> Choice:
    """Search all poses, refine the best ones, and take the one that stands out.

    Two questions, both by likelihood. Are the maps related: the mean likelihood over every pose tried (a uniform
    prior, so that trying many poses is paid for), times that of the relief beyond the outline, must beat "no relation"
    100 : 1. Which pose: one that shows the relief, and beats every other 100 : 1 (`explained_evidence`), except those
    that the target's own symmetry makes equal; of these the unmirrored one with the smallest rotation is taken.

    ``known_part`` leaves the first question out: the user knows that the recording shows the target. Of a round part
    the second one, too: a smooth hump may lie at several places equally well, and any of them lays it on the target.

    Raises
    ------
    ResultError
        No relation, or several different poses fit equally well.
    """
    result = search(recording, target)
    if not result.peaks:
        raise ResultError("no reliable match: one of the maps has no relief", key="match", allowed="needs structure")
    candidates = _refined(recording, target, result)
    best = candidates[0].peak
    log_odds = result.log_odds + candidates[0].relief
    log_odds += max(_independent_evidence(best, result.area_um2) - result.peaks[0].evidence, 0.0)
    is_round = all(_equivalent(target, best.pose, pose) for pose in _turned(best.pose, ODD_TURNS_DEG)[:3])
    if log_odds < ODDS and not known_part:
        why = f"{ROUND if is_round else UNRELATED}; {KNOWN}" if best.correlation > ALIKE else UNRELATED
        raise ResultError(
            f"no reliable match: the best of all poses correlates at {best.correlation:.2f}, odds {odds(log_odds)}",
            key="match",
            allowed=f"needed 100 : 1 ({why})",
        )
    peaks = [candidate.peak for candidate in candidates]
    ties = [p for p in peaks if best.evidence - p.evidence < ODDS]
    odd = [p for p in ties if not _equivalent(target, best.pose, p.pose)]
    if odd and not (known_part and is_round):
        raise ResultError(
            f"no reliable match: {_say(best)} and {_say(odd[0])} fit equally well",
            key="match",
            allowed="one must stand out",
        )
    rivals = [p for p in peaks if p not in ties]
    lead = best.evidence - (rivals[0].evidence if rivals else 0.0)
    turned = [
        replace(best, pose=pose) for pose in _turned(best.pose, TURNS_DEG) if _equivalent(target, best.pose, pose)
    ]
    equal = distinct([*ties, *turned], result.pitch_um, 2.0)
    chosen = min(equal, key=lambda p: (p.pose.mirrored, round(abs(p.pose.rotation_deg)), np.hypot(*p.pose.shift_um)))
    return Choice(chosen, log_odds, lead, [p.pose for p in equal], is_round)


def odds(log_odds: float) -> str:
    """Say odds as 5 : 1 or 1 : 5."""
    return f"{np.exp(log_odds):.3g} : 1" if log_odds > 0 else f"1 : {np.exp(-log_odds):.3g}"


def _turned(pose: Pose, turns_deg: Sequence[float]) -> list[Pose]:
    """Poses that a target symmetric about its centre would make equal: turned by n-ths of a circle, and mirrored."""
    x, y = pose.shift_um
    hands = [pose, replace(Pose.rigid((-x, y), -pose.rotation_deg, mirrored=not pose.mirrored), reach_um=pose.reach_um)]
    return [
        Pose.rigid(hand.shift_um, hand.rotation_deg + turn, reach_um=pose.reach_um, mirrored=hand.mirrored)
        for hand in hands
        for turn in turns_deg
    ]


def _refined(recording: Surface, target: Surface, result: Search) -> list[_Candidate]:
    """Refine the best peaks of either hand at a pitch finer than the search's; best first.

    Poses at which the recording shows less of the relief than at another, by 100 : 1, are dropped.
    """
    level = Level.of(recording, target, max(target.size_um) / CANDIDATE_POINTS)
    turned = Level.of(recording.mirrored(), target, level.pitch_um)
    width, depth = target.size_um
    reach = width / 2, depth / 2
    refined = []
    for mirrored in (False, True):
        for peak in [p for p in result.peaks if p.pose.mirrored == mirrored][:PEAKS]:
            fit = refine(turned if mirrored else level, replace(peak.pose, reach_um=reach), "rigid", turns=TURNS)
            area = float(np.sum(fit.weights > 0)) * level.pitch_um**2
            peak = Peak(fit.pose, correlation(fit), explained_evidence(fit), area)
            refined.append(_Candidate(peak, relief_evidence(fit) or 0.0))
    most = max(candidate.relief for candidate in refined)
    showing = {id(c.peak): c for c in refined if c.relief >= most - ODDS}
    kept = distinct([c.peak for c in showing.values()], result.pitch_um, 2.0)
    return [showing[id(peak)] for peak in kept]


def _independent_evidence(peak: Peak, area_um2: float) -> float:
    """Evidence of a correlation over the shared area, as in `search`."""
    r2 = min(max(peak.correlation, 0.0), 0.9999) ** 2
    return float(-0.5 * peak.area_um2 / area_um2 * np.log1p(-r2))


def _equivalent(target: Surface, best: Pose, pose: Pose) -> bool:
    """Tell whether the target looks the same after going over from one pose to the other."""
    x, y = grid_um(target.size_um, max(target.size_um) / CANDIDATE_POINTS)
    u, v = best.to_recording(x, y)
    u, v = pose.to_target(-u if best.mirrored != pose.mirrored else u, v)
    smooth = target.smoothed(SMOOTHING * max(target.size_um) / CANDIDATE_POINTS)
    (here, _), (there, seen) = smooth.at(x, y), smooth.at(u, v)
    use = seen > 0.5
    if use.mean() < 0.3:
        return False
    return float(np.corrcoef(here[use], there[use])[0, 1]) > 1 - SAME


def _say(peak: Peak) -> str:
    x, y = peak.pose.shift_um
    hand = "mirrored, " if peak.pose.mirrored else ""
    return f"{hand}rotation {peak.pose.rotation_deg:.0f}° shift ({x:.1f}, {y:.1f}) µm"


def rotations(poses: Iterable[Pose]) -> list[float]:
    """Distinct rotations among unmirrored poses, smallest first, degrees."""
    angles = {round(pose.rotation_deg, 1) for pose in poses if not pose.mirrored}
    return sorted(angles, key=abs)

"""Whether halves of the recordings, diagnosed apart, come to the same names.

What is fitted to eight recordings may be true of three of them, or of how they were taken. A name that halves of the
recordings do not agree on is not found on them: it is a candidate.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.run import Course, diagnose
from dlwpredict.errors import ResultError
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.recording import Recording
from dlwpredict.parameters import ParameterSet

FEWEST = 4
"""Recordings that can be halved: a half holds two structures or more."""

Classes = list[frozenset[str]]
"""What one diagnosis has named: the names of every class."""


def halves(count: int, number: int, seed: int) -> list[tuple[int, ...]]:
    """Return halves of so many recordings, split at random so many times: two for each split.

    >>> [len(half) for half in halves(5, 2, seed=0)]
    [2, 3, 2, 3]
    """
    rng, drawn = np.random.default_rng([seed, 5]), []
    for _ in range(number):
        order = rng.permutation(count)
        drawn += [tuple(sorted(int(k) for k in part)) for part in (order[: count // 2], order[count // 2 :])]
    return drawn


def named_by(
    half: Sequence[int],
    recordings: Sequence[Recording],
    start: ParameterSet,
    repeats: Sequence[Sequence[HeightMap]],
    seed: int,
    course: Course,
) -> Classes:
    """Return the classes that a diagnosis of some of the recordings names."""
    further = [repeats[k] for k in half] if any(repeats) else None
    diagnosis = diagnose([recordings[k] for k in half], start, repeats=further, seed=seed, course=course)
    return [frozenset(item.names) for item in diagnosis.named]


def require_enough(count: int) -> None:
    """Refuse too few recordings.

    Raises
    ------
    ResultError
        Fewer than `FEWEST`.
    """
    if count < FEWEST:
        raise ResultError(f"{count} recordings", key="--reproducible", allowed=f"allowed: with {FEWEST} or more")


def share_of(effects: Collection[str], named: Sequence[Classes]) -> float:
    """Return the share of halves that name one of these effects.

    >>> share_of(["curl"], [[frozenset({"curl", "vignetting"})], [frozenset({"z-drift"})]])
    0.5
    """
    return float(np.mean([any(set(effects) & names for names in classes) for classes in named]))


def with_halves(content: dict[str, Any], named: Sequence[Classes]) -> dict[str, Any]:
    """Return the content of an answer with what halves of the recordings say of its names.

    Where they do not agree on the first name, nothing is identified.
    """
    findings, unsettled = [], []
    for finding in content["findings"]:
        share = share_of(finding["effects"], named)
        settled = share >= policy.REPRODUCED
        said = f"Halves of the recordings, diagnosed apart, name it in {round(share * len(named))} of {len(named)}"
        said += "." if settled else ": it is not settled."
        agreement = {"share": share, "of": len(named), "settled": settled}
        findings.append(finding | {"statement": f"{finding['statement']} {said}", "halves": agreement})
        unsettled += [] if settled else [" or ".join(finding["effects"])]
    changed: dict[str, Any] = {"findings": findings}
    if unsettled:
        changed["sentence"] = f"{content['sentence']} Not settled between halves: {', '.join(unsettled)}."
        if not findings[0]["halves"]["settled"] and content["verdict"] == "identified":
            changed["verdict"] = "ambiguous"
    return content | changed

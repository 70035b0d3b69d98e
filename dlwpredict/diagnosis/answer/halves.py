"""Whether halves of the recordings, diagnosed apart, come to the same names.

What is fitted to eight recordings may be true of three of them, or of how they were taken. A name that halves of the
recordings do not agree on is not found on them: it is a candidate.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

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


def agreeing(findings: Sequence[Collection[str]], classes: Classes) -> np.ndarray:
    """Tell which findings a half names, shape (findings,): each of its classes stands for the one that it is likest.

    As a whole: the sum of likenesses, names shared of names in either, is the largest (Kuhn, Nav. Res. Logist. Q. 2,
    83, 1955).

    Examples
    --------
    >>> agreeing([["curl", "vignetting"], ["vignetting", "z-drift"]], [frozenset({"vignetting"})]).tolist()
    [True, False]
    """
    shared = [[len(names.intersection(one)) / len(names.union(one)) for names in classes] for one in findings]
    likeness = np.array(shared).reshape(len(findings), len(classes))
    found = np.zeros(len(findings), dtype=bool)
    chosen, theirs = linear_sum_assignment(likeness, maximize=True)
    found[chosen] = likeness[chosen, theirs] > 0
    return found


def with_halves(content: dict[str, Any], chosen: Sequence[Sequence[int]], named: Sequence[Classes]) -> dict[str, Any]:
    """Return the content of an answer with what halves of the recordings say of its names.

    Where they do not agree on the first name, nothing is identified.

    Parameters
    ----------
    content : dict
    chosen : sequence of sequences of int
        Recordings of each half.
    named : sequence of Classes
        What it has named.
    """
    findings, unsettled, count = [], [], len(named)
    effects = [finding["effects"] for finding in content["findings"]]
    agree = np.sum([agreeing(effects, classes) for classes in named], axis=0, dtype=int)
    for finding, number in zip(content["findings"], agree.tolist(), strict=True):
        settled = number >= policy.REPRODUCED * count
        said = f"Halves of the recordings, diagnosed apart, name it in {number} of {count}"
        said += "." if settled else ": it is not settled."
        agreement = {"halves": count, "agree": number, "settled": settled}
        findings.append(finding | {"statement": f"{finding['statement']} {said}", "reproducible": agreement})
        unsettled += [] if settled else [" or ".join(finding["effects"])]
    asked = [
        {"recordings": list(half), "named": [sorted(names) for names in classes]}
        for half, classes in zip(chosen, named, strict=True)
    ]
    changed: dict[str, Any] = {"findings": findings, "halves": asked}
    if unsettled:
        changed["sentence"] = f"{content['sentence']} Not settled between halves: {', '.join(unsettled)}."
        if not findings[0]["reproducible"]["settled"] and content["verdict"] == "identified":
            changed["verdict"] = "ambiguous"
    return content | changed

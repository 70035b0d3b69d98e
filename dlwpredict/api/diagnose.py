"""``diagnose``: which physics the model lacks."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from html import escape
from typing import Any

import numpy as np

from dlwpredict.calibration.words import cautions_of
from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.answer.advise import advise
from dlwpredict.diagnosis.answer.content import content_of, untested
from dlwpredict.diagnosis.answer.halves import halves, named_by, with_halves
from dlwpredict.diagnosis.answer.sides import extended
from dlwpredict.diagnosis.judge import Diagnosis
from dlwpredict.diagnosis.run import Course, Stage
from dlwpredict.diagnosis.run import diagnose as search
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.free import choose
from dlwpredict.infer.model import freed
from dlwpredict.infer.trace import trace
from dlwpredict.model.levels import Levels
from dlwpredict.numerics.parallel import Workers
from dlwpredict.pairing import Pair, Pairs, ready
from dlwpredict.parameters import ParameterSet

COLD_S = 1.0
"""A first prediction that takes less is timed again: loading what it needs took part of it."""


@dataclass(frozen=True, eq=False)
class Answer:
    """What `diagnose` has found.

    Parameters
    ----------
    content : dict
        What the command writes into ``diagnosis.yaml``.
    diagnosis : Diagnosis
        All of it: fits, noise, maps of the mismatch.
    pairs : sequence of Pair
    profiled : mapping, optional
        95 % intervals of the extended fit with their profiles; None while the search goes on.
    """

    content: Mapping[str, Any]
    diagnosis: Diagnosis
    pairs: Sequence[Pair]
    profiled: Mapping[str, tuple[float, float]] | None = None

    @classmethod
    def of(
        cls, diagnosis: Diagnosis, pairs: Sequence[Pair], profiled: Mapping[str, tuple[float, float]] | None = None
    ) -> Answer:
        """Put a diagnosis into words."""
        return cls(content_of(diagnosis, profiled), diagnosis, pairs, profiled)

    @cached_property
    def parameters(self) -> ParameterSet:
        """The process with the effects found, for `predict` and `precompensate`."""
        return extended(self.diagnosis, self.profiled)

    @property
    def verdict(self) -> str:
        """Identified, ambiguous, unexplained or none."""
        return str(self.content["verdict"])

    @property
    def findings(self) -> list[dict[str, Any]]:
        """One entry for each effect or class of look-alikes: names, side, probability, intervals, a statement."""
        return list(self.content["findings"])

    @property
    def cautions(self) -> list[str]:
        """What should be known wherever the extended process is used."""
        remainder, said = self.content["remainder"], []
        if not self.content.get("complete", True):
            said.append(
                "the diagnosis was ended before it was complete: other effects may explain the recordings better"
            )
        if self.verdict == "unexplained" and not self.diagnosis.named:
            said.append("the diagnosis is 'unexplained': what the seven parameters leave has no name")
        elif self.verdict == "unexplained" and not self.diagnosis.predicts_better:
            said.append("the diagnosis is 'unexplained': its effects do not predict better what was held out")
        elif self.verdict == "unexplained":
            share = f"{100 * (1 - self.diagnosis.explained):.0f} %"
            said.append(
                f"the diagnosis is 'unexplained': {share} of the mismatch has no name; its effects may stand in for it"
            )
        elif remainder["significant"]:
            said.append(f"the diagnosis left {remainder['rms_um']:.3g} µm beyond noise that no named effect explains")
        return said + cautions_of(self.diagnosis.recordings)

    def maps(self, k: int) -> dict[str, HeightMap]:
        """Return the maps of pair k, from 0, on the pixels that it came on.

        Returns
        -------
        dict
            ``residual``, recording − baseline, what is ``explained`` by the named effects, and the ``remainder``, µm;
            ``mismatch``, how surely a place differs beyond noise, 0 to 1. NaN where a point does not count.
        """
        return {name: self.pairs[k].fine(values) for name, values in self.working_maps(k).items()}

    def working_maps(self, k: int) -> dict[str, np.ndarray]:
        """Return the same on working pixels, shape (rows, cols)."""
        found, used = self.diagnosis, self.diagnosis.recordings[k].used
        residual, remainder = found.baseline.fit.residual_um(k), found.extended.fit.residual_um(k)
        return {
            "residual": residual,
            "mismatch": np.where(used, found.mismatch[k], np.nan),
            "explained": residual - remainder,
            "remainder": remainder,
        }

    def __repr__(self) -> str:
        return "\n".join([self.content["sentence"], *(f"- {finding['statement']}" for finding in self.findings)])

    def _repr_html_(self) -> str:
        first, *statements = str(self).split("\n- ")
        items = "".join(f"<li>{escape(statement)}</li>" for statement in statements)
        return f"<p><b>{escape(first)}</b></p><ul>{items}</ul>"


def diagnose(
    pairs: Pairs,
    start: ParameterSet | None = None,
    *,
    holdout: Pairs = (),
    advice: bool = False,
    seed: int = 0,
    processes: int = 1,
    course: Course | None = None,
    **settings: Any,
) -> Answer:
    """Find out which physics the model lacks.

    Parameters
    ----------
    pairs : sequence of (target, recording)
        The recording on the target's grid: a `HeightMap`, or what `align` has returned. Two or three different
        structures say much more than one.
    start : ParameterSet, optional
        Default: the paper's.
    holdout : sequence of (target, recording)
        Predicted, and never used in a fit or a choice.
    advice : bool
        Simulate the recordings that would tell look-alikes apart: ``separate_by`` of the findings.
    seed : int
    processes : int
        How many share the work. With more than one, a script must stand under ``if __name__ == "__main__":``.
    course : diagnosis.run.Course, optional
        Who is told what goes on and given every answer on the way, and the fits of an interrupted run.
    **settings
        ``wall_px``: points so near to a wall do not count. ``working_pitch_um``: pixels are averaged to about this
        pitch; by default, to what the focus allows.
    """
    start, course = start or ParameterSet(), course or Course()
    seen, unseen = (ready(some, start, **settings) for some in (pairs, holdout))
    with Workers(processes, search.__module__) as workers:
        diagnosis = search(
            [pair.recording for pair in seen],
            start,
            repeats=[pair.repeats for pair in seen],
            holdout=[pair.recording for pair in unseen],
            seed=seed,
            course=replace(course, workers=workers),
        )
        course.tell(Stage("judgement", 0.95, "intervals, and what to record next"))
        answer = Answer.of(diagnosis, seen, diagnosis.intervals(diagnosis.extended.fit, profiles=True).as_dict())
        return _advised(answer) if advice else answer


def in_halves(
    answer: Answer, start: ParameterSet, *, seed: int = 0, processes: int = 1, course: Course | None = None
) -> Answer:
    """Diagnose ten halves of four or more recordings: an answer on which they do not agree is not settled.

    Parameters
    ----------
    answer : Answer
        To all of the recordings.
    start : ParameterSet
    seed, processes, course
        As in `diagnose`.

    Returns
    -------
    Answer
        Each finding says in how many of the halves it was named.
    """
    course = course or Course()
    recordings, repeats = [pair.recording for pair in answer.pairs], [pair.repeats for pair in answer.pairs]
    chosen, named = halves(len(recordings), policy.SPLITS, seed), []
    with Workers(processes, search.__module__) as workers:
        for number, half in enumerate(chosen, start=1):
            course.tell(Stage("judgement", (number - 1) / len(chosen), f"half {number} of {len(chosen)}"))
            own = Course(workers=workers, work=course.work, stored=course.stored.setdefault(f"half {half}", {}))
            named.append(named_by(half, recordings, start, repeats, seed, own))
    return replace(answer, content=with_halves(dict(answer.content), chosen, named))


def first_look(pairs: Sequence[Pair], start: ParameterSet) -> tuple[dict[str, Any], float]:
    """Predict all recordings once.

    Returns
    -------
    content : dict
        Of the answer before anything was fitted.
    seconds : float
        That a prediction takes.
    """
    recordings, free = [pair.recording for pair in pairs], freed(start, choose(start))
    for _ in range(2):
        begun = time.perf_counter()
        predicted = [trace(recording.target, start, Levels()).heights_um for recording in recordings]
        took = time.perf_counter() - begun
        if took > COLD_S:
            break
    return untested(recordings, predicted, free), took


def _advised(answer: Answer) -> Answer:
    """Add to every class the recording that would tell its members apart."""
    found, findings = answer.diagnosis, []
    for item, finding in zip(found.named, answer.findings, strict=True):
        if len(item.members) > 1:
            advice = advise(found.baseline.fit, [member.effect for member in item.members])
            sentence, command = (advice.sentence, advice.command) if advice else (None, None)
            finding = finding | {"separate_by": sentence, "separate_command": command}
        findings.append(finding)
    return replace(answer, content={**answer.content, "findings": findings})

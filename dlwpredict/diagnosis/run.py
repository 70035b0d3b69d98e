"""`diagnose`: from pairs of target and recording to what is missing in the model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.classes import Named, named_in
from dlwpredict.diagnosis.library.score import Linearised, Thresholds
from dlwpredict.diagnosis.library.signatures import Signatures
from dlwpredict.diagnosis.search import Names, Search
from dlwpredict.diagnosis.structure.columns import Columns
from dlwpredict.diagnosis.structure.forms import Energy, Forms, agreement
from dlwpredict.diagnosis.structure.freeform import smooth_forms
from dlwpredict.diagnosis.structure.places import Place, locate
from dlwpredict.diagnosis.structure.spots import Bumps
from dlwpredict.diagnosis.structure.test import SINGLE, Model
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer import held_out
from dlwpredict.infer.baseline import fitter_of, rough, unsaid
from dlwpredict.infer.fitter import Fitter, Start
from dlwpredict.infer.free import choose
from dlwpredict.infer.intervals import Intervals, intervals
from dlwpredict.infer.model import freed
from dlwpredict.infer.noises import noises, white
from dlwpredict.infer.null import Null
from dlwpredict.infer.objective import Fit, Objective, Work, nothing
from dlwpredict.infer.priors import PARAMETERS
from dlwpredict.infer.recording import Recording, check_points, doubted
from dlwpredict.infer.whitened import Whitened, gradient, steepness
from dlwpredict.noise.estimate import NoiseEstimate
from dlwpredict.noise.unevenness import Uneven
from dlwpredict.numerics.parallel import ALONE, Workers
from dlwpredict.parameters import ParameterSet

STAGES = {"fit": 0.12, "signatures": 0.2, "noise": 0.15, "screen": 0.13, "refits": 0.3, "judgement": 0.1}
"""What is done, in order, each with about its share of the time where one effect is found."""


DOUBTED_UM = 0.01
"""Noise by which a recording held out is registered before its own is estimated."""


@dataclass(frozen=True)
class Stage:
    """What is going on.

    Parameters
    ----------
    name : str
    share : float
        Of the whole that is done, 0 to 1.
    text : str
        In words.
    """

    name: str
    share: float
    text: str

    @classmethod
    def of(cls, name: str, text: str) -> Stage:
        """Begin a stage."""
        return cls(name, sum(list(STAGES.values())[: list(STAGES).index(name)]), text)

    @property
    def number(self) -> int:
        """Its place, from 1."""
        return list(STAGES).index(self.name) + 1


@dataclass(eq=False)
class Course:
    """How a diagnosis is carried out, whatever it says.

    Parameters
    ----------
    tell : function of Stage
        Told what goes on.
    keep : function of Diagnosis
        Given every answer that is valid already, complete or not.
    workers : Workers
        Who share what can be done at once.
    work : Work
        Counts the predictions.
    stored : dict
        Best fits of an interrupted run of the same command; those of this one are added as they are found.
    """

    tell: Callable[[Stage], None] = nothing
    keep: Callable[[Diagnosis], None] = nothing
    workers: Workers = ALONE
    work: Work = field(default_factory=Work)
    stored: dict[str, dict[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What the recordings say about the model.

    Parameters
    ----------
    recordings : tuple of Recording
    noises : tuple of NoiseEstimate
    baseline, extended : Model
        The same object where nothing was named.
    named : tuple of Named
        Effects that were added, strongest first.
    screen : Linearised
        Scores beside the baseline.
    thresholds : Thresholds
    null : Null
    fitter : Fitter
    agreement : Energy or None
        Whether every recording alone would give the same parameters.
    places : tuple of Place
        Where the baseline's mismatch sits.
    mismatch : tuple of numpy.ndarray, shape (rows, cols)
        How surely each pixel differs from the baseline beyond noise, 0 to 1.
    holdout : tuple of Whitened
        Recordings that no fit has seen.
    not_tried : tuple of str
        Effects that no refit has tried yet although the screen points at them; empty where the search is complete.
    complete : bool
    """

    recordings: tuple[Recording, ...]
    noises: tuple[NoiseEstimate, ...]
    baseline: Model
    extended: Model
    named: tuple[Named, ...]
    screen: Linearised
    thresholds: Thresholds
    null: Null
    fitter: Fitter
    agreement: Energy | None
    places: tuple[Place, ...]
    mismatch: tuple[np.ndarray, ...]
    holdout: tuple[Whitened, ...] = ()
    not_tried: tuple[str, ...] = ()
    complete: bool = True

    @property
    def holdout_by(self) -> str:
        """How data are kept from the fits."""
        if self.holdout:
            return "recordings held out"
        return "recordings left out in turn" if len(self.recordings) > 1 else "blocks left out in turn"

    def held_out_um(self, fitted: Fit) -> float | None:
        """Return the root mean square error of a fit on data that it has not seen, µm."""
        if self.holdout:
            seen = replace(self.fitter.objective, data=self.holdout, work=Work())
            return seen.at(fitted.free, fitted.vector).rmse_um()
        fitted = self.fitter.objective.whole(fitted)
        found = held_out.recordings(fitted) or held_out.blocks(fitted)
        return found.rmse_um if found else None

    def intervals(self, fitted: Fit, *, profiles: bool = False) -> Intervals:
        """Return the 95 % intervals of a fit; with profiles where the strengths of its effects need them."""
        objective, own = self.fitter.objective, [name for name in fitted.free.names if "." in name]
        return intervals(objective.whole(fitted), self.null, objective if profiles else None, own, objective.work)

    @property
    def explained(self) -> float:
        """Share of what free forms, a ripple, a spot and columns explain that the named effects explain, 0 to 1."""
        whole = self.baseline.left
        return float(np.clip(1 - self.extended.left / whole, 0, 1)) if whole > 0 else 1.0

    @property
    def verdict(self) -> str:
        """The strongest statement that the data allow: identified, ambiguous, unexplained or none."""
        if self.extended.unexplained and self.explained < policy.EXPLAINED:
            return "unexplained"
        if not self.named:
            return "none"
        return "identified" if len(self.named[0].names) == 1 else "ambiguous"


def diagnose(
    recordings: Sequence[Recording],
    start: ParameterSet,
    *,
    repeats: Sequence[Sequence[HeightMap]] | None = None,
    holdout: Sequence[Recording] = (),
    seed: int = 0,
    course: Course | None = None,
) -> Diagnosis:
    """Find out what the model lacks.

    Fit; estimate the noise beside everything that might be in the residual; then linearise, enumerate sets of effects
    and refit the leading ones; estimate the noise beside the best set; again, until the set that the noise was
    estimated beside stays the best.

    Parameters
    ----------
    recordings : sequence of Recording
        From `prepare`, on the pixels that they are to be worked on.
    start : ParameterSet
        Effects that it holds belong to the baseline.
    repeats : sequence of sequence of HeightMap, optional
        Further recordings of the same prints, for each recording.
    holdout : sequence of Recording
        Scored, never used in a fit or a choice.
    seed : int
    course : Course, optional

    Raises
    ------
    ResultError
        Too few points.
    """
    check_points(recordings)
    course = course or Course()
    tell, keep, workers, work, stored = course.tell, course.keep, course.workers, course.work, course.stored
    start = unsaid(start)
    free = freed(start, choose(start))
    tell(Stage.of("fit", "fitting the seven"))
    recordings, first = rough([doubted(r) for r in recordings], free, PARAMETERS, work)
    objective = Objective(first.data, PARAMETERS, work)
    tell(Stage.of("signatures", "what each named effect would change"))
    signatures: dict[Names, Signatures] = {frozenset(): Signatures.of(first, (), work, workers)}
    slopes = [steepness(one.heights_um, r.target) for one, r in zip(first.traces, recordings, strict=True)]
    designs = _designs(first, signatures[frozenset()], objective)

    def noise_beside(fit: Fit) -> list[NoiseEstimate]:
        """Estimate the noise from what a fit leaves."""
        left = fit.residuals_um()
        return noises(recordings, left, designs, repeats=repeats, slopes=slopes, seed=seed, workers=workers)

    tell(Stage.of("noise", "estimating the noise"))
    better, noise = noise_beside(first), None
    best: Names = frozenset()
    ended: list[Start] = []
    for number in range(policy.ROUNDS):
        if noise is None or not _alike(noise, better):
            noise, own = better, stored.setdefault(f"round {number}", {})
            fitter = fitter_of(recordings, _models(noise), slopes, first, objective, workers=workers, stored=own)
            tell(Stage.of("screen", "scoring every named effect"))
            baseline = fitter.best(Start(first.parameters))
            null = Null.of(baseline.data, fitter.objective.rows, noise, seed, workers=workers)
            judge = _Judge(recordings, noise, baseline, fitter, null, holdout, seed)
            search = Search(fitter, null, baseline, signatures)
            keep(judge.answer(search, frozenset(), complete=False))
            tell(Stage.of("refits", "refitting the leading sets of effects"))
            search.begin_with(ended)
        beside, best = best, search.round()
        if best == beside:
            break
        keep(judge.answer(search, best, complete=False))
        better, first, ended = noise_beside(search.fitted[best]), baseline, search.near()
    tell(Stage.of("judgement", "judging what is left"))
    answer = judge.answer(search, best, complete=True)
    keep(answer)
    return answer


class _Judge:
    """Turns a state of the search into an answer; what hangs on the baseline alone is computed once."""

    def __init__(
        self,
        recordings: Sequence[Recording],
        noise: Sequence[NoiseEstimate],
        baseline: Fit,
        fitter: Fitter,
        null: Null,
        holdout: Sequence[Recording],
        seed: int,
    ) -> None:
        self.recordings, self.noise, self.fitter, self.null = tuple(recordings), tuple(noise), fitter, null
        self.forms = Forms.of(baseline)
        self.bumps = [Bumps.of(item, seed=k) for k, item in enumerate(baseline.data)]
        self.baseline = Model.of(baseline, self.forms, self.bumps, Columns.of(noise), null)
        strange = [one for one in self.baseline.patterns if one.p_value < SINGLE]
        self.places, self.mismatch = locate(baseline, self.forms, self.baseline.beside, self.bumps, strange)
        self.agreement = agreement(baseline, self.baseline.draws)
        self.holdout = tuple(_held_out(doubted(r), baseline, fitter.objective, seed) for r in holdout)
        self.models: dict[Names, Model] = {frozenset(): self.baseline}

    def answer(self, search: Search, names: Names, *, complete: bool) -> Diagnosis:
        """Return the answer that the best set so far gives."""
        if names not in self.models:
            fit = search.fitted[names]
            found = Model.of(fit, self.forms, self.bumps, self.baseline.columns, self.null)
            self.models = {frozenset(): self.baseline, names: found}
        extended = self.models[names]
        left = extended.left if extended.unexplained else 0.0
        tried = frozenset().union(*search.fitted)
        return Diagnosis(
            self.recordings,
            self.noise,
            self.baseline,
            extended,
            tuple(named_in(search, names, left)) if complete or names else (),
            search.first,
            search.asked,
            self.null,
            self.fitter,
            self.agreement,
            tuple(self.places),
            tuple(self.mismatch),
            self.holdout,
            () if complete else tuple(sorted(set(search.first.names) - tried)),
            complete,
        )


def _held_out(recording: Recording, baseline: Fit, objective: Objective, seed: int) -> Whitened:
    """Whiten a recording by the noise of its own."""
    rough_item = Whitened.of(recording, white(recording, DOUBTED_UM))
    seen = replace(objective, data=(rough_item,), work=Work()).at(baseline.free, baseline.vector)
    slope = steepness(seen.traces[0].heights_um, recording.target)
    noise = noises([recording], seen.residuals_um(), [smooth_forms(recording.target)], slopes=[slope], seed=seed)[0]
    return replace(Whitened.of(recording, noise.model, slope), shift_um=seen.data[0].shift_um)


def _designs(first: Fit, signatures: Signatures, objective: Objective) -> list[np.ndarray]:
    """Return what may be in each recording's residual besides noise, shape (columns, rows, cols)."""
    derivatives = objective.derivatives(first, range(len(first.free.names)))
    designs = []
    for k, item in enumerate(first.data):
        grid, predicted = item.recording.target, first.traces[k].heights_um
        shifts = gradient(predicted, grid.dx_um, 1), gradient(predicted, grid.dy_um, 0)
        named = np.stack([maps[k] for maps in signatures.maps_um])
        designs.append(np.concatenate([smooth_forms(grid), derivatives[k], np.stack(shifts), named]))
    return designs


def _models(noise: Sequence[NoiseEstimate]) -> list[Uneven]:
    return [estimate.model for estimate in noise]


def _alike(noise: Sequence[NoiseEstimate], other: Sequence[NoiseEstimate]) -> bool:
    """Tell whether two models of noise are uneven in the same ways, and else the same to the accuracy of estimates."""
    for one, two in zip(_models(noise), _models(other), strict=True):
        pairs = (one.sigma_um, two.sigma_um), (one.even.length_um, two.even.length_um)
        if one.ways != two.ways or any(abs(np.log(a / b)) >= policy.ALIKE for a, b in pairs):
            return False
    return True

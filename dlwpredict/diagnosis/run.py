"""`diagnose`: from pairs of target and recording to what is missing in the model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.judge import Diagnosis, Judge, registered
from dlwpredict.diagnosis.library.seams import seams
from dlwpredict.diagnosis.library.signatures import Signatures
from dlwpredict.diagnosis.search import Names, Search
from dlwpredict.diagnosis.structure.blemishes import Blemish
from dlwpredict.diagnosis.structure.freeform import smooth_forms
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.baseline import fitter_of, rough, unsaid
from dlwpredict.infer.fitter import Start
from dlwpredict.infer.free import choose
from dlwpredict.infer.model import freed, key_of
from dlwpredict.infer.noises import noises
from dlwpredict.infer.null import Null
from dlwpredict.infer.objective import Fit, Objective, Work, nothing
from dlwpredict.infer.priors import PARAMETERS
from dlwpredict.infer.recording import Recording, check_points, doubted, require_points
from dlwpredict.infer.whitened import gradient, steepness
from dlwpredict.noise.estimate import NoiseEstimate
from dlwpredict.noise.unevenness import Uneven
from dlwpredict.numerics.parallel import ALONE, Workers
from dlwpredict.parameters import ParameterSet

STAGES = {"fit": 0.12, "signatures": 0.2, "noise": 0.15, "screen": 0.13, "refits": 0.3, "judgement": 0.1}
"""What is done, in order, each with about its share of the time where one effect is found."""


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
    and refit the leading ones; estimate the noise beside the best set, where it has other effects; again, until the set
    stays the best. A spot that explains more than any further effect is left out first.

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
    require_points(holdout)
    course = course or Course()
    tell, keep, workers, work, stored = course.tell, course.keep, course.workers, course.work, course.stored
    start = unsaid(start)
    free = freed(start, choose(start))
    tell(Stage.of("fit", "fitting the seven"))
    recordings, first = rough([doubted(r) for r in recordings], free, PARAMETERS, work)
    objective = Objective(first.data, PARAMETERS, work)
    tell(Stage.of("signatures", "what each named effect would change"))
    found = seams(first)
    signatures = {key_of(first.free): Signatures.of(first, (), work, workers, found.placed)}
    slopes = [steepness(one.heights_um, r.target) for one, r in zip(first.traces, recordings, strict=True)]
    designs = _designs(first, signatures[key_of(first.free)], objective)

    def noise_beside(fit: Fit) -> list[NoiseEstimate]:
        """Estimate the noise from what a fit leaves."""
        left = fit.residuals_um()
        return noises(recordings, left, designs, repeats=repeats, slopes=slopes, seed=seed, workers=workers)

    tell(Stage.of("noise", "estimating the noise"))
    better, noise = noise_beside(first), None
    apart = registered(holdout, first, objective) if holdout else ()
    best: Names = frozenset()
    ended: list[Start] = []
    left_out: list[Blemish] = []
    blemish, rounds = None, 0
    while rounds < policy.ROUNDS or blemish:
        if noise is None or blemish or not _alike(noise, better):
            noise, own = better, stored.setdefault(f"round {rounds} without {len(left_out)} spots", {})
            fitter = fitter_of(recordings, _models(noise), slopes, first, objective, workers=workers, stored=own)
            tell(Stage.of("screen", "scoring every named effect"))
            baseline = fitter.best(Start(first.parameters, settled=bool(rounds or left_out)))
            null = Null.of(baseline.data, fitter.objective.rows, noise, seed, workers=workers)
            judge = Judge(recordings, noise, baseline, fitter, null, apart, left_out)
            search = Search(fitter, null, baseline, signatures, {"stitching": found.price})
            keep(judge.answer(search, frozenset(), complete=False))
            tell(Stage.of("refits", "refitting the leading sets of effects"))
            search.begin_with(ended)
        beside, blemish = best, None if best else judge.blemish(search, best)  # beside names refits must tell
        if not blemish:
            known = search.key(beside)
            best, rounds = search.round(), rounds + 1
            blemish = judge.blemish(search, beside)
        if blemish:
            best, left_out = beside, [*left_out, blemish]
            recordings = [blemish.left_out_of(r) if k == blemish.pair else r for k, r in enumerate(recordings)]
        elif search.key(best) == known:
            break
        search.polish(best)
        keep(judge.answer(search, best, complete=False))
        if blemish or best != beside:  # one more switch of the same effects leaves the noise as it is
            better, first, ended = noise_beside(search.fitted[best]), baseline, search.near(best)
    tell(Stage.of("judgement", "judging what is left"))
    search.polish(best)
    answer = judge.answer(search, best, complete=True)
    keep(answer)
    return answer


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

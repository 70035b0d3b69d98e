"""What a state of the search says: the answer, with everything that it rests on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.classes import Named, named_in
from dlwpredict.diagnosis.library.process_form import doubts
from dlwpredict.diagnosis.library.score import Linearised, Thresholds
from dlwpredict.diagnosis.search import Names, Search
from dlwpredict.diagnosis.structure.blemishes import Blemish, blemish, suspected
from dlwpredict.diagnosis.structure.columns import Columns
from dlwpredict.diagnosis.structure.forms import Energy, Forms, agreement
from dlwpredict.diagnosis.structure.places import Place, locate
from dlwpredict.diagnosis.structure.spots import Bumps
from dlwpredict.diagnosis.structure.test import SINGLE, Model
from dlwpredict.infer import held_out
from dlwpredict.infer.fitter import Fitter
from dlwpredict.infer.intervals import Intervals, intervals
from dlwpredict.infer.noises import white
from dlwpredict.infer.null import Null
from dlwpredict.infer.objective import Fit, Objective, Work
from dlwpredict.infer.recording import Recording, doubted
from dlwpredict.infer.whitened import Whitened
from dlwpredict.noise.estimate import NoiseEstimate

ALIKE_UM = 0.01
"""Noise by which a recording held out is registered, the same at every pixel."""


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
        Whether every recording alone would give the same parameters, beside the baseline.
    places : tuple of Place
        Where the baseline's mismatch sits.
    mismatch : tuple of numpy.ndarray, shape (rows, cols)
        How surely each pixel differs from the baseline beyond noise, 0 to 1.
    holdout : tuple of Whitened
        Recordings that no fit has seen.
    blemishes : tuple of Blemish
        Spots whose points were left out of everything.
    doubted : tuple of str
        Effects that explain more than noise, but no more than the form of the process itself might.
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
    blemishes: tuple[Blemish, ...] = ()
    doubted: tuple[str, ...] = ()
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
        width_um = min(held_out.block_um(model.fit) for model in (self.baseline, self.extended))
        found = held_out.recordings(fitted) or held_out.blocks(fitted, width_um=width_um)
        return found.rmse_um if found else None

    @cached_property
    def together(self) -> Energy | None:
        """Whether every recording alone would give the same process beside what was named; of one, its blocks."""
        return agreement(self.fitter.objective.whole(self.extended.fit), self.extended.draws)

    @property
    def predicts_better(self) -> bool:
        """Whether what was named lowers the error on recordings held out; so where there are none.

        What is left out in turn is no judge: a fit to fewer data predicts worse, right names or not, where one
        recording alone hardly tells them from the process. And a right name's formula is wrong by some per cent, by
        which recordings disagree about its strength.
        """
        if not self.holdout:
            return True
        before, after = (self.held_out_um(model.fit) for model in (self.baseline, self.extended))
        return before is None or after is None or after < before

    def intervals(self, fitted: Fit, *, profiles: bool = False) -> Intervals:
        """Return the 95 % intervals of a fit; with profiles where the strengths of its effects need them.

        The form of the process may be wrong beside what was named as far as it is doubted everywhere.
        """
        objective, own = self.fitter.objective, [name for name in fitted.free.names if "." in name]
        whole, profiled = objective.whole(fitted), objective if profiles else None
        return intervals(whole, self.null, profiled, own, objective.work, doubts(whole, objective))

    @property
    def explained(self) -> float:
        """Share of what there is to explain that the named effects explain, 0 to 1.

        That is what free forms, a ripple, a spot and columns find beside the baseline, and no less than what the names
        have gained and these still find beside them: no free form follows a seam, or a rim at the ends of lines.
        """
        gained = self.baseline.fit.cost - self.extended.fit.cost
        whole = max(self.baseline.left, gained + self.extended.left)
        return float(np.clip(1 - self.extended.left / whole, 0, 1)) if whole > 0 else 1.0

    @property
    def verdict(self) -> str:
        """The strongest statement that the data allow: identified, ambiguous, unexplained or none."""
        if self.extended.unexplained and self.explained < policy.EXPLAINED:
            return "unexplained"
        if not self.named:
            return "unexplained" if self.doubted else "none"
        if not self.predicts_better:
            return "unexplained"
        return "identified" if len(self.named[0].names) == 1 else "ambiguous"


class Judge:
    """Turns a state of the search into an answer; what hangs on the baseline alone is computed once."""

    def __init__(
        self,
        recordings: Sequence[Recording],
        noise: Sequence[NoiseEstimate],
        baseline: Fit,
        fitter: Fitter,
        null: Null,
        holdout: Sequence[Whitened] = (),
        left_out: Sequence[Blemish] = (),
    ) -> None:
        self.recordings, self.noise, self.fitter, self.null = tuple(recordings), tuple(noise), fitter, null
        self.forms = Forms.of(baseline)
        self.bumps = [Bumps.of(item, seed=k) for k, item in enumerate(baseline.data)]
        self.holdout, self.left_out = tuple(holdout), tuple(left_out)
        self.baseline = Model.of(baseline, self.forms, self.bumps, Columns.of(noise), null, self.left_out)
        strange = [one for one in self.baseline.residual if one.p_value < SINGLE]
        beside = self.baseline.beside
        self.places, self.mismatch = locate(baseline, self.forms, beside, self.bumps, strange, self.left_out)
        self.agreement = agreement(baseline, self.baseline.draws)
        self.models: dict[Names, Model] = {frozenset(): self.baseline}

    def model(self, search: Search, names: Names) -> Model:
        """Return the tests of the best fit of a set."""
        fit, columns = search.converged(names), self.baseline.columns
        if names not in self.models or self.models[names].fit is not fit:
            model = Model.of(fit, self.forms, self.bumps, columns, self.null, self.left_out)
            self.models = {frozenset(): self.baseline, names: model}
        return self.models[names]

    def blemish(self, search: Search, names: Names) -> Blemish | None:
        """Return the spot, if any, that explains more of what a set leaves than any other set would.

        By as much more as one more effect would have to gain: a spot is one more thing to believe in.
        """
        model = self.model(search, names)
        if len(self.left_out) == policy.BLEMISHES or not suspected(model):
            return None
        more = search.price(len(names) + 1) - search.price(len(names))
        return blemish(model, self.bumps[model.spot.pair], search.promised(names) + more)

    def answer(self, search: Search, names: Names, *, complete: bool) -> Diagnosis:
        """Return the answer that the best set so far gives."""
        extended = self.model(search, names)
        left = extended.left if extended.unexplained else 0.0
        tried = frozenset().union(*search.fitted)
        named = tuple(named_in(search, names, left)) if complete or names else ()
        said = {name for one in named for name in one.names}
        return Diagnosis(
            self.recordings,
            self.noise,
            self.baseline,
            extended,
            named,
            search.first,
            search.asked,
            self.null,
            self.fitter,
            self.agreement,
            tuple(self.places),
            tuple(self.mismatch),
            self.holdout,
            self.left_out,
            tuple(name for name in search.doubted(names) if name not in said),
            () if complete else tuple(sorted(set(search.first.names) - tried)),
            complete,
        )


def registered(holdout: Sequence[Recording], fitted: Fit, objective: Objective) -> tuple[Whitened, ...]:
    """Return recordings held out, each levelled and moved so that least squares of its residual are left by a fit.

    As an error of prediction is counted. Noise that differs from line to line leaves offset and tilt nearly open: what
    would be likeliest beside it is no measure of a prediction.
    """
    some = [doubted(recording) for recording in holdout]
    data = tuple(Whitened.of(recording, white(recording, ALIKE_UM)) for recording in some)
    return replace(objective, data=data, work=Work()).at(fitted.free, fitted.vector).data

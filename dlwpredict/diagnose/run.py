"""`diagnose`: from pairs of target and recording to what is missing in the model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlwpredict.calibrate.recordings import Recording, check_points
from dlwpredict.diagnose import left_out
from dlwpredict.diagnose.around import Around
from dlwpredict.diagnose.attempts import Attempts
from dlwpredict.diagnose.baseline import calibrated, discretisation_um, likely, noises, without_spikes
from dlwpredict.diagnose.columns import Columns
from dlwpredict.diagnose.competitor import LEVEL, SINGLE, Beside, Energy, Forms, agreement
from dlwpredict.diagnose.evidence import Whitened, steepness
from dlwpredict.diagnose.finer import on_own_pixels, polished
from dlwpredict.diagnose.fit import Fit, bare, doubled, fit, placed, valleys
from dlwpredict.diagnose.freeform import smooth_forms
from dlwpredict.diagnose.judge import Judge
from dlwpredict.diagnose.left_out import LeftOut
from dlwpredict.diagnose.library import Library
from dlwpredict.diagnose.locate import Place, locate
from dlwpredict.diagnose.naming import Named, named_in
from dlwpredict.diagnose.noise_fit import NoiseEstimate
from dlwpredict.diagnose.refit import effect_of, freed
from dlwpredict.diagnose.ripple import Ripple, ripple
from dlwpredict.diagnose.screen import Null, Screen
from dlwpredict.diagnose.select import select
from dlwpredict.diagnose.spots import Bumps, Spot, spot
from dlwpredict.flat import choose
from dlwpredict.heightmap import HeightMap
from dlwpredict.parallel import ALONE, Workers
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import predict
from dlwpredict.uneven import Uneven

PASSES = 3
"""Times that noise and choice are repeated at most, until the noise stays what it was."""

ALIKE = 0.15
"""Noise models whose strength and length differ by less than this share, and that are uneven alike, are the same."""

EXPLAINED = 0.9
"""The named effects must explain this share of what the free forms explain."""


@dataclass(frozen=True, eq=False)
class Model:
    """A fit, what free forms still find in its residual, and how it predicts what it has not seen.

    Parameters
    ----------
    fit : Fit
    rest : Energy
        What free forms explain of the residual.
    structure_um : float
        Root mean square of that, µm.
    ripple : Ripple
        The strongest wave in the residual.
    spot : Spot
        The strongest bump or dent in the residual.
    columns : Columns
        Offsets of whole columns, lines along y, that the residual was found to have.
    blocks, recordings : LeftOut or None
        Errors on blocks and on whole recordings that the fit had not seen.
    """

    fit: Fit
    rest: Energy
    structure_um: float
    ripple: Ripple
    spot: Spot
    columns: Columns
    blocks: LeftOut | None
    recordings: LeftOut | None

    @property
    def patterns(self) -> tuple[Ripple, Spot, Columns]:
        """The strongest of each kind of structure that has a form of its own."""
        return self.ripple, self.spot, self.columns

    @property
    def p_value(self) -> float:
        """Probability that noise alone leaves as strange a remainder: by free forms, as a ripple, a spot, columns."""
        return min(4 * min(self.rest.p_value, *(one.p_value for one in self.patterns)), 1.0)

    @property
    def unexplained(self) -> bool:
        """Whether there is more than noise in the residual."""
        return self.p_value < LEVEL

    @property
    def left(self) -> float:
        """What χ² in the residual is beyond noise: by free forms, and by every pattern that stands out by itself."""
        return max(self.rest.excess, 0) + sum(one.excess for one in self.patterns if one.p_value < SINGLE)


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
    library : Library
    screen : Screen
        Scores beside the baseline.
    null : Null
    forms : Forms
    agreement : Energy or None
        Whether every recording alone would give the same parameters.
    places : tuple of Place
        Where the baseline's mismatch sits.
    mismatch : tuple of numpy.ndarray, shape (rows, cols)
        How surely each pixel differs from the baseline beyond noise, 0 to 1.
    holdout : tuple of Whitened
        Recordings that no fit has seen.
    """

    recordings: tuple[Recording, ...]
    noises: tuple[NoiseEstimate, ...]
    baseline: Model
    extended: Model
    named: tuple[Named, ...]
    library: Library
    screen: Screen
    null: Null
    forms: Forms
    agreement: Energy | None
    places: tuple[Place, ...]
    mismatch: tuple[np.ndarray, ...]
    holdout: tuple[Whitened, ...] = ()

    @property
    def holdout_by(self) -> str:
        """How data are kept from the fits."""
        if self.holdout:
            return "recordings held out"
        return "recordings left out in turn" if len(self.recordings) > 1 else "blocks left out in turn"

    def held_out_um(self, fitted: Fit) -> float | None:
        """Return the root mean square error of a fit on data that it has not seen, µm."""
        if self.holdout:
            seen = placed(self.holdout, fitted.free, fitted.point.vector)
            return seen.rmse_um()
        found = left_out.recordings(fitted) or left_out.blocks(fitted)
        return found.rmse_um if found else None

    @property
    def explained(self) -> float:
        """Share of what free forms, a ripple, a spot and columns explain that the named effects explain, 0 to 1."""
        whole = self.baseline.left
        return float(np.clip(1 - self.extended.left / whole, 0, 1)) if whole > 0 else 1.0

    @property
    def verdict(self) -> str:
        """The strongest statement that the data allow: identified, ambiguous, unexplained or none."""
        if self.extended.unexplained and self.explained < EXPLAINED:
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
    tell: Callable[[str], None] = lambda text: None,
    workers: Workers = ALONE,
) -> Diagnosis:
    """Find out what the model lacks.

    Calibrate; estimate the noise beside everything that might be in the residual; fit by maximum likelihood; score all
    named effects; refit and choose; judge the choice by free forms and by data left out. Once effects are named, the
    noise is estimated again beside them, the change on finer pixels is taken anew, and the choice repeated with both.

    Parameters
    ----------
    recordings : sequence of Recording
        From `prepare`.
    start : ParameterSet
        Effects that it holds belong to the baseline.
    repeats : sequence of sequence of HeightMap, optional
        Further recordings of the same prints, for each recording.
    holdout : sequence of Recording
        Scored, never used in a fit or a choice.
    seed : int
    tell : function of str
        Told what goes on.
    workers : Workers
        Who share what can be done at once.

    Raises
    ------
    ResultError
        Too few points.
    """
    check_points(recordings)
    recordings = tuple(bare(recording) for recording in recordings)
    repeats = repeats or [()] * len(recordings)
    free = freed(start, choose(start))
    tell("calibrating")
    point = calibrated(recordings, free, seed)
    recordings, point = without_spikes(recordings, free, point)
    tell(f"calibrated: rmse {1e3 * point.rmse_um:.1f} nm; signatures")
    rough = likely(recordings, free, point, workers)
    around = Around.of(rough[0], workers)
    found, starts, pixels = None, [one.point.vector for one in rough], around.discretisation_um
    better = noises(recordings, rough[0].residuals_um(), around.designs, repeats, None, around.slopes, seed, workers)
    for _ in range(PASSES):
        noise = better
        tell("noise " + ", ".join(f"{1e3 * n.sigma_um:.1f} nm over {n.even.length_um:.1f} µm" for n in _models(noise)))
        data = [Whitened.of(*own) for own in zip(recordings, _models(noise), pixels, around.slopes, strict=True)]
        begun = fit(data, found.free, start=found.point.vector) if found else None
        baseline, *others = (on_own_pixels(one, workers, begun) for one in valleys(data, free, starts, workers))
        library, null = Library.of(around, baseline), Null.of(baseline.data, noise, seed, workers)
        judge = Judge(baseline, library, null)
        attempts = Attempts(judge, tell, workers, others)
        model = select(attempts, begun)
        if model is baseline:
            break
        found, starts = on_own_pixels(model, workers), doubled(free, baseline.point.vector)
        pixels = [item.discretisation_um for item in found.data]
        better = noises(recordings, found.residuals_um(), around.designs, repeats, noise, around.slopes, seed, workers)
        if found is model and all(_alike(a, b) for a, b in zip(_models(noise), _models(better), strict=True)):
            break
    tell("judging")
    screened, whole = judge.screen(baseline), polished(model, workers)
    while idle := judge.idle(whole):
        model = attempts.rest(whole, idle)
        whole = polished(model, workers)
    baseline = whole if model is baseline else polished(baseline, workers)
    forms = Forms.of(baseline)
    columns = forms.columns
    beside = Beside.of(baseline, columns, null)
    bumps = [Bumps.of(item, seed=k) for k, item in enumerate(baseline.data)]
    extended = judged = _judged(baseline, beside, null, bumps, Columns.of(noise))
    strange = [one for one in judged.patterns if one.p_value < SINGLE]
    places, mismatch = locate(baseline, forms, beside, bumps, strange)
    if whole is not baseline:
        extended = _judged(whole, Beside.of(whole, columns, null), null, bumps, judged.columns)
    named = named_in(attempts, model, extended.left if extended.unexplained else 0.0)
    named = [replace(one, effect=effect_of(whole, one.effect.name), fit=whole) for one in named]
    return Diagnosis(
        recordings,
        tuple(noise),
        judged,
        extended,
        tuple(named),
        library,
        screened,
        null,
        forms,
        agreement(baseline, null),
        tuple(places),
        tuple(mismatch),
        tuple(_held_out(bare(recording), baseline, seed) for recording in holdout),
    )


def _held_out(recording: Recording, baseline: Fit, seed: int) -> Whitened:
    """Whiten a recording by the noise of its own."""
    parameters = baseline.parameters
    predicted = predict(recording.target, parameters, as_measured=True).heights_um
    residual = np.where(recording.used, recording.measured.heights_um - predicted, 0.0)
    slope = steepness(predicted, recording.target)
    noise = noises([recording], [residual], [smooth_forms(recording.target)], [()], slopes=[slope], seed=seed)[0]
    return Whitened.of(recording, noise.model, discretisation_um(recording, parameters), slope)


def _judged(fitted: Fit, beside: Beside, null: Null, bumps: Sequence[Bumps], columns: Columns) -> Model:
    draws = null.beside(fitted.basis)
    return Model(
        fitted,
        beside.energy(),
        beside.structure_um(fitted),
        ripple(fitted, draws),
        spot(fitted, draws, bumps),
        columns,
        left_out.blocks(fitted),
        left_out.recordings(fitted),
    )


def _models(noise: Sequence[NoiseEstimate]) -> list[Uneven]:
    return [estimate.model for estimate in noise]


def _alike(one: Uneven, other: Uneven) -> bool:
    """Tell whether two models of noise are uneven in the same ways, and else the same to the accuracy of estimates."""
    ways = [(noise.jitter_um > 0, noise.row_um > 0, noise.column_um > 0) for noise in (one, other)]
    pairs = (one.sigma_um, other.sigma_um), (one.even.length_um, other.even.length_um)
    return ways[0] == ways[1] and all(abs(np.log(a / b)) < ALIKE for a, b in pairs)

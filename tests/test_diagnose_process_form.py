"""What the process's own form may be wrong by: its directions, and what of a name's gain stands beside them."""

from dataclasses import replace

import numpy as np
import pytest

from dlwpredict import designs
from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.library.process_form import Standing, doubts, standing
from dlwpredict.effects import library
from dlwpredict.infer.free import choose, with_values
from dlwpredict.infer.model import freed
from dlwpredict.infer.objective import Objective
from dlwpredict.infer.recording import prepare
from dlwpredict.infer.whitened import Whitened
from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.unevenness import Uneven
from dlwpredict.parameters import Paper, ParameterSet
from dlwpredict.process import predict
from tests.mission import answered

TRUTH = ParameterSet(paper=Paper(0.55, 1.7, 0.45, 6.0, 7.0, 0.74, 0.96))


@pytest.fixture(scope="module")
def part():
    return designs.air(size_um=24.0, pitch_um=0.5, margin_um=4.0, seed=2)


def model_of(part, shown_um, parameters):
    """Return a recording of these heights, and the model with its effects as they are given, differentiated."""
    recording = prepare(part, part.with_heights(shown_um))
    objective = Objective((Whitened.of(recording, Uneven(Noise(0.003, 0.0, part.dx_um, part.dx_um, part.dy_um))),))
    free = freed(parameters, choose(TRUTH))
    return objective.differentiated(objective.at(free, free.start)), objective


def test_a_spread_of_reaches_is_the_mean_of_prints_with_these_reaches(part):
    """Of reaches w(1 ± s), half each: to second order the print is that of w and one unit of the doubt."""
    model, objective = model_of(part, predict(part, TRUTH).heights_um, TRUTH)
    before = objective.work.predictions
    spread, deeper, *_ = doubts(model, objective)[0]
    work = objective.work.predictions - before
    ends = [
        predict(part, with_values(TRUTH, {"crosslink_fwhm_xy_um": 6.0 * (1 + way * policy.SPREAD)})).heights_um
        for way in (1, -1)
    ]
    expected = sum(ends) / 2 - predict(part, TRUTH).heights_um
    np.testing.assert_allclose(spread, expected, atol=2e-4)
    assert np.abs(expected).max() > 0.005
    assert 0 < np.abs(deeper).max() < np.abs(expected).max()
    assert work < 5


def test_the_base_holds_the_lowest_layers(part):
    """κ_min that grows by HELD from base to top: what one standard deviation of κ_min does, times the height."""
    model, objective = model_of(part, predict(part, TRUTH).heights_um, TRUTH)
    held, printed = doubts(model, objective)[0][-1], predict(part, TRUTH).heights_um
    more = predict(part, with_values(TRUTH, {"shrinkage_min": 0.74 + 0.02})).heights_um
    expected = policy.HELD * (more - printed) / 0.02 * printed / printed.max()
    np.testing.assert_allclose(held, expected, atol=1e-4)


def test_a_width_at_the_end_of_its_range_is_not_spread(part):
    parameters = replace(TRUTH, paper=replace(TRUTH.paper, crosslink_fwhm_z_um=30.0))
    model, objective = model_of(part, predict(part, parameters).heights_um, parameters)
    assert not doubts(model, objective)[0][1].any()


def test_a_tail_is_a_share_of_cross_linking_that_reaches_twice_as_far(part):
    """As large a share as spreads ln w by SPREAD², along and across the axis at once."""
    model, objective = model_of(part, predict(part, TRUTH).heights_um, TRUTH)
    tail, printed = doubts(model, objective)[0][2], predict(part, TRUTH).heights_um
    wider = {"crosslink_fwhm_xy_um": 12.0, "crosslink_fwhm_z_um": 14.0}
    farther = predict(part, with_values(TRUTH, wider)).heights_um
    expected = (policy.SPREAD / np.log(2)) ** 2 * (farther - printed)
    np.testing.assert_allclose(tail, expected, atol=2e-4)
    assert np.abs(expected).max() > 0.01


@pytest.mark.parametrize(("width_um", "farther"), [(20.0, 1.5), (25.0, None)])
def test_tails_reach_as_far_as_the_declared_range(part, width_um, farther):
    """Up to 30 µm, both widths in proportion; no tail is known of a width near the end of its range."""
    wide = replace(TRUTH, paper=replace(TRUTH.paper, crosslink_fwhm_z_um=width_um))
    model, objective = model_of(part, predict(part, wide).heights_um, wide)
    tail = doubts(model, objective)[0][2]
    if farther is None:
        assert not tail.any()
        return
    values = {"crosslink_fwhm_xy_um": 6.0 * farther, "crosslink_fwhm_z_um": width_um * farther}
    moved = predict(part, with_values(wide, values)).heights_um - predict(part, wide).heights_um
    np.testing.assert_allclose(tail, (policy.SPREAD / np.log(farther)) ** 2 * moved, atol=2e-4)


def test_what_a_tail_of_reaches_explains_is_no_names_gain(part):
    """A fifth of the cross-linking reaches twice as far, beside a model with vignetting: none of its gain stands."""
    wider = with_values(TRUTH, {"crosslink_fwhm_xy_um": 12.0, "crosslink_fwhm_z_um": 14.0})
    shown = 0.8 * predict(part, TRUTH).heights_um + 0.2 * predict(part, wider).heights_um
    dark = replace(TRUTH, effects=(library()["vignetting"](strength=0.05),))
    model, objective = model_of(part, shown, dark)
    assert standing(model, ["vignetting"], objective).shares["vignetting"] == 0.0


def test_what_a_spread_of_reaches_explains_is_no_names_gain(part):
    """A print whose radicals reach differently far, beside a model with vignetting: nothing of its gain stands."""
    model, objective = model_of(part, predict(part, TRUTH).heights_um, TRUTH)
    spread = doubts(model, objective)[0][0]
    dark = replace(TRUTH, effects=(library()["vignetting"](strength=0.05),))
    model, objective = model_of(part, model.traces[0].heights_um + spread, dark)
    assert standing(model, ["vignetting"], objective).shares["vignetting"] == 0.0


def test_what_no_spread_of_reaches_makes_stands_whole(part):
    turned = replace(TRUTH, effects=(library()["astigmatism"](log_ratio=0.2),))
    model, objective = model_of(part, predict(part, turned).heights_um, turned)
    assert standing(model, ["astigmatism"], objective).shares["astigmatism"] > 0.9


@pytest.mark.parametrize(("share", "stands"), [(0.5, False), (0.02, True)])
def test_no_process_is_as_wrong_as_a_strong_effect_would_have_it(part, monkeypatch, share, stands):
    """A doubt like the effect explains it at 2 standard deviations, and would at 50, where none is so far off."""
    turned = replace(TRUTH, effects=(library()["astigmatism"](log_ratio=0.2),))
    shown = predict(part, turned).heights_um
    model, objective = model_of(part, shown, turned)
    alike = share * (shown - predict(part, TRUTH).heights_um)
    monkeypatch.setattr("dlwpredict.diagnosis.library.process_form.doubts", lambda *_: [alike[np.newaxis]])
    share_of_gain = standing(model, ["astigmatism"], objective).shares["astigmatism"]
    assert share_of_gain > 0.7 if stands else share_of_gain == 0.0


@pytest.mark.parametrize(("share", "all_of_it"), [(0.5, True), (0.02, False)])
def test_a_rival_is_excused_what_the_form_of_the_process_may_have_made(part, monkeypatch, share, all_of_it):
    """The print of one model, and another one: what they differ by is a doubt of 2 standard deviations, or of 50.

    Of 50 there are 3 at most, which take 1 − (47/50)², 12 %; an error of form may have 1.5 times as much.
    """
    turned = replace(TRUTH, effects=(library()["astigmatism"](log_ratio=0.2),))
    shown = predict(part, turned).heights_um
    model, objective = model_of(part, shown, turned)
    rival, _ = model_of(part, shown, TRUTH)
    alike = share * (shown - predict(part, TRUTH).heights_um)
    monkeypatch.setattr("dlwpredict.diagnosis.library.process_form.doubts", lambda *_: [alike[np.newaxis]])
    as_it_is, other = (standing(fit, [], objective) for fit in (model, rival))
    part_of_it = as_it_is.excuses(other)
    if all_of_it:
        assert part_of_it > rival.cost - model.cost
    else:
        assert part_of_it < 0.2 * (rival.cost - model.cost)
    assert as_it_is.excuses(as_it_is) == pytest.approx(0.0, abs=0.1)
    monkeypatch.setattr("dlwpredict.diagnosis.library.process_form.doubts", lambda *_: [])
    assert standing(rival, [], objective) == Standing({}, 0.0)


def test_a_rival_of_which_the_doubts_explain_less_is_excused_nothing():
    assert Standing({}, 30.0).excuses(Standing({}, 10.0)) == 0.0
    assert Standing({}, 10.0).excuses(Standing({}, 30.0)) == pytest.approx(1.5 * 30 - 10)


@pytest.mark.parametrize(("end", "share"), [("low", 1.0), ("high", 0.0)])
def test_a_process_at_the_end_of_a_range_does_not_answer_beyond_it(part, end, share):
    """Heights read larger: less shrinkage of the print would be the same, and more of it would not."""
    larger = replace(TRUTH, effects=(library()["z-amplification"](gain=0.03),))
    model, objective = model_of(part, predict(part, larger).heights_um, larger)
    ends, place = getattr(model.free, end).copy(), model.free.index("shrinkage_min")
    ends[place] = model.vector[place]
    model = replace(model, free=replace(model.free, **{end: ends}))
    assert standing(model, ["z-amplification"], objective).shares["z-amplification"] == pytest.approx(share, abs=0.01)


@pytest.mark.slow
@pytest.mark.long
def test_radicals_that_reach_farther_than_a_gaussian_are_no_effect():
    """The press's tails of cross-linking were named vignetting with a curved focal surface."""
    found, _ = answered(crosslink_tails=0.2)
    assert found.verdict == "unexplained"
    assert not found.named
    assert "vignetting" in found.doubted

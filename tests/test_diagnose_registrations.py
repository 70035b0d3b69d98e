"""Whether recordings lie where their alignment says: against recordings that the effect `misregistration` has moved."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from dlwpredict import designs
from dlwpredict.diagnosis.answer.content import _registration
from dlwpredict.diagnosis.answer.words import _lies, _lies_well
from dlwpredict.diagnosis.judge import registered
from dlwpredict.diagnosis.structure.registrations import Registration, chance_of, registrations
from dlwpredict.effects import library
from dlwpredict.heightmap import Instrument
from dlwpredict.infer.free import choose
from dlwpredict.infer.objective import Objective
from dlwpredict.infer.priors import NUISANCES
from dlwpredict.infer.recording import doubted, prepare
from dlwpredict.infer.whitened import Whitened
from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.unevenness import Uneven
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import predict

NOISE = Noise(0.002, 0.0, 1.0, 0.5, 0.5)
TARGET = designs.air(size_um=24, pitch_um=0.5, margin_um=4, seed=3)


def lying(**settings):
    """Return what registration, linear in what it moves, makes of a recording that was moved."""
    moved = ParameterSet(effects=(library()["misregistration"](**settings),) if settings else ())
    drawn = NOISE.simulate(TARGET.shape, np.random.default_rng(0))
    recorded = TARGET.with_heights(predict(TARGET, moved, as_measured=True).heights_um + drawn)
    objective = Objective((Whitened.of(doubted(prepare(TARGET, recorded)), Uneven(NOISE)),))
    free = choose(ParameterSet(), free=["threshold"])
    (one,) = registrations(objective.at(free, free.start))
    return one


MOVES = {
    "scale_x": 4e-3,
    "scale_y": -4e-3,
    "rotation_deg": 0.2,
    "shear_mrad": 4.0,
    "shift_x_um": 0.1,
    "shift_y_um": -0.1,
}
"""As far as alignments leave a recording now and then: one or two standard deviations."""


def moved(name, times=1.0):
    return {name: getattr(library()["misregistration"](), name) + times * MOVES[name]}


@pytest.mark.parametrize("name", MOVES)
def test_what_was_moved_is_said_in_the_units_of_the_effect(name):
    """To a twentieth: columns are slopes by differences, which of a wave of six pixels are 3 % too small."""
    said = _registration(lying(**moved(name)))
    assert said[name] == pytest.approx(moved(name)[name], abs=abs(MOVES[name]) / 20)


@pytest.mark.parametrize("name", [name for name in MOVES if not name.startswith("shift")])
def test_what_was_moved_far_is_no_chance(name):
    one = lying(**moved(name, 4.0))
    assert one.p_value < 1e-3
    assert name.startswith(one.farthest)


def test_a_shift_is_read_but_no_surprise():
    """No recording has a place of its own."""
    one = lying(**moved("shift_x_um", 4.0))
    assert one.settings["shift_x_um"] == pytest.approx(0.4, rel=0.05)
    assert one.p_value > 0.5


def test_one_that_lies_where_it_should_says_nothing():
    assert lying().p_value > 0.5


def of(pair, moved_by):
    """Return how a recording lies that an alignment has left as open as any."""
    return Registration(pair, moved_by, {name: NUISANCES[name] for name in moved_by})


def test_the_probability_is_that_of_the_farthest_of_all_that_may_move():
    one = of(0, {"scale_x": 0.006, "shift_x": 1.0, "rotation": 0.0})
    assert one.far == pytest.approx({"scale_x": 3.0, "shift_x": 1.0, "rotation": 0.0})
    assert one.p_value == pytest.approx(3 * 2 * stats.norm.sf(3.0))
    assert of(0, {"scale_x": 0.001, "shift_x": 0.0}).p_value == 1.0
    assert replace(one, left_open={"scale_x": 0.006, "shift_x": 1.0, "rotation": 1.0}).far["scale_x"] == 1.0


def test_the_least_likely_of_several_counts_as_one_of_several():
    some = [of(k, {"shift_x": shift}) for k, shift in enumerate((0.5, 3.0, 1.0))]
    worst, p_value = chance_of(some)
    assert worst.pair == 1
    assert p_value == pytest.approx(3 * 2 * stats.norm.sf(3.0))
    assert chance_of(some[1:2])[1] == pytest.approx(2 * stats.norm.sf(3.0))


def test_a_recording_taken_at_its_word_has_none():
    item = Whitened.of(replace(prepare(TARGET, TARGET), nuisances=("offset", "tilt_x")), Uneven(NOISE))
    assert registrations(SimpleNamespace(data=[item], coefficients=[np.ones(2)])) == []


@pytest.mark.parametrize(
    ("moved", "said"),
    [
        ({"scale_y": 0.02}, "is 2.00 % wider along y than its alignment says, which leaves 0.20 % open"),
        ({"shift_x": -0.5}, "lies -0.50 µm along x from where its alignment says, which leaves 1 µm open"),
        ({"rotation": np.deg2rad(1.0)}, "is turned by 1° against its alignment, which leaves 0.1° open"),
        ({"shear": 0.015}, "is sheared by 15 mrad against its alignment, which leaves 2 mrad open"),
    ],
)
def test_how_it_lies_is_said_in_words(moved, said):
    assert _lies(of(0, moved)) == said


def test_what_an_alignment_has_taken_out_is_said():
    """The most of all recordings; nothing within a certificate."""
    some = [prepare(TARGET, replace(TARGET, instrument=Instrument(scale=scale))) for scale in (0.999, 0.99, 0.985)]
    assert _lies_well(some).endswith("(1.5 % of scale that was taken out may be the print's)")
    assert _lies_well(some[:1]) == "lies where its alignment says, as far as that goes"


def test_recordings_held_out_are_levelled_by_least_squares():
    """However their columns drift: the error of a prediction is what its best level and tilt leave."""
    rng = np.random.default_rng(5)
    drift_um = 0.02 * np.cumsum(rng.normal(0, 1, TARGET.shape[1])) + NOISE.simulate(TARGET.shape, rng)
    printed = predict(TARGET, ParameterSet(), as_measured=True).heights_um
    held_out = prepare(TARGET, TARGET.with_heights(printed + drift_um))
    free = choose(ParameterSet(), free=["threshold"])
    objective = Objective((Whitened.of(doubted(held_out), Uneven(NOISE)),))
    data = registered([held_out], objective.at(free, free.start), objective)
    error_um = replace(objective, data=data).at(free, free.start).rmse_um()
    used = held_out.used
    x, y = np.meshgrid(TARGET.x_um, TARGET.y_um)
    plane = np.stack([np.ones(used.sum()), x[used], y[used]], axis=1)
    left_um = drift_um[used] - plane @ np.linalg.lstsq(plane, drift_um[used], rcond=None)[0]
    assert 0.9 * np.std(left_um) < error_um < 1.01 * np.std(left_um)  # it may be moved a little besides

"""Advice on the next recording: what is expected of it, and whether it can be made."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from dlwpredict import designs
from dlwpredict.cli.app import app
from dlwpredict.diagnosis.answer.advise import (
    LEAST,
    MORE,
    SURE,
    advise,
    present_columns,
    separation,
    simulated,
    simulator,
    turned,
    viewed,
)
from dlwpredict.diagnosis.answer.setups import Setup, new_designs
from dlwpredict.effects import library
from dlwpredict.files import read_height_map
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.descend import descend
from dlwpredict.infer.free import choose
from dlwpredict.infer.objective import Nuisances, Objective
from dlwpredict.infer.recording import doubted, prepare
from dlwpredict.infer.rows import Rows
from dlwpredict.infer.whitened import Whitened
from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.unevenness import Uneven
from dlwpredict.parameters import Paper, ParameterSet
from dlwpredict.process import predict

TRUTH = ParameterSet(paper=Paper(0.5, 1.6, 0.45, 6.0, 6.5, 0.72, 0.96))
LAG, SLOPE = library()["galvo-lag"](lag_um=0.5), library()["slope-error"](signed_y_um=-0.4)
SHORT = library()["line-length-error"](start_um=-0.3, end_um=-0.3)
FLANKS = library()["slope-error"](bias_abs_y_um=0.2)
VIGNETTING, CURVATURE = library()["vignetting"](strength=0.05), library()["field-curvature"](sag_um=-0.07)


def fitted(noise_um):
    """Return the baseline fitted to one noisy recording."""
    target = designs.air(size_um=30, pitch_um=0.5, margin_um=5)
    noise = Noise(0.3 * noise_um, noise_um, 1.0, 0.5, 0.5)
    recording = target.with_heights(
        predict(target, TRUTH).heights_um + noise.simulate(target.shape, np.random.default_rng(0))
    )
    return fit((Whitened.of(doubted(prepare(target, recording, name="air.tif")), Uneven(noise)),), choose(TRUTH))


def fit(data, free):
    objective = Objective(data)
    return descend(objective, objective.differentiated(objective.at(free, free.start)))


@pytest.fixture(scope="module")
def noisy():
    return fitted(0.08)


@pytest.fixture(scope="module")
def quiet():
    return fitted(0.006)


def now(fit_, members):
    rows = fit_.nuisances.triangle(present_columns(fit_, members))
    return separation(rows, len(fit_.free.names)).sd


def test_separation_is_what_one_joint_fit_cannot_imitate():
    """Triangles of two recordings, each beside its own nuisances, against least squares on everything at once."""
    rng = np.random.default_rng(1)
    columns = [rng.normal(size=(n, 5)) for n in (40, 30)]
    own = [np.linalg.qr(rng.normal(size=(n, 3)))[0] for n in (40, 30)]
    beside = [Nuisances(Rows((len(q),), (0,), 0), (q,), (np.zeros((0, 3)),)) for q in own]
    found = separation(np.vstack([n.triangle(c) for c, n in zip(columns, beside, strict=True)]), 3)
    nuisances = np.zeros((70, 6))
    nuisances[:40, :3], nuisances[40:, 3:] = own
    stacked = np.vstack(columns)
    left = []
    for one, other in ((3, 4), (4, 3)):
        known = np.column_stack([nuisances, stacked[:, [0, 1, 2, other]]])
        left.append(np.linalg.norm(stacked[:, one] - known @ np.linalg.lstsq(known, stacked[:, one])[0]))
    assert found.sd == pytest.approx(min(left), rel=1e-9)


def test_a_turned_sample_turns_what_the_microscope_adds():
    """Seen in the frame of the sample, a bend towards the instrument's +x points to −y after a quarter turn."""
    flat = HeightMap(np.zeros((9, 9)), 1.0, 1.0)
    bend = ParameterSet(effects=(library()["field-curvature"](coma_x_um=1.0),))
    straight, quarter = viewed(flat, bend, 0), viewed(flat, bend, 1)
    assert straight[4, 8] > 0 and straight[4, 0] < 0 and straight[0, 4] == 0
    np.testing.assert_allclose(quarter, np.rot90(straight, -1))
    assert quarter[8, 4] > 0 and quarter[0, 4] < 0


def test_turning_swaps_the_pitches_and_comes_back():
    part = HeightMap(np.arange(6.0).reshape(2, 3), 0.5, 0.25)
    assert (turned(part, 1).dx_um, turned(part, 1).dy_um) == (0.25, 0.5)
    np.testing.assert_array_equal(turned(turned(part, 1), -1).heights_um, part.heights_um)


@pytest.mark.slow
def test_short_lines_and_lost_flanks_are_told_apart_by_turning_the_sample(noisy):
    members = [SHORT, FLANKS]
    assert now(noisy, members) < LEAST
    advice = advise(noisy, members)
    assert advice.setup == "sample turned 90°"
    assert advice.command is None and advice.separation >= SURE
    assert "under the microscope" in advice.sentence and "standard deviations apart" in advice.sentence


@pytest.mark.slow
def test_the_same_once_more_unturned_would_not_do(noisy):
    """What the turn brings is not the second look alone."""
    members = [SHORT, FLANKS]
    rows = noisy.nuisances.triangle(present_columns(noisy, members))
    again = Setup("again", 0, "Record it again", noisy.data[0].recording.target)
    repeated = separation(np.vstack([rows, simulator(noisy, members)(again, False)]), len(noisy.free.names)).sd
    assert repeated == pytest.approx(np.sqrt(2) * now(noisy, members), rel=0.05)
    assert advise(noisy, members).separation > MORE * repeated


@pytest.mark.slow
def test_no_turn_tells_a_lag_from_a_signed_slope_error(noisy):
    """Both are a shift, and a recording has no place of its own: what is left of either does not turn."""
    members = [LAG, SLOPE]
    assert now(noisy, members) < LEAST
    rows = noisy.nuisances.triangle(present_columns(noisy, members))
    turned_by_180 = Setup("turned", 0, "Turn it", noisy.data[0].recording.target, view_turns=2)
    both = np.vstack([rows, simulator(noisy, members)(turned_by_180, False)])
    assert separation(both, len(noisy.free.names)).sd < LEAST
    assert "turned" not in advise(noisy, members).setup


@pytest.mark.slow
def test_the_expected_separation_is_what_a_full_refit_leaves(quiet):
    """Pads printed with vignetting and recorded without noise: the best that field curvature can do is as far off."""
    pads = next(setup for setup in new_designs(quiet) if setup.name == "pads")
    rows = quiet.nuisances.triangle(present_columns(quiet, [VIGNETTING, CURVATURE]))
    rows = np.vstack([rows, simulator(quiet, [VIGNETTING, CURVATURE])(pads, False)])
    expected = separation(rows, len(quiet.free.names))
    assert expected.pair == (0, 1)

    physics = replace(quiet.parameters, effects=(VIGNETTING,))
    old, new = quiet.data[0], simulated(pads.target, predict(pads.target, quiet.parameters), quiet)
    data = [
        replace(item, recording=replace(item.recording, measured=predict(item.recording.target, physics)))
        for item in (old, new)
    ]
    start = replace(quiet.parameters, effects=(CURVATURE,))
    refitted = fit(tuple(data), choose(start, free=[*quiet.free.names, "field-curvature.sag_um"]))
    assert np.sqrt(refitted.cost) == pytest.approx(expected.sd, rel=0.1)


@pytest.fixture(scope="module")
def dome_advice(quiet):
    return advise(quiet, [VIGNETTING, CURVATURE])


@pytest.mark.slow
def test_vignetting_and_field_curvature_need_a_design(quiet, dome_advice):
    """Both are round: no turn helps."""
    assert dome_advice.command and "turned" not in dome_advice.setup
    assert dome_advice.separation > np.sqrt(2) * now(quiet, [VIGNETTING, CURVATURE])
    said = re.search(r"expected ([\d.]+) standard deviations apart", dome_advice.sentence)[1]
    assert float(said) == pytest.approx(dome_advice.separation, rel=0.06)


@pytest.mark.slow
def test_the_command_makes_the_design(dome_advice, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = dome_advice.command.split()
    assert words[0] == "dlwpredict"
    done = CliRunner().invoke(app, words[1:])
    assert done.exit_code == 0 and "warning" not in done.output, done.output
    made = read_height_map(tmp_path / words[words.index("-o") + 1])
    assert made.size_um == pytest.approx((40, 40)) and made.heights_um[0].max() == 0 < made.heights_um.max()


def test_every_command_makes_the_design_that_was_simulated(quiet, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for setup in new_designs(quiet):
        words = setup.command.split()
        done = CliRunner().invoke(app, words[1:])
        assert done.exit_code == 0 and "warning" not in done.output, done.output
        made = read_height_map(tmp_path / words[words.index("-o") + 1])
        np.testing.assert_allclose(made.heights_um, setup.target.heights_um, atol=1e-5)


def test_of_a_small_field_only_designs_that_fit_into_it_are_tried():
    target = HeightMap(np.pad(np.full((8, 8), 2.0), 2), 0.3, 0.3)
    data = [SimpleNamespace(recording=SimpleNamespace(target=target))]
    tried = [setup.target.shape for setup in new_designs(SimpleNamespace(data=data))]
    assert all(max(shape) <= 14 for shape in tried)


def test_what_nothing_separates_says_so(quiet):
    members = [library()["z-amplification"](gain=0.05), library()["z-drift"](scale=0.05)]
    advice = advise(quiet, members, setups=new_designs(quiet)[:2])
    assert advice.setup == "none" and advice.command is None and advice.separation < LEAST
    assert "a certified step height, and nothing else" in advice.sentence


def test_one_effect_alone_needs_no_advice(quiet):
    assert advise(quiet, [VIGNETTING]) is None

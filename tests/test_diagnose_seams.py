"""Where a seam may be, looked for in one pass over what a first fit leaves."""

import numpy as np
import pytest

from dlwpredict import designs
from dlwpredict.diagnosis import run
from dlwpredict.diagnosis.library import signatures
from dlwpredict.diagnosis.library.candidates import candidates
from dlwpredict.diagnosis.library.seams import _Beyond, seams
from dlwpredict.effects import library
from dlwpredict.infer.baseline import rough
from dlwpredict.infer.free import choose
from dlwpredict.infer.model import freed, key_of
from dlwpredict.infer.objective import Fit, Work
from dlwpredict.infer.priors import PARAMETERS
from dlwpredict.infer.recording import doubted, prepare
from dlwpredict.noise.covariance import Noise
from dlwpredict.parameters import Paper, ParameterSet
from dlwpredict.process import predict

PITCH_UM = 0.5
PART = {"size_um": 30.0, "pitch_um": PITCH_UM, "margin_um": 5.0}
SEVEN = Paper(0.5, 1.6, 0.45, 6.0, 6.5, 0.72, 0.96)


def first_fit(**settings: float) -> Fit:
    """Return the first fit to two structures printed with a seam."""
    process = ParameterSet(paper=SEVEN, effects=(library()["stitching"](**settings),))
    recordings = []
    for k, target in enumerate((designs.air(**PART), designs.stairs(**PART))):
        noise = Noise(0.003, 0.01, 1.0, PITCH_UM, PITCH_UM).simulate(target.shape, np.random.default_rng(k))
        recordings.append(doubted(prepare(target, target.with_heights(predict(target, process).heights_um + noise))))
    start = ParameterSet()
    return rough(recordings, freed(start, choose(start)), PARAMETERS, Work())[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "angle_deg", "seam_um"),
    [({"step_um": 0.05}, 90.0, -8.3), ({"shift_x_um": 0.2}, 0.0, 5.0), ({"overlap": 0.1}, 0.0, 4.2)],
)
def test_a_seam_is_looked_for_along_both_axes_and_lies_within_a_pixel(kind, angle_deg, seam_um):
    found = seams(first_fit(**kind, angle_deg=angle_deg, seam_um=seam_um))
    assert [one["angle_deg"] for one in found.settings] == [0.0, 90.0]
    place = next(one["seam_um"] for one in found.settings if one["angle_deg"] == angle_deg)
    assert place == pytest.approx(seam_um, abs=PITCH_UM)
    assert found.price == pytest.approx(2 * np.log(found.tried)) and found.tried > 80


@pytest.mark.slow
def test_a_seam_hidden_by_a_stronger_effect_is_looked_for_again_beside_it(monkeypatch):
    """A first fit leaves most of the dose that a part's own writing adds: what looks like a seam there is none."""
    few = {"dose-memory", "stitching"}
    monkeypatch.setattr(signatures, "candidates", lambda *of: [one for one in candidates(*of) if one.name in few])
    first, seam_um = [], -3.0
    monkeypatch.setattr(run, "seams", lambda fit: first.append(seams(fit)) or first[-1])
    kinds, target = library(), designs.air(size_um=24, pitch_um=PITCH_UM, margin_um=4, seed=3)
    memory, seam = kinds["dose-memory"](gain=0.05), kinds["stitching"](step_um=-0.02, seam_um=seam_um)
    printed = predict(target, ParameterSet(effects=(memory, seam))).heights_um
    noise = Noise(0.004, 0.0, 1.0, PITCH_UM, PITCH_UM).simulate(target.shape, np.random.default_rng(1))
    found = run.diagnose([prepare(target, target.with_heights(printed + noise))], ParameterSet())
    assert abs(first[0].settings[0]["seam_um"] - seam_um) > 2 * PITCH_UM
    assert [one.names for one in found.named] == [["dose-memory"], ["stitching"]]
    assert found.named[1].effect.seam_um == pytest.approx(seam_um, abs=PITCH_UM)
    assert found.named[1].effect.step_um == pytest.approx(-0.02, abs=0.004)


def test_sums_behind_a_place_are_those_of_its_points():
    rng = np.random.default_rng(0)
    along, first, second = np.repeat(np.arange(10) - 4.5, 7), rng.normal(size=(70, 2)), rng.normal(size=(70, 3))
    beyond = _Beyond(along, first, second)
    for place in (-6.0, -2.0, 3.0, 7.0):
        expected = np.sum((first[:, 1:] * second)[along > place], axis=0)
        behind = beyond.sums(np.array([place]), (1, 0.0, np.inf), None)[0]
        np.testing.assert_allclose(behind, expected, atol=1e-12)
    strip = beyond.sums(np.array([1.0]), (0, -2.0, 2.0), (0, 0.0, np.inf))[0]
    np.testing.assert_allclose(strip, np.sum((first[:, :1] * second)[(along > 1) & (along < 3)], axis=0), atol=1e-12)
    cut = beyond.sums(np.array([0.25]), (0, 0.0, np.inf), None)[0]
    whole = [np.sum((first[:, :1] * second)[along > place], axis=0) for place in (0.0, 1.0)]
    np.testing.assert_allclose(cut, 0.75 * whole[0] + 0.25 * whole[1], atol=1e-12)


def test_points_of_a_single_line_are_behind_a_place_or_not():
    beyond = _Beyond(np.full(4, 2.0), np.ones((4, 1)), np.arange(8.0).reshape(4, 2))
    behind = beyond.sums(np.array([-9.0, 9.0]), (0, 0.0, np.inf), None)
    np.testing.assert_array_equal(behind, [[12.0, 16.0], [0.0, 0.0]])


def test_every_place_is_a_candidate_and_a_model_of_its_own():
    places = [{"seam_um": 2.0, "angle_deg": 0.0}, {"seam_um": -3.0, "angle_deg": 90.0}]
    some = [one for one in candidates(ParameterSet(), placed={"stitching": places}) if one.switch == "step_um"]
    assert [(one.effect.seam_um, one.effect.angle_deg) for one in some] == [(2.0, 0.0), (-3.0, 90.0)]
    models = [ParameterSet(effects=(one.at(1.0),)) for one in some]
    keys = {key_of(freed(model, choose(ParameterSet()))) for model in models}
    assert len(keys) == 2 and all("stitching.step_um" in key for key in keys)

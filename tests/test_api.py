"""What `import dlwpredict` gives: light, complete, and the same as the commands."""

import pkgutil
import subprocess
import sys
from importlib import import_module

import numpy as np
import pytest

import dlwpredict as dlw
from dlwpredict.cli.commands import NAMES as COMMANDS
from dlwpredict.metrology.walls import near_walls_or_rim
from dlwpredict.pairing import Pair

VERBS = {"align", "calibrate", "design", "diagnose", "precompensate", "predict", "score"}


@pytest.fixture(scope="module")
def target():
    return dlw.design("air", size_um=16, pitch_um=0.5, margin_um=4, seed=1)


@pytest.fixture(scope="module")
def recording(target):
    rng = np.random.default_rng(0)
    printed = dlw.predict(target, dlw.ParameterSet())
    return printed.with_heights(printed.heights_um + rng.normal(0, 0.005, printed.shape))


def test_import_brings_nothing_along():
    code = "import sys, dlwpredict; print(any(m.startswith(('numpy', 'scipy', 'dlwpredict.')) for m in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_every_name_is_there_and_says_what_it_does():
    for name in dlw.__all__:
        assert getattr(dlw, name).__doc__, name
    assert set(dlw.__all__) <= set(dir(dlw)) and set(COMMANDS) & VERBS == VERBS
    with pytest.raises(AttributeError, match="no attribute 'print'"):
        dlw.print  # noqa: B018


def test_names_of_verbs_stay_verbs():
    """A module of the same name would take the place of the verb once it is imported."""
    modules = {info.name for info in pkgutil.iter_modules(dlw.__path__)}
    assert modules & set(dlw.__all__) == {"effects"}


@pytest.mark.parametrize("verb", sorted(VERBS))
def test_a_command_calls_the_function_of_its_name(verb):
    module = import_module(f"dlwpredict.cli.{'session' if verb == 'diagnose' else verb}")
    assert getattr(module, verb) is getattr(dlw, verb)


def test_files_come_back_as_they_were_written(tmp_path, target):
    assert dlw.write(tmp_path / "target.tif", target) == []
    assert np.abs(dlw.read(tmp_path / "target.tif").heights_um - target.heights_um).max() < 1e-5
    dlw.write_parameters(tmp_path / "process.yaml", dlw.ParameterSet())
    assert dlw.read_parameters(tmp_path / "process.yaml").paper == dlw.ParameterSet().paper


@pytest.mark.slow
def test_what_was_printed_is_calibrated_and_corrected(target, recording):
    found = dlw.calibrate([(target, recording)], fix=["crosslink_fwhm_z_um"])
    printed = dlw.predict(target, found.parameters)
    assert dlw.score(recording, printed).rmse_um < 0.01
    better = dlw.precompensate(target, found.parameters, most_predictions=5)
    parts = [dlw.score(target, one, part_only=True).rmse_um for one in (printed, better.predicted)]
    assert parts[1] < parts[0] / 2


@pytest.mark.slow
def test_results_say_themselves_in_a_few_lines(target, recording):
    """Typed at a prompt: the figures that the command says, no arrays."""
    lines = {
        repr(target): ["HeightMap(48 x 48 px, pitch 0.5 x 0.5 µm,", "heights substrate)"],
        repr(dlw.align(recording, target)): ["Alignment(shift ", "heights to the substrate)"],
        repr(dlw.calibrate([(target, recording)], free=["shrinkage_min"])): ["Calibration: rmse ", "95 % 0.6", "\n"],
        repr(dlw.precompensate(target, most_predictions=2)): ["Precompensation(rmse ", " in 2 predictions; "],
    }
    for said, parts in lines.items():
        assert all(part in said for part in parts) and len(said) < 400 and "array" not in said


@pytest.mark.slow
def test_a_micro_lens_of_little_more_than_a_hundred_points_is_diagnosed():
    """As a microscope shows it, no substrate in view: most points of a part so small lie at its rim."""
    lens = dlw.design("lens", size_um=7, pitch_um=0.4, margin_um=0, height_um=1.5, base_um=3)
    printed = dlw.predict(lens)
    noise_um = np.random.default_rng(3).normal(0, 0.01, lens.shape)
    recording = dlw.HeightMap(printed.heights_um + noise_um, 0.4, 0.4, "relative")
    found = dlw.diagnose([(lens, recording)])
    assert 100 <= found.diagnosis.recordings[0].points < 200
    assert found.verdict == "none" and found.diagnosis.noises[0].model.sigma_um == pytest.approx(0.01, rel=0.25)


@pytest.mark.slow
def test_a_diagnosis_says_itself(target, recording):
    found = dlw.diagnose([(target, recording)])
    assert found.verdict == "none" and found.findings == []
    assert repr(found).startswith("Nothing beyond noise") and "<b>Nothing beyond noise" in found._repr_html_()
    assert found.diagnosis.extended.fit.rmse_um() == pytest.approx(0.005, rel=0.1)  # the noise
    left = found.maps(0)["remainder"]
    assert left.same_grid(target) and np.nanstd(left.heights_um) == pytest.approx(0.005, rel=0.1)
    assert found.cautions == [] and found.parameters.effects == ()


def test_a_part_that_goes_on_is_not_rounded_at_the_rim_of_its_map():
    plate = dlw.HeightMap(np.full((24, 30), 4.0), 0.5, 0.5)
    ends, goes_on = (dlw.predict(plate, continued=continued).heights_um for continued in (False, True))
    assert np.ptp(goes_on) < 0.01 < 0.1 < np.ptp(ends)  # the part goes on for three standard deviations
    better = dlw.precompensate(plate, continued=True)
    assert better.capped_points == 0 and np.ptp(better.corrected.heights_um) < 0.02
    capped = dlw.precompensate(plate, continued=True, maximum_um=4.02)
    assert capped.capped_points == plate.heights_um.size and capped.corrected.heights_um.max() == 4.02


def test_a_score_leaves_out_what_is_near_walls_and_rim(target, recording):
    near = near_walls_or_rim(target, 2)
    assert dlw.score(target, recording, wall_px=2) == dlw.score(target, recording, left_out=near)
    assert dlw.score(target, recording, wall_px=2).points == (~near).sum()


def test_a_wrong_unit_is_refused_before_anything_is_aligned(target, recording):
    with pytest.raises(dlw.InputError, match=r"recording: heights: relief .* times the target's"):
        dlw.align(recording.with_heights(1e3 * recording.heights_um), target)


def test_repeats_and_values_stand_on_the_pixels_that_they_belong_to(target, recording):
    pair = Pair.of(target, recording, dlw.ParameterSet(), working_pitch_um=1.0).repeated(recording)
    assert pair.factor == 2 and pair.pitch_um == 1.0
    assert pair.repeats[0].shape == pair.recording.used.shape == (24, 24)
    fine = pair.fine(np.arange(24.0 * 24).reshape(24, 24))
    assert fine.same_grid(target) and fine.heights_um[2:4, 4:6].tolist() == [[26.0, 26.0]] * 2


def test_an_open_side_is_not_corrected(target):
    paper, effects = dlw.ParameterSet().paper, dlw.effects.library()
    open_side = dlw.ParameterSet(
        effects=(effects["vignetting"](strength=0.1),),
        undecided=_undecided(paper, effects["vignetting"](strength=0.1)),
    )
    with pytest.raises(dlw.InputError, match="open for vignetting"):
        dlw.precompensate(target, open_side)


def _undecided(paper, effect):
    from dlwpredict.parameters import Process, Undecided

    return Undecided((effect.name,), Process(paper, (effect,)), Process(paper, ()))


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda one: dlw.design("vase"), "found vase"),
        (lambda one: dlw.plot(), "found 0 maps"),
        (lambda one: dlw.calibrate([(one, one.with_heights(np.ones((3, 3))))]), "recording 1"),
    ],
)
def test_bad_input_is_said_in_one_line(call, said, target):
    with pytest.raises(dlw.InputError, match=said) as caught:
        call(target)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_maps_draw_themselves(tmp_path, target, recording):
    for figure in (dlw.plot(target), dlw.plot(target, recording, names=("design", "print"))):
        figure.savefig(tmp_path / "figure.png")
        assert (tmp_path / "figure.png").stat().st_size > 10_000

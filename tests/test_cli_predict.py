"""The commands predict and precompensate, through the whole program."""

import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from dlwpredict import designs
from dlwpredict.cli.app import app
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import predict


@pytest.fixture
def folder(tmp_path):
    write_height_map(tmp_path / "target.tif", designs.cin(size_um=16, pitch_um=0.5, margin_um=3))
    return tmp_path


def dlw(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


def test_predict_writes_what_the_library_predicts(folder):
    done = dlw("predict", folder / "target.tif", "-o", folder / "p.tif")
    assert done.exit_code == 0, done.output
    expected = predict(read_height_map(folder / "target.tif"), ParameterSet()).heights_um
    np.testing.assert_allclose(read_height_map(folder / "p.tif").heights_um, expected, atol=1e-5)


def test_voxel_method_agrees_and_takes_any_slice(folder):
    words = ("predict", folder / "target.tif", "--method", "voxel", "--slice-um", 0.04)
    assert dlw(*words, "-o", folder / "v.tif").exit_code == 0
    assert dlw("predict", folder / "target.tif", "-o", folder / "p.tif").exit_code == 0
    difference = read_height_map(folder / "v.tif").heights_um - read_height_map(folder / "p.tif").heights_um
    assert np.sqrt(np.mean(difference**2)) < 0.04 / np.sqrt(12) * 1.15


def test_same_command_same_bytes(folder):
    for name in ("a.tif", "b.tif"):
        assert dlw("predict", folder / "target.tif", "-o", folder / name).exit_code == 0
    assert (folder / "a.tif").read_bytes() == (folder / "b.tif").read_bytes()


@pytest.fixture
def artefact(folder):
    """A parameter file with a measurement effect that makes everything look 10 % higher."""
    text = Path("configs/paper-defaults.yaml").read_text(encoding="utf-8")
    path = folder / "artefact.yaml"
    path.write_text(text.replace("effects: []", "effects: [{name: z-amplification, gain: 0.1}]"), encoding="utf-8")
    return path


def test_measurement_effects_show_only_as_measured(folder, artefact):
    words = ("predict", folder / "target.tif", "-p", artefact)
    assert dlw(*words, "-o", folder / "printed.tif").exit_code == 0
    assert dlw(*words, "-o", folder / "measured.tif", "--as-measured").exit_code == 0
    printed, measured = (read_height_map(folder / f"{n}.tif").heights_um for n in ("printed", "measured"))
    np.testing.assert_allclose(measured, 1.1 * printed, rtol=1e-5)


def test_precompensate_ignores_measurement_effects(folder, artefact):
    for name, parameters in (("with", artefact), ("without", "configs/paper-defaults.yaml")):
        done = dlw("precompensate", folder / "target.tif", "-o", folder / f"{name}.tif", "-p", parameters)
        assert done.exit_code == 0, done.output
    assert (folder / "with.tif").read_bytes() == (folder / "without.tif").read_bytes()


def test_precompensate_reports_what_it_reached(folder):
    words = ("precompensate", folder / "target.tif", "-o", folder / "c.tif", "--report", folder / "pre.yaml")
    done = dlw(*words, "--unreachable", folder / "u.tif")
    assert done.exit_code == 0, done.output
    report = yaml.safe_load((folder / "pre.yaml").read_text())
    assert report["predictions"] <= 10
    assert report["reachable"]["largest_to_initial"] < 0.01
    assert report["rmse_um"]["after"] < report["rmse_um"]["before"] / 10
    assert read_height_map(folder / "u.tif").shape == read_height_map(folder / "target.tif").shape


def test_precompensate_says_why_it_stopped(folder):
    words = ("precompensate", folder / "target.tif", "-o", folder / "c.tif", "--overwrite")
    assert "allow more --predictions" in dlw(*words, "--predictions", 2).stderr
    rounded = dlw(*words, "--slicing-um", 1).stderr
    assert "rounded to slices of 1 µm" in rounded and "--predictions" not in rounded
    assert "stopped" not in dlw(*words).stderr


def test_a_design_in_steps_is_named(folder):
    smooth = designs.air(size_um=24, pitch_um=0.2, margin_um=0).heights_um
    for heights, said in ((np.round(smooth / 0.5) * 0.5, True), (smooth, False)):
        path = folder / "design.tif"
        write_height_map(path, HeightMap(heights, 0.2, 0.2))
        done = dlw("precompensate", path, "-o", folder / "c.tif", "--predictions", 4, "--overwrite")
        assert ("comes in steps of 0.5 µm" in done.stderr) is said, done.stderr


def target_with(folder, heights):
    write_height_map(folder / "odd.tif", HeightMap(heights, 0.5, 0.5))
    return folder / "odd.tif"


@pytest.mark.parametrize("command", ["predict", "precompensate"])
@pytest.mark.parametrize(
    ("heights", "said"),
    [
        (np.zeros((9, 9)), "nothing written"),
        (np.pad([[1.0, -2.0]], 4), "at least 0"),
        (np.pad([[1.0, np.nan]], 4), "must be complete"),
    ],
)
def test_targets_that_cannot_be_written_leave_one_line_and_no_file(folder, command, heights, said):
    done = dlw(command, target_with(folder, heights), "-o", folder / "out.tif")
    assert done.exit_code == 1
    assert done.output.startswith("error: ") and done.output.count("\n") == 1
    assert "odd.tif" in done.output and said in done.output
    assert not (folder / "out.tif").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["-p", "absent.yaml"], "absent.yaml"),
        (["--method", "voxel", "--slice-um", "-1"], "--slice-um: found -1"),
    ],
)
def test_options_at_fault_are_named(folder, words, said):
    done = dlw("predict", folder / "target.tif", "-o", folder / "out.tif", *words)
    assert done.exit_code == 1 and said in done.output
    assert not (folder / "out.tif").exists()


def test_unknown_method_is_a_wrong_call(folder):
    assert dlw("predict", folder / "target.tif", "-o", folder / "out.tif", "--method", "guess").exit_code == 2


def test_a_small_prediction_loads_no_more_of_scipy_than_it_needs(tmp_path):
    """Loading its splines and optimisers takes three times as long as the prediction."""
    write_height_map(tmp_path / "t.tif", designs.air(size_um=5, pitch_um=0.5, margin_um=2))
    words = ["dlwpredict", "predict", str(tmp_path / "t.tif"), "-o", str(tmp_path / "o.tif"), "--quiet"]
    program = (
        f"import sys; sys.argv = {words!r}\n"
        "from dlwpredict.cli import main\n"
        "try:\n    main()\n"
        "except SystemExit as end:\n    assert not end.code\n"
        "print(sorted(name for name in sys.modules if name.startswith('scipy.') and name.count('.') == 1))"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    loaded = ast.literal_eval(ended.stdout)
    assert {"scipy.optimize", "scipy.interpolate", "scipy.special", "scipy.ndimage", "scipy.fft"}.isdisjoint(loaded)

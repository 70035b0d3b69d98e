"""The workflow that a lab copies: whole with two jobs, and redone only where something changed."""

import os
import shutil
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from dlwpredict.cli import app
from dlwpredict.designs import air, cin, lens
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.parameters_yaml import read_parameters
from dlwpredict.parameters import Paper, ParameterSet
from dlwpredict.process import predict

ROOT = Path(__file__).resolve().parents[1]
REPORT = {("report", "results")}
TRUTH = ParameterSet(Paper(threshold=0.4, shrinkage_max=0.9))

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="no make")


def make(folder, *words):
    program = Path(sys.executable).with_name("dlwpredict")
    assert program.exists()
    command = ["make", *words, f"DLW={program}"]
    environment = {key: value for key, value in os.environ.items() if not key.startswith("MAKE")}
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, env=environment)


def steps(folder, *words):
    """Return what `make` would do: (command, first file) of every step."""
    result = make(folder, "-n", *words)
    assert result.returncode == 0, result.stderr
    lines = [line.split() for line in result.stdout.replace("\\\n", " ").splitlines()]
    return {(words[1], words[2]) for words in lines if words[0].endswith("dlwpredict")}


@contextmanager
def touched(path):
    """Let a file be newer than everything for a while."""
    before, later = path.stat(), time.time() + 5
    os.utime(path, (later, later))
    yield
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A folder as `init` lays it out: two parts recorded, one of them twice, and a design not printed yet."""
    folder = tmp_path_factory.mktemp("lab")
    assert CliRunner().invoke(app, ["init", str(folder)]).exit_code == 0
    parts = {
        "air": air(size_um=20, pitch_um=0.5, margin_um=4),
        "cin": cin(size_um=20, pitch_um=0.5, margin_um=4),
        "new": lens(size_um=20, pitch_um=0.5, margin_um=4),
    }
    for name, part in parts.items():
        write_height_map(folder / "targets" / f"{name}.tif", part)
        (folder / "targets" / f"{name}.tif.provenance.yaml").write_text("step: design\n")  # as `design` leaves it
    second = replace(parts["air"], heights_um=1.1 * parts["air"].heights_um)
    write_height_map(folder / "written" / "air--second.tif", second)
    generator = np.random.default_rng(1)
    for name, written in (("air", parts["air"]), ("air--second", second), ("cin", parts["cin"])):
        print_of = predict(written, TRUTH).heights_um
        recording = 1e-6 * (print_of + generator.normal(0, 0.005, print_of.shape))
        np.savetxt(folder / "recordings" / f"{name}.txt", recording, fmt="%.5e", delimiter="\t")
    settings = [
        "CONVERT = --pitch-um 0.5 --z-scale 1e6",
        "ALIGN = --distortion rigid",
        "CALIBRATE = --free threshold --free shrinkage_max",
        "DIAGNOSE = --no-advice --jobs 1",
    ]
    (folder / "settings.mk").write_text("\n".join([*settings, "HOLD_OUT = cin", ""]))
    return folder


@pytest.fixture(scope="module")
def made(lab):
    result = make(lab, "-j2")
    assert result.returncode == 0, result.stdout + result.stderr
    return lab


@pytest.mark.slow
@pytest.mark.long
def test_two_jobs_make_everything(made):
    results = made / "results"
    for name in ("air", "air--second", "cin"):
        for file in ("recording.tif", "aligned.tif", "align.yaml", "predicted.tif", "score.json", "score.png"):
            assert (results / name / file).is_file(), (name, file)
    assert (results / "report.html").stat().st_size > 1e5
    for part in ("air", "cin", "new"):
        assert (results / part / "corrected.stl").stat().st_size > 84
    found = read_parameters(results / "process.yaml").paper  # each made on the same pixels: the truth comes back
    assert found.threshold == pytest.approx(0.4, abs=0.02)
    assert found.shrinkage_max == pytest.approx(0.9, abs=0.01)
    said = (results / "process.yaml").read_text()
    assert "results/air--second/written.tif" in said
    assert "results/cin" not in said
    corrected, target = (read_height_map(results / "air" / f"{name}.tif") for name in ("corrected", "target"))
    reprinted = predict(corrected, TRUTH).heights_um
    first = predict(target, TRUTH).heights_um
    part = target.heights_um > 0
    off = [np.sqrt(np.mean((one - target.heights_um)[part] ** 2)) for one in (first, reprinted)]
    assert off[1] < 0.5 * off[0]


@pytest.mark.slow
@pytest.mark.long
def test_nothing_is_done_twice(made):
    assert make(made, "-q").returncode == 0
    assert steps(made) == set()


@pytest.mark.slow
@pytest.mark.long
def test_what_depends_on_a_file_is_redone_and_nothing_else(made):
    with touched(made / "targets" / "new.tif"):
        assert steps(made) - REPORT == {
            ("convert", "targets/new.tif"),
            ("precompensate", "results/new/target.tif"),
            ("export-stl", "results/new/corrected.tif"),
        }
    with touched(made / "recordings" / "air.txt"):
        found = steps(made)
    assert ("calibrate", "--pair") in found
    assert {file for command, file in found if command in ("convert", "align")} == {
        "recordings/air.txt",
        "results/air/recording.tif",
    }
    assert {file for command, file in found if command == "precompensate"} == {
        f"results/{part}/target.tif" for part in ("air", "cin", "new")
    }


@pytest.mark.slow
@pytest.mark.long
def test_a_recording_that_is_held_out_teaches_nothing(made):
    os.utime(made / "recordings" / "cin.txt")
    assert steps(made) - REPORT == {
        ("convert", "recordings/cin.txt"),
        ("align", "results/cin/recording.tif"),
        ("score", "results/cin/predicted.tif"),
    }
    before = (made / "results" / "process.yaml").stat().st_mtime_ns
    result = make(made, "-j2")
    assert result.returncode == 0, result.stderr
    assert (made / "results" / "process.yaml").stat().st_mtime_ns == before
    assert steps(made) == set()


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ([], "targets: no height map there"),
        (["targets/a.tif"], "recordings: none to learn from"),
        (["targets/a.tif", "recordings/b.txt"], "recordings: b has no target b in targets"),
        (["targets/a.tif", "recordings/a.txt", "recordings/a.nms"], "recordings: a stands there twice"),
        (["targets/a.tif", "recordings/a b.txt"], "names must not hold spaces: recordings/a b.txt"),
    ],
)
def test_a_wrong_folder_is_said(tmp_path, files, words):
    assert CliRunner().invoke(app, ["init", str(tmp_path)]).exit_code == 0
    for name in files:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    result = make(tmp_path)
    assert result.returncode == 2
    assert words in result.stderr


def test_init_lays_out_a_folder_and_replaces_nothing(tmp_path):
    lab = tmp_path / "lab"
    assert CliRunner().invoke(app, ["init", str(lab)]).exit_code == 0
    kept = {"Makefile", "README.md", "settings.mk", "start.yaml", "targets", "recordings", "written"}
    assert {one.name for one in lab.iterdir()} == kept
    assert read_parameters(lab / "start.yaml").paper == Paper()
    assert (lab / "start.yaml").read_bytes() == (ROOT / "configs" / "real.yaml").read_bytes()
    (lab / "targets" / "a.tif").touch()
    (lab / "recordings" / "a.txt").touch()
    assert "-p start.yaml" in make(lab, "-n", "calibrate").stdout
    (lab / "Makefile").write_text("mine")
    again = CliRunner().invoke(app, ["init", str(lab)])
    assert again.exit_code == 1 and again.stderr.startswith(f"error: {lab / 'Makefile'}: ")
    assert (lab / "Makefile").read_text() == "mine"


def test_help_needs_no_files(tmp_path):
    CliRunner().invoke(app, ["init", str(tmp_path)])
    result = make(tmp_path, "help")
    assert result.returncode == 0, result.stderr
    assert "make diagnose" in result.stdout and "HOLD_OUT" in result.stdout


def test_the_projects_own_makefile_leaves_it_out():
    result = subprocess.run(["make", "-n", "help"], cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr


@pytest.mark.slow
@pytest.mark.long
def test_a_setting_that_changed_redoes_its_step_and_what_follows(made):
    assert steps(made) == set()
    everything = {"results/new/target.tif", "results/air/target.tif", "results/cin/target.tif"}
    settings = made / "settings.mk"
    before = settings.read_text()
    try:
        settings.write_text(before + "EXPORT_new = --max-error-um 0.02\n")
        assert steps(made) - REPORT == {("export-stl", "results/new/corrected.tif")}
        settings.write_text(before + "CORRECT = --predictions 12\n")
        found = steps(made) - REPORT
        assert {file for command, file in found if command == "precompensate"} == everything
        assert {command for command, _ in found} == {"precompensate", "export-stl"}
        settings.write_text(before + "ALIGN_cin = --distortion affine\n")
        assert {file for command, file in steps(made) if command == "align"} == {"results/cin/recording.tif"}
        assert "calibrate" not in {command for command, _ in steps(made)}  # cin is held out
        settings.write_text(before.replace("HOLD_OUT = cin", ""))
        assert ("calibrate", "--pair") in steps(made)
    finally:
        settings.write_text(before)
        assert make(made, "-t").returncode == 0  # the options are noted as they were, newer than what they made
    assert steps(made) == set()

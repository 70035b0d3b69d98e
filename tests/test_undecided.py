"""Effects that may be the print's or the measurement's: correcting a print needs a decision."""

import re
from dataclasses import replace

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from dlwpredict import designs
from dlwpredict.cli.app import app
from dlwpredict.effects import library
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.parameters_yaml import write_parameters
from dlwpredict.parameters import Paper, ParameterSet, Process, Undecided

CURVATURE = library()["field-curvature"](sag_um=-0.8)
VIGNETTING = library()["vignetting"](strength=0.3)
CURL = library()["curl"](rise_um=0.2)
MEMORY = library()["dose-memory"](gain=0.05)
PAPER = Paper(threshold=0.5)
OTHER = Paper(threshold=0.47, shrinkage_min=0.72)
EITHER = Undecided(
    ("field-curvature",), print=Process(OTHER, (MEMORY, CURL)), measurement=Process(PAPER, (CURVATURE, MEMORY))
)
OPEN = ParameterSet(PAPER, effects=(CURVATURE, MEMORY), intervals={"threshold": (0.4, 0.6)}, undecided=EITHER)


def test_a_decision_puts_the_whole_process_of_that_side_in_place():
    """The seven as well: they answer to what stands beside them."""
    found = OPEN.decided("print")
    assert (found.paper, found.effects, found.undecided) == (OTHER, (MEMORY, CURL), None)


def test_intervals_are_those_of_the_process_at_hand():
    assert OPEN.decided("measurement") == replace(OPEN, undecided=None)
    assert OPEN.decided("print").intervals == {}


def test_where_nothing_is_open_a_decision_changes_nothing():
    closed = ParameterSet(effects=(VIGNETTING,))
    assert closed.decided("measurement") is closed


@pytest.fixture
def folder(tmp_path):
    write_height_map(tmp_path / "target.tif", designs.cin(size_um=24, pitch_um=0.6, margin_um=3))
    write_parameters(tmp_path / "open.yaml", OPEN)
    for side in ("print", "measurement"):
        write_parameters(tmp_path / f"{side}.yaml", OPEN.decided(side))
    write_parameters(tmp_path / "none.yaml", ParameterSet(effects=(MEMORY,)))
    return tmp_path


def correct(folder, parameters, *words, out="out.tif"):
    words = ["precompensate", folder / "target.tif", "-p", folder / parameters, "-o", folder / out, *words]
    return CliRunner().invoke(app, [str(word) for word in words])


def test_without_a_decision_nothing_is_written_and_both_outcomes_are_shown(folder):
    done = correct(folder, "open.yaml")
    assert done.exit_code == 1 and not (folder / "out.tif").exists()
    assert done.stderr.count("\n") == 1 and done.stderr.startswith(f"error: {folder / 'open.yaml'}: undecided: ")
    assert "field-curvature" in done.stderr
    assert "allowed: --undecided print or --undecided measurement" in done.stderr
    lines = done.stdout.splitlines()
    assert [line.split(":")[0] for line in lines] == ["--undecided print", "--undecided measurement"]


def test_the_outcomes_shown_are_those_of_the_two_corrections(folder):
    shown = correct(folder, "open.yaml").stdout.splitlines()
    for side in ("print", "measurement"):
        assert correct(folder, f"{side}.yaml", out=f"{side}.tif").exit_code == 0
    made = [read_height_map(folder / f"{side}.tif").heights_um for side in ("print", "measurement")]
    part = read_height_map(folder / "target.tif").heights_um > 0
    apart = (made[0] - made[1])[part]
    for line in shown:
        right, wrong, largest, rms = (float(n) for n in re.findall(r"\d+\.\d+", line))
        assert largest == pytest.approx(np.abs(apart).max(), abs=2e-4)
        assert rms == pytest.approx(np.sqrt(np.mean(apart**2)), abs=2e-4)
        assert right < wrong / 3


@pytest.mark.parametrize("side", ["print", "measurement"])
def test_a_decision_corrects_for_the_member_of_that_side_alone(folder, side):
    done = correct(folder, "open.yaml", "--undecided", side, "--report", folder / "pre.yaml")
    assert done.exit_code == 0, done.output
    assert correct(folder, f"{side}.yaml", out="same.tif").exit_code == 0
    assert (folder / "out.tif").read_bytes() == (folder / "same.tif").read_bytes()
    assert yaml.safe_load((folder / "pre.yaml").read_text())["undecided"] == side


def test_decided_for_the_measurement_nothing_of_the_class_is_corrected(folder):
    assert correct(folder, "open.yaml", "--undecided", "measurement").exit_code == 0
    assert correct(folder, "none.yaml", out="none.tif").exit_code == 0
    assert (folder / "out.tif").read_bytes() == (folder / "none.tif").read_bytes()


def test_no_decision_is_needed_where_the_side_is_known(folder):
    assert correct(folder, "none.yaml").exit_code == 0
    assert correct(folder, "none.yaml", "--undecided", "print", out="given.tif").exit_code == 0
    assert (folder / "out.tif").read_bytes() == (folder / "given.tif").read_bytes()


def test_an_unknown_side_is_a_wrong_call(folder):
    assert correct(folder, "open.yaml", "--undecided", "both").exit_code == 2

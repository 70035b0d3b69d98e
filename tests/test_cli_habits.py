"""What holds for every command: lengths with units, standard output, figures as JSON, no colour unasked."""

import importlib
import json
import os
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image
from typer.main import get_command
from typer.testing import CliRunner

from dlwpredict.cli import app
from dlwpredict.cli.commands import NAMES, Commands, outlines
from dlwpredict.designs import cin
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.heightmap import HeightMap

PROGRAM = Path(sys.executable).with_name("dlwpredict")
PARAMETERS = Path(__file__).parents[1] / "configs" / "paper-defaults.yaml"


def run(*arguments):
    return CliRunner().invoke(app, [str(word) for word in arguments])


@pytest.fixture
def part(tmp_path):
    write_height_map(tmp_path / "part.tif", cin(size_um=20, pitch_um=0.5, margin_um=4))
    return tmp_path / "part.tif"


@pytest.mark.parametrize("pitch", [["100nm", "0.2"], ["0.1", "200nm"], ["0.0001mm,0.2um"], ["100nm", "0.2µm"]])
def test_a_pitch_may_be_given_in_nm(tmp_path, part, pitch):
    assert run("convert", part, tmp_path / "a.tif", "--pitch-um", *pitch).exit_code == 0
    found = read_height_map(tmp_path / "a.tif")
    assert (found.dx_um, found.dy_um) == (0.1, 0.2)
    assert run("design", "lens", "-o", tmp_path / "b.tif", "--size-um", "20", "--pitch-um", "250nm").exit_code == 0
    assert read_height_map(tmp_path / "b.tif").dx_um == 0.25


@pytest.mark.parametrize("wrong", ["100 nm", "100pm", "nm", "0.1 0.2 0.3", "1e"])
def test_other_units_are_refused(tmp_path, part, wrong):
    result = run("convert", part, tmp_path / "a.tif", f"--pitch-um={wrong}")
    assert (result.exit_code, result.stderr.count("\n")) == (1, 1)
    assert "--pitch-um: found" in result.stderr
    assert run("design", "lens", "-o", tmp_path / "b.tif", "--size-um", wrong).exit_code == 2


def test_text_goes_to_standard_output_and_words_to_standard_error(tmp_path, part):
    result = run("convert", part, "-")
    assert result.exit_code == 0, result.output
    (tmp_path / "a.txt").write_text(result.stdout)
    assert read_height_map(tmp_path / "a.txt").same_grid(read_height_map(part))
    assert "standard output: " in result.stderr
    result = run("score", part, part, "--json", "-")
    assert json.loads(result.stdout)["rmse_um"] == 0
    assert "rmse" in result.stderr
    result = run("precompensate", part, "-o", tmp_path / "c.tif", "--report", "-", "--predictions", "2")
    assert yaml.safe_load(result.stdout)["rmse_um"]["after"] < 1
    assert sorted(path.name for path in tmp_path.glob("*.tif")) == ["c.tif", "part.tif"]


def test_what_is_no_text_needs_a_file(tmp_path, part, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for words, key in [
        (("predict", part, "-o", "-"), "output"),
        (("export-stl", part, "-o", "-"), "output"),
        (("convert", "-", "a.tif"), "source"),
        (("align", part, part, "-o", "a.tif", "--report", "-", "--json", "-"), "--json"),
    ]:
        result = run(*words)
        assert (result.exit_code, result.stdout) == (1, "")
        assert result.stderr.startswith(f"error: {key}: found -")
    assert list(tmp_path.iterdir()) == [part]


def test_figures_as_json(tmp_path, part):
    solid = json.loads(run("export-stl", part, "-o", tmp_path / "a.stl", "--json", "-").stdout)
    assert solid["volume_um3"] == pytest.approx(read_height_map(part).heights_um.sum() * 0.25, rel=0.02)
    assert run("predict", part, "-o", tmp_path / "b.tif", "--json", tmp_path / "b.json").exit_code == 0
    found = json.loads((tmp_path / "b.json").read_text())
    printed = read_height_map(tmp_path / "b.tif")
    assert found["z_um"] == pytest.approx([printed.heights_um.min(), printed.heights_um.max()], rel=1e-6)
    assert (found["rows"], found["pitch_um"], found["missing_fraction"]) == (56, [0.5, 0.5], 0)
    assert found["provenance"]["inputs"].keys() == {str(part)}
    known = json.loads(run("effects", "vignetting", "--json", "-").stdout)
    assert known["vignetting"]["parameters"]["strength"]["default"] == 0


def test_grey_levels_come_with_their_heights(tmp_path, part):
    words = ["convert", part, tmp_path / "a.png", "--z-range", "-1", "12.107", "--json", tmp_path / "a.json"]
    result = run(*words)
    assert "level 0 = -1 µm, 65535 = 12.107 µm, 0.2 nm each" in result.stdout
    grey = json.loads((tmp_path / "a.json").read_text())["grey_levels"]
    read = np.asarray(Image.open(tmp_path / "a.png")).astype(float)
    back = grey["level_0_um"] + read * grey["level_um"]
    assert back == pytest.approx(read_height_map(part).heights_um, abs=grey["level_um"])


def test_a_json_file_is_an_output_like_any_other(tmp_path, part):
    (tmp_path / "a.json").write_text("old")
    refused = run("predict", part, "-o", tmp_path / "b.tif", "--json", tmp_path / "a.json")
    assert "exists already" in refused.stderr
    assert not (tmp_path / "b.tif").exists()
    assert "named twice" in run("predict", part, "-o", tmp_path / "b.tif", "--json", tmp_path / "b.tif").stderr


@pytest.mark.parametrize(
    "words",
    [
        ("score", "part.tif", "part.tif", "--json", "part.tif"),
        ("align", "part.tif", "part.tif", "-o", "a.tif", "--report", "part.tif"),
        ("precompensate", "part.tif", "-p", "p.yaml", "-o", "c.tif", "--report", "p.yaml"),
    ],
)
def test_no_output_is_an_input_too(part, monkeypatch, words):
    """Not even with --overwrite, as Makefiles give it."""
    monkeypatch.chdir(part.parent)
    (part.parent / "p.yaml").write_text(Path(PARAMETERS).read_text(encoding="utf-8"), encoding="utf-8")
    before = {path: path.read_bytes() for path in part.parent.iterdir()}
    result = run(*words, "--overwrite")
    assert (result.exit_code, result.stderr.count("\n")) == (1, 1)
    assert f"error: {words[-1]}: output: is read by this command" in result.stderr
    assert {path: path.read_bytes() for path in part.parent.iterdir()} == before


@pytest.mark.parametrize("overwrite", [False, True])
def test_what_has_come_since_a_command_began_is_not_replaced_unasked(part, monkeypatch, overwrite):
    result_at = part.parent / "a.tif"

    def meanwhile(*of, **words):
        result_at.write_text("precious")
        return read_height_map(*of, **words)

    monkeypatch.setattr("dlwpredict.cli.convert.read_height_map", meanwhile)
    result = run("convert", part, result_at, *["--overwrite"][: int(overwrite)])
    if overwrite:
        assert result.exit_code == 0 and read_height_map(result_at).same_grid(read_height_map(part))
    else:
        assert result.exit_code == 1 and "exists by now, allowed with --overwrite" in result.stderr
        assert result_at.read_text() == "precious" and len(list(part.parent.iterdir())) == 2


def test_what_the_system_refuses_is_said_in_one_line(part):
    result = run("convert", part, part.parent / f"{300 * 'a'}.tif")
    assert (result.exit_code, result.stderr.count("\n")) == (1, 1)
    assert "File name too long" in result.stderr


@pytest.mark.parametrize("words", [("--seed", "-1"), ("--working-pitch-um", "1e300"), ("--wall-px", 21 * "9")])
def test_numbers_beyond_all_sense_are_wrong_words(part, words):
    result = run("calibrate", "--pair", part, part.parent / "r.tif", "-o", part.parent / "p.yaml", *words)
    assert result.exit_code == 2 and words[0] in result.stderr


@pytest.mark.parametrize("command", ["predict", "precompensate"])
def test_the_unit_of_a_design_is_doubted(part, command):
    heights = read_height_map(part)
    write_height_map(part, heights.with_heights(1e-4 * heights.heights_um))
    result = run(command, part, "-o", part.parent / "a.tif")
    assert result.exit_code == 0 and "is the unit right (--z-scale)?" in result.stderr


def test_what_is_not_finite_is_null(tmp_path):
    heights = np.ones((64, 64))
    heights[0, 0] = np.nan
    write_height_map(tmp_path / "a.tif", HeightMap(heights, 0.5, 0.5))
    assert json.loads(run("convert", tmp_path / "a.tif", "-o", tmp_path / "b.tif", "--json", "-").stdout)["rows"] == 64


def test_every_command_is_listed_with_its_own_first_line():
    package = sys.modules["dlwpredict.cli"]
    modules = [
        importlib.import_module(f"dlwpredict.cli.{found.name}") for found in pkgutil.iter_modules(package.__path__)
    ]
    assert sorted(module.COMMAND for module in modules if hasattr(module, "COMMAND")) == sorted(NAMES)
    assert {name: listed.help for name, listed in outlines().items()} == {
        name: command.help for name, command in Commands().items()
    }


@pytest.mark.slow
def test_the_list_of_commands_needs_none_of_them():
    """Neither as help nor while the shell completes a name: numpy alone would take longer than all that is shown."""
    asked = {"_DLWPREDICT_COMPLETE": "complete_bash", "COMP_WORDS": "dlwpredict pre", "COMP_CWORD": "1"}
    for environment, words, expected in [({}, ["--help"], NAMES), (asked, [], ("predict", "precompensate"))]:
        code = f"import sys; from dlwpredict.cli import main; sys.argv = ['dlwpredict', *{words}]; main()"
        done = subprocess.run(
            [sys.executable, "-X", "importtime", "-c", code],
            env={**os.environ, **environment},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0
        assert all(name in done.stdout for name in expected)
        assert "numpy" not in done.stderr


SAYS_NO_FIGURES = {"report", "verify", "init"}


def test_every_command_that_says_figures_has_json():
    program = get_command(app)
    commands = {
        name: command for name, command in program.commands.items() if name not in SAYS_NO_FIGURES and name != "design"
    }
    commands |= program.commands["design"].commands
    missing = [
        name
        for name, command in commands.items()
        if not any("--json" in getattr(option, "opts", ()) for option in command.params)
    ]
    assert missing == []


COLOUR = re.compile(rb"\x1b\[[0-9;]*(3[0-79]|4[0-79]|9[0-7]|10[0-7])[0-9;]*m")


def shown(arguments, terminal, **environment):
    """Return everything that the program writes, on a terminal or through a pipe."""
    known = {key: value for key, value in os.environ.items() if key not in ("NO_COLOR", "FORCE_COLOR", "PY_COLORS")}
    known |= {"TERM": "xterm-256color", **environment}
    if not terminal:
        return subprocess.run([PROGRAM, *arguments], env=known, capture_output=True).stdout
    import pty

    ours, theirs = pty.openpty()
    with subprocess.Popen([PROGRAM, *arguments], env=known, stdin=theirs, stdout=theirs, stderr=theirs) as process:
        os.close(theirs)
        text = b""
        try:
            while piece := os.read(ours, 65536):
                text += piece
        except OSError:  # the other end is closed
            pass
        process.wait()
    os.close(ours)
    return text


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminal")
@pytest.mark.parametrize("arguments", [["score", "--help"], ["predict", "absent.tif"]])
def test_colour_on_a_terminal_only_and_not_with_no_color(arguments):
    assert COLOUR.search(shown(arguments, terminal=True))
    assert not COLOUR.search(shown(arguments, terminal=True, NO_COLOR="1"))
    assert b"\x1b" not in shown(arguments, terminal=False)


@pytest.mark.parametrize(
    ("module", "large"), [("dlwpredict.cli.predict.predict", False), ("dlwpredict.cli.large.written", True)]
)
def test_ctrl_c_ends_a_command_with_its_own_code_and_no_result(tmp_path, part, monkeypatch, module, large):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(module, interrupted)
    tiles = ["--tile-px", 64] if large else []
    result = run("predict", part, "-p", PARAMETERS, "-o", tmp_path / "out.tif", *tiles)
    assert result.exit_code == 130
    assert result.stderr.splitlines()[-1].startswith("error: ") and "interrupted" in result.stderr
    assert not (tmp_path / "out.tif").exists()

"""Same input, same bytes; every output names its command, inputs, versions and seed; `verify` checks them."""

import json
import platform
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import dlwpredict
from dlwpredict.cli.app import app
from dlwpredict.files import write_height_map
from dlwpredict.files.provenance import RECORDS, note_input, origin, present_run, running, sha256, stated_by
from dlwpredict.files.yaml_text import read_yaml
from dlwpredict.heightmap import HeightMap
from tests.crash.checks import snapshot
from tests.crash.commands import COMMANDS, OTHERS, WRITE_NOTHING, commands, inputs

HEAVY = pytest.param("diagnose", marks=[pytest.mark.slow, pytest.mark.long])


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    folder = tmp_path_factory.mktemp("source")
    inputs(folder)
    return folder


@pytest.fixture
def call(source, tmp_path, monkeypatch):
    """Run a command in a folder that holds the inputs of all commands."""
    for path in source.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    monkeypatch.chdir(tmp_path)
    return lambda *words: CliRunner().invoke(app, [str(word) for word in words])


def test_every_command_is_covered():
    assert commands() <= COMMANDS.keys() | WRITE_NOTHING | OTHERS


@pytest.mark.slow
@pytest.mark.parametrize("command", [HEAVY if name == "diagnose" else name for name in COMMANDS])
def test_same_command_same_bytes_and_every_output_says_where_it_comes_from(call, tmp_path, command):
    words, given = COMMANDS[command], snapshot(tmp_path)
    results = []
    for _ in range(2):
        done = call(*words, "--overwrite")
        assert done.exit_code == 0, done.output
        results.append(snapshot(tmp_path))
    assert results[0] == results[1]
    outputs = sorted(Path(name) for name in results[0].keys() - given.keys() if not name.endswith(".provenance.yaml"))
    assert outputs
    read = {word for word in words if word in given}
    for path in outputs:
        stated = stated_by(path)
        assert stated["inputs"] == {name: sha256(Path(name)) for name in stated["inputs"]}
        assert stated["inputs"].keys() == read
        assert stated["command"].startswith(f"dlwpredict {command}")
        assert all(word in stated["command"] for word in words[:4])
        assert stated["versions"]["dlwpredict"] == dlwpredict.__version__
        assert stated["versions"]["numpy"] == np.__version__
        assert stated["versions"]["python"] == platform.python_version()
        assert ("seed" in stated) == (command in ("calibrate", "diagnose"))
    assert call("verify", *outputs).exit_code == 0


@pytest.mark.slow
def test_yaml_and_json_carry_it_themselves_and_stay_readable(call, tmp_path):
    assert call(*COMMANDS["score"]).exit_code == 0
    assert json.loads(Path("score.json").read_text())["provenance"]["inputs"].keys() == {"target.tif", "aligned.tif"}
    assert call(*COMMANDS["align"]).exit_code == 0
    assert read_yaml("align.yaml")["provenance"]["inputs"].keys() == {"recording.tif", "target.tif"}
    assert not [
        path
        for path in tmp_path.iterdir()
        if path.name.endswith((".json.provenance.yaml", "align.yaml.provenance.yaml"))
    ]


def test_the_seed_of_a_design_is_named(call):
    assert call("design", "air", "-o", "air.tif", "--seed", 3, "--pitch-um", 1).exit_code == 0
    assert stated_by(Path("air.tif"))["seed"] == 3


def test_a_command_line_can_be_run_again(call):
    write_height_map("with space.tif", HeightMap(np.ones((9, 9)), 1, 1))
    assert call("convert", "with space.tif", "a.csv").exit_code == 0
    assert stated_by(Path("a.csv"))["command"] == "dlwpredict convert 'with space.tif' a.csv"


def test_verify_tells_changed_from_missing(call):
    assert call("predict", "target.tif", "-o", "predicted.tif").exit_code == 0
    done = call("verify", "predicted.tif")
    assert (done.exit_code, done.stdout) == (0, "predicted.tif: target.tif matches\n")
    content = Path("target.tif").read_bytes()
    Path("target.tif").write_bytes(content[:-1] + b"?")
    done = call("verify", "predicted.tif", "predicted.tif.provenance.yaml", "--quiet")
    assert (done.exit_code, done.stdout) == (1, "")
    assert done.stderr == (
        "error: predicted.tif: inputs: target.tif has changed (and 1 more), make it again, or bring the inputs back\n"
    )
    Path("target.tif").unlink()
    assert "target.tif is missing" in call("verify", "predicted.tif").stderr


def test_verify_finds_inputs_beside_a_result_that_was_moved_with_them(call, tmp_path, monkeypatch):
    assert call("predict", "target.tif", "-o", "predicted.tif").exit_code == 0
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert call("verify", "../predicted.tif").exit_code == 0


def test_verify_sees_that_the_result_itself_is_another(call):
    assert call("predict", "target.tif", "-o", "predicted.tif").exit_code == 0
    Path("predicted.tif").write_bytes(Path("target.tif").read_bytes())
    done = call("verify", "predicted.tif")
    assert done.exit_code == 1
    assert "predicted.tif itself is not the file that predicted.tif.provenance.yaml belongs to" in done.stderr


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("absent.tif", None, "absent.tif: file: no such file"),
        ("target.tif", None, "target.tif: provenance: states no provenance"),
        ("p.yaml", "provenance: 3\n", "p.yaml: provenance: states no provenance"),
        ("p.yaml", "provenance: {inputs: [a]}\n", "p.yaml: provenance: states no provenance"),
        ("p.yaml", "{", "p.yaml: file: not plain YAML"),
        ("p.json", "[]", "p.json: provenance: states no provenance"),
    ],
)
def test_verify_refuses_what_states_nothing(call, name, content, said):
    if content is not None:
        Path(name).write_text(content)
    done = call("verify", name)
    assert done.exit_code == 1
    assert done.stderr.startswith(f"error: {said}")
    assert done.stderr.count("\n") == 1


def test_a_library_call_states_nothing(tmp_path):
    assert present_run() is None
    write_height_map(tmp_path / "a.tif", HeightMap(np.ones((4, 4)), 1, 1))
    assert [path.name for path in tmp_path.iterdir()] == ["a.tif"]


def test_runs_do_not_mix(tmp_path):
    with running(["dlwpredict", "outer"]) as outer:
        with running(["dlwpredict", "inner"]) as inner:
            assert present_run() is inner
        assert present_run() is outer
        path = tmp_path / "a.bin"
        path.write_bytes(b"abc")
        note_input(path)
        assert origin()["inputs"] == outer.inputs
        assert outer.inputs == {str(path): "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"}
        assert not inner.inputs
    assert origin() is None
    assert ".yaml" in RECORDS


def test_verify_looks_beside_the_result_before_anywhere_else(tmp_path, monkeypatch):
    """A file of the same name where the user stands is another one."""
    for folder in ("there", "here"):
        (tmp_path / folder).mkdir()
        write_height_map(tmp_path / folder / "t.tif", HeightMap(np.eye(12), 0.5, 0.5))
    monkeypatch.chdir(tmp_path / "there")
    assert CliRunner().invoke(app, ["predict", "t.tif", "-o", "p.tif"]).exit_code == 0
    monkeypatch.chdir(tmp_path / "here")
    assert CliRunner().invoke(app, ["verify", "../there/p.tif"]).exit_code == 0
    write_height_map(tmp_path / "there" / "t.tif", HeightMap(2 * np.eye(12), 0.5, 0.5))
    done = CliRunner().invoke(app, ["verify", "../there/p.tif"])
    assert done.exit_code == 1 and f"t.tif has changed ({tmp_path / 'there' / 't.tif'})" in done.stderr
    (tmp_path / "there" / "t.tif").unlink()
    assert CliRunner().invoke(app, ["verify", "../there/p.tif"]).exit_code == 0  # the same, found from here

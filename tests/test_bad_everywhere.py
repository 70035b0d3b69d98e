"""All commands x all documented bad inputs: exit code 1, one line on stderr that names the file, no output."""

import numpy as np
import pytest
from typer.testing import CliRunner

from dlwpredict.cli.app import app
from dlwpredict.files import write_height_map
from dlwpredict.heightmap import HeightMap
from tests.crash.checks import snapshot
from tests.crash.commands import commands
from tests.fuzz.readers import PARAMETERS
from tests.test_bad_files import BAD

GOOD = PARAMETERS[0].decode()
BAD_MAPS = {case: (name, make) for case, (name, make, pitch, _) in BAD.items() if pitch in ([], ["1"])}
BAD_PARAMETERS = {
    "nothing there": None,
    "empty": "",
    "no YAML": "{",
    "a list": "[1, 2]",
    "binary": b"\xff\xfe\0",
    "wrong format": GOOD.replace("parameters/1", "parameters/9"),
    "unknown key": GOOD + "kappa: 1\n",
    "missing key": GOOD.replace("threshold:", "#threshold:"),
    "key given twice": GOOD + "threshold: 0.4\n",
    "no number": GOOD.replace("threshold: 0.5", "threshold: half"),
    "a truth": GOOD.replace("threshold: 0.5", "threshold: yes"),
    "not a number": GOOD.replace("threshold: 0.5", "threshold: .nan"),
    "below range": GOOD.replace("threshold: 0.5", "threshold: -1"),
    "above range": GOOD.replace("exposure_fwhm_z_um: 1.5", "exposure_fwhm_z_um: 1e9"),
    "unknown effect": GOOD.replace("effects: []", "effects: [{name: gravity}]"),
    "effect without name": GOOD.replace("effects: []", "effects: [{strength: 1}]"),
    "effect twice": GOOD.replace("effects: []", "effects: [{name: vignetting}, {name: vignetting}]"),
    "unknown parameter of an effect": GOOD.replace("effects: []", "effects: [{name: vignetting, size: 1}]"),
    "effect out of range": GOOD.replace("effects: []", "effects: [{name: vignetting, strength: 1e9}]"),
    "tag": GOOD + "provenance: !!python/name:os.system\n",
    "alias": GOOD + "bounds: &a {}\nintervals: *a\n",
    "bounds the wrong way": GOOD + "bounds: {threshold: [0.9, 0.1]}\n",
    "bounds of nothing": GOOD + "bounds: {kappa: [0, 1]}\n",
}

PAIR = ("--pair", "target.tif", "good.tif")
CALLS = {
    "align": [("align", "MAP", "target.tif", "-o", "OUT.tif"), ("align", "good.tif", "MAP", "-o", "OUT.tif")],
    "calibrate": [
        ("calibrate", "--pair", "MAP", "good.tif", "-o", "OUT.yaml"),
        ("calibrate", "--pair", "target.tif", "MAP", "-o", "OUT.yaml"),
        ("calibrate", *PAIR, "--pair", "target.tif", "MAP", "-o", "OUT.yaml"),
        ("calibrate", *PAIR, "-p", "PARAMETERS", "-o", "OUT.yaml"),
    ],
    "convert": [("convert", "MAP", "OUT.tif")],
    "design": [("design", "f", "-o", "OUT.tif")],
    "diagnose": [
        ("diagnose", "--pair", "MAP", "good.tif", "-o", "OUT.yaml"),
        ("diagnose", "--pair", "target.tif", "MAP", "-o", "OUT.yaml"),
        ("diagnose", *PAIR, "-p", "PARAMETERS", "-o", "OUT.yaml", "--maps", "maps", "--report", "r.html"),
    ],
    "export-stl": [("export-stl", "MAP", "-o", "OUT.stl")],
    "precompensate": [
        ("precompensate", "MAP", "-o", "OUT.tif", "--report", "pre.yaml"),
        ("precompensate", "target.tif", "-p", "PARAMETERS", "-o", "OUT.tif", "--unreachable", "u.tif"),
    ],
    "predict": [
        ("predict", "MAP", "-o", "OUT.tif"),
        ("predict", "target.tif", "-p", "PARAMETERS", "-o", "OUT.tif", "--method", "voxel"),
    ],
    "score": [
        ("score", "MAP", "good.tif", "--json", "OUT.json", "--plot", "s.png"),
        ("score", "target.tif", "MAP", "-o", "OUT.json"),
    ],
    "verify": [("verify", "MAP")],
}
NO_FILES = {"effects"}
OWN_TESTS = {"batch", "report", "init"}
"""They take a manifest and a folder; their own tests walk those."""

CASES = [
    pytest.param(words, kind, case, id=f"{words[0]}-{k}-{case}")
    for name, calls in CALLS.items()
    for k, words in enumerate(calls)
    for kind, bad in (("MAP", BAD_MAPS), ("PARAMETERS", BAD_PARAMETERS))
    if kind in words
    for case in bad
]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    heights = np.pad(np.add.outer(np.arange(20.0), np.arange(20.0)) / 10 + 1, 6)
    write_height_map(tmp_path / "target.tif", HeightMap(heights, 0.5, 0.5))
    write_height_map(tmp_path / "good.tif", HeightMap(heights + rng.normal(scale=0.01, size=(32, 32)), 0.5, 0.5))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def made(folder, kind, case) -> str:
    """Make the bad input, and return its name."""
    if kind == "MAP":
        name, make = BAD_MAPS[case]
        make(folder / name)
        return name
    content = BAD_PARAMETERS[case]
    if content is not None:
        (folder / "p.yaml").write_bytes(content if isinstance(content, bytes) else content.encode())
    return "p.yaml"


def refused(words, folder) -> str:
    """Run a command that must refuse; return its one line."""
    before, entries = snapshot(folder), sorted(folder.rglob("*"))
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == 1, result.output
    assert isinstance(result.exception, SystemExit), result.exception
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert result.stderr.endswith("\n")
    assert snapshot(folder) == before
    assert sorted(folder.rglob("*")) == entries
    return result.stderr


def test_no_command_is_forgotten():
    assert commands() - OWN_TESTS == CALLS.keys() | NO_FILES


@pytest.mark.parametrize(("words", "kind", "case"), CASES)
def test_bad_inputs(folder, words, kind, case):
    name = made(folder, kind, case)
    assert refused([name if word == kind else word for word in words], folder).startswith(f"error: {name}: ")


@pytest.mark.parametrize("fault", ["no folder", "a folder", "there already", "ending"])
@pytest.mark.parametrize(
    "words",
    [
        pytest.param(calls[0], marks=[pytest.mark.slow] * (name == "align"), id=name)
        for name, calls in CALLS.items()
        if name != "verify"
    ],
)
def test_bad_outputs(folder, words, fault):
    out = next(word for word in words if word.startswith("OUT"))
    name = {"no folder": f"none/{out}", "a folder": "folder", "there already": out, "ending": "OUT.xyz"}[fault]
    (folder / "folder").mkdir()
    if fault == "there already":
        (folder / out).write_bytes(b"mine")
    if fault == "ending" and out.endswith((".yaml", ".json")):
        pytest.skip("what is written as YAML or JSON may end as it likes")
    said = refused([{out: name, "MAP": "target.tif"}.get(word, word) for word in words], folder)
    assert said.startswith(f"error: {name}: ")


def test_an_unknown_effect_is_refused(folder):
    assert "NAME: found gravity" in refused(["effects", "gravity"], folder)

"""Bad input: one line that names file, key and what is allowed; exit code 1; nothing left behind."""

import gzip
import subprocess
import sys

import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from typer.testing import CliRunner

from dlwpredict.cli import app
from dlwpredict.errors import InputError
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.formats import formats
from dlwpredict.heightmap import HeightMap

MAP = np.linspace(0, 1, 400, dtype=np.float32).reshape(20, 20)


def tiff(values, **options):
    def make(path):
        tifffile.imwrite(path, np.asarray(values), **options)

    return make


def data(content):
    return lambda path: path.write_bytes(content)


def npy(values):
    return lambda path: np.save(path, values, allow_pickle=True)


def with_value(value):
    heights = MAP.copy()
    heights[2, 3] = value
    return heights


BAD = {
    "no pitch": ("a.tif", tiff(MAP), [], "pitch: no pitch in the file, allowed with --pitch-um"),
    "not a tiff": ("a.tif", data(b"hello world"), ["1"], "file: not a readable TIFF"),
    "text as tiff": ("a.tif", data(b"1 2\n3 4\n"), ["1"], "file: not a readable TIFF"),
    "all nan": ("a.tif", tiff(MAP * np.nan), ["1"], "heights: not one measured point"),
    "inf": ("a.tif", tiff(with_value(np.inf)), ["1"], "heights: 1 infinite heights, finite numbers or NaN"),
    "minus inf": ("a.tif", tiff(with_value(-np.inf)), ["1"], "heights: 1 infinite heights"),
    "one pixel": ("a.tif", tiff(MAP[:1, :1]), ["1"], "shape: height map of shape (1, 1), at least 2 x 2"),
    "one row": ("a.tif", tiff(MAP[:1]), ["1"], "shape: height map of shape (1, 20), at least 2 x 2"),
    "three channels": ("a.tif", tiff(np.zeros((9, 9, 3), np.uint8)), ["1"], "channels: picture of shape (9, 9, 3)"),
    "pitch 0": ("a.tif", tiff(MAP), ["0"], "--pitch-um: found 0, allowed: one or two positive numbers"),
    "pitch negative": ("a.tif", tiff(MAP), ["-1"], "--pitch-um: found -1, allowed"),
    "one pitch negative": ("a.tif", tiff(MAP), ["0.1", "-1"], "--pitch-um: found 0.1 -1, allowed"),
    "pitch nan": ("a.tif", tiff(MAP), ["nan"], "--pitch-um: found nan, allowed"),
    "pitch a word": ("a.tif", tiff(MAP), ["fine"], "--pitch-um: found fine, allowed: one or two numbers"),
    "three pitches": ("a.tif", tiff(MAP), ["1 2 3"], "--pitch-um: found 1 2 3, allowed"),
    "decimal comma": ("a.tif", tiff(MAP), ["1,5"], "found 1,5, a comma between digits, allowed: a decimal point"),
    "decimal comma below 1": ("a.tif", tiff(MAP), ["0,1"], "found 0,1, a comma between digits"),
    "letters": ("a.csv", data(b"1,2\n3,four\n"), ["1"], "numbers: found 'four' in line 2, column 2"),
    "ragged": ("a.csv", data(b"1,2\n3\n"), ["1"], "rows: line 2 has 1 values, line 1 has 2"),
    "empty tiff": ("a.tif", data(b""), ["1"], "file: is empty"),
    "empty text": ("a.txt", data(b""), ["1"], "file: is empty"),
    "blank text": ("a.txt", data(b"\n\n"), ["1"], "file: no numbers found"),
    "a folder": ("a.tif", lambda path: path.mkdir(), ["1"], "file: is a folder"),
    "nothing there": ("a.tif", lambda path: None, ["1"], "file: cannot read (No such file or directory)"),
    "not gzip": ("a.txt.gz", data(b"1 2\n3 4\n"), ["1"], "file: damaged gzip"),
    "cut gzip": ("a.txt.gz", data(gzip.compress(b"1 2\n3 4\n" * 9)[:-9]), ["1"], "file: damaged gzip"),
    "pickle": (
        "a.npy",
        npy(np.array([{}, {}], dtype=object)),
        ["1"],
        "file: not a readable .npy (Array can't be memory-mapped: Python objects",
    ),
    "complex": ("a.npy", npy(MAP * 1j), ["1"], "type: values of type complex64, allowed: integer or float"),
    "words": ("a.npy", npy(np.array([["a", "b"]])), ["1"], "type: values of type <U1"),
    "empty npy": ("a.npy", npy(np.zeros((0, 5))), ["1"], "shape: height map of shape (0, 5)"),
    "npy stack": ("a.npy", npy(np.zeros((2, 5, 5))), ["1"], "shape: height map of shape (2, 5, 5)"),
    "rgb png": ("a.png", lambda p: Image.new("RGB", (9, 9)).save(p), ["1"], "channels: picture of type RGB"),
    "no png": ("a.png", data(b"\x89PNG\r\n"), ["1"], "file: not a readable PNG"),
    "png without range": ("a.png", lambda p: Image.new("L", (9, 9)).save(p), ["1"], "range: grey levels without"),
    "no stl": ("a.stl", data(b"hello" * 50), ["1"], "file: not a whole STL, binary or ASCII STL"),
    "stl without pitch": ("a.stl", data(b"solid\nendsolid\n"), [], "pitch: an STL has no pixels, allowed with"),
    "empty stl": ("a.stl", data(b"solid\nendsolid\n"), ["1"], "triangles: no triangles"),
    "cut ascii stl": ("a.stl", data(b"solid\nvertex 1 2 3\n"), ["1"], "file: not a whole ASCII STL"),
    "no gsf": ("a.gsf", data(b"hello\0"), ["1"], "file: not a Gwyddion Simple Field"),
    "gsf without size": ("a.gsf", data(b"Gwyddion Simple Field 1.0\nXRes = 3\n\0\0"), ["1"], "YRes: found nothing"),
    "unknown ending": ("a.xyz", data(b"1"), ["1"], "format: cannot read .xyz, allowed: "),
    "no ending": ("a", data(b"1"), ["1"], "format: cannot read no ending, allowed: "),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_gives_one_line_and_no_output(tmp_path, case):
    name, make, pitch, expected = BAD[case]
    source, out = tmp_path / name, tmp_path / "out.tif"
    make(source)
    before = sorted(tmp_path.iterdir())
    options = ["--pitch-um", *pitch] if pitch else []
    result = CliRunner().invoke(app, ["convert", str(source), str(out), *options])
    assert result.exit_code == 1
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("error: ")
    assert expected in result.stderr
    assert "found fine" in expected or "a comma" in expected or str(source) in result.stderr
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("command", [["convert"], ["export-stl"]])
def test_outputs_are_checked_before_any_work(tmp_path, command):
    write_height_map(tmp_path / "a.tif", HeightMap(MAP + 1, 1, 1))
    for out, expected in [
        (tmp_path / "no" / "out.stl", "output: folder does not exist, create"),
        (tmp_path, "output: is a folder, give a file name"),
        (tmp_path / "there.stl", "output: exists already, allowed with --overwrite"),
    ]:
        (tmp_path / "there.stl").write_text("old")
        result = CliRunner().invoke(app, [*command, str(tmp_path / "a.tif"), "-o", str(out)])
        assert result.exit_code == 1
        assert result.stderr.startswith(f"error: {out}: {expected}")
        assert (tmp_path / "there.stl").read_text() == "old"
    arguments = [*command, str(tmp_path / "a.tif"), "-o", str(tmp_path / "there.stl"), "--overwrite"]
    assert CliRunner().invoke(app, arguments).exit_code == 0
    assert (tmp_path / "there.stl").stat().st_size > 1000
    for name in ("out.xyz", "out"):
        result = CliRunner().invoke(app, [*command, str(tmp_path / "a.tif"), "-o", str(tmp_path / name)])
        assert result.exit_code == 1
        assert f"{tmp_path / name}: format: " in result.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.tif", "there.stl", "there.stl.provenance.yaml"]


@pytest.mark.parametrize("ending", [ending for ending, this in formats().items() if this.read and this.write])
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_damaged_files_are_read_or_refused_but_never_crash(tmp_path_factory, ending, seed):
    """Up to five bytes changed, and half of the files cut."""
    rng = np.random.default_rng(seed)
    path = tmp_path_factory.mktemp("bad") / f"a{ending}"
    write_height_map(path, HeightMap(MAP[:6, :7] + 1, 0.5, 0.5))
    content = bytearray(path.read_bytes())
    for place in rng.integers(0, min(len(content), rng.choice([64, 10**6])), rng.integers(1, 6)):
        content[place] = rng.integers(256)
    path.write_bytes(content[: rng.integers(1, len(content))] if rng.random() < 0.5 else content)
    try:
        read_height_map(path, pitch_um=0.5)
    except InputError as error:
        assert str(path) in str(error)
        assert "\n" not in str(error)


def test_a_format_is_registered_once():
    names = [this.name for this in formats().values()]
    assert len(set(names)) == 11
    assert {".tif", ".npy", ".csv", ".txt.gz", ".png", ".stl", ".gsf"} <= formats().keys()


@pytest.mark.slow
@pytest.mark.parametrize("kept", [0.5, 0.999])
def test_a_cut_tiff_is_refused_in_one_line_by_a_program_of_its_own(tmp_path, kept):
    """In a process that has read nothing yet: the library's own words must not reach the user either."""
    path = tmp_path / "cut.tif"
    write_height_map(path, HeightMap(np.ones((90, 90)), 0.5, 0.5))
    path.write_bytes(path.read_bytes()[: int(kept * path.stat().st_size)])
    program = "from dlwpredict.cli import main; main()"
    command = [sys.executable, "-c", program, "predict", str(path), "-o", str(tmp_path / "out.tif")]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 1 and not (tmp_path / "out.tif").exists()
    assert ended.stderr.startswith(f"error: {path}: file: not a readable TIFF") and ended.stderr.count("\n") == 1

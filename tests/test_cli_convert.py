"""``convert`` through the whole program."""

import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from dlwpredict.cli import app
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.heightmap import HeightMap

RECORDINGS = Path(
    os.environ.get("DLWPREDICT_RECORDINGS", Path(__file__).resolve().parents[2] / "shared" / "recordings")
)


def run(*arguments):
    return CliRunner().invoke(app, ["convert", *map(str, arguments)])


@pytest.fixture
def part(tmp_path):
    heights = np.random.default_rng(1).random((60, 120)).astype(np.float32)
    heights[3, 4] = np.nan
    path = tmp_path / "part.tif"
    write_height_map(path, HeightMap(heights, 0.5, 0.25))
    return path


@pytest.mark.parametrize(
    "pitch", [["--pitch-um", "0.2"], ["--pitch-um", "0.2", "0.4"], ["--pitch-um", "0.2 0.4"], ["--pitch-um=0.2 0.4"]]
)
def test_one_pitch_or_two_wherever_the_option_stands(tmp_path, part, pitch):
    both = 0.4 if pitch != ["--pitch-um", "0.2"] else 0.2
    for k, arguments in enumerate(([*pitch, part, "OUT"], [part, *pitch, "OUT"], [part, "OUT", *pitch])):
        out = tmp_path / f"{k}.tif"
        result = run(*(out if word == "OUT" else word for word in arguments))
        assert result.exit_code == 0, result.output
        written = read_height_map(out)
        assert (written.dx_um, written.dy_um) == (0.2, both)


def test_the_import_is_described(tmp_path, part):
    result = run(part, "-o", tmp_path / "a.csv")
    assert result.exit_code == 0
    assert "120 x 60 px, pitch 0.5 x 0.25 µm, field 60 x 15 µm, z " in result.stdout
    assert "missing 0.0139 %" in result.stdout
    assert result.stderr == ""
    assert run(part, tmp_path / "b.csv", "--quiet").stdout == ""
    assert np.array_equal(
        read_height_map(tmp_path / "a.csv").heights_um, read_height_map(part).heights_um, equal_nan=True
    )


def test_what_looks_wrong_or_is_lost_is_said(tmp_path, part):
    result = run(part, tmp_path / "a.npy", "--z-scale", "1e-6", "--pitch-um", "1000", "0.1")
    assert result.exit_code == 0
    assert "warning: " + str(part) + ": field 1.2e+05 µm in x, usual 10 to 10000 µm" in result.stderr
    assert "field 6 µm in y" in result.stderr
    assert "usual 0.01 to 1000 µm: is the unit right (--z-scale)?" in result.stderr
    assert "holds no pitch, read it with --pitch-um 1000 0.1" in result.stderr


def test_range_of_grey_levels(tmp_path):
    levels = np.arange(80 * 70).reshape(80, 70) * 11
    source = tmp_path / "a.png"
    Image.fromarray(levels.astype(np.uint16)).save(source)
    out = tmp_path / "a.tif"
    assert (
        "range: grey levels without a height range, allowed with --z-range LO HI"
        in run(source, out, "--pitch-um", 1).stderr
    )
    assert run(source, out, "--z-range", "-1", "2.5", "--pitch-um", "1").exit_code == 0
    assert read_height_map(out).heights_um == pytest.approx(-1 + 3.5 * levels / 65535, abs=1e-6)
    back = tmp_path / "b.png"
    assert run(out, back, "--z-range", "-1", "2.5").exit_code == 0
    assert np.array_equal(np.asarray(Image.open(back)), levels)
    result = run(out, tmp_path / "c.png", "--z-range", "0", "2.5")
    assert result.exit_code == 1
    assert "c.png: --z-range: heights -1 to" in result.stderr
    assert not (tmp_path / "c.png").exists()


def test_a_png_needs_missing_points_filled(tmp_path, part):
    out = tmp_path / "a.png"
    result = run(part, out)
    assert (result.exit_code, out.exists()) == (1, False)
    assert "a.png: heights: 1 points not measured, a PNG has no NaN: use --fill" in result.stderr
    assert run(part, out, "--fill", "zero").exit_code == 0
    assert read_height_map(out).heights_um[3, 4] == 0


def test_usage_faults_exit_2(tmp_path, part):
    assert run(part).exit_code == 2
    assert run(part, tmp_path / "a.csv", "-o", tmp_path / "b.csv").exit_code == 2
    assert list(tmp_path.iterdir()) == [part]


@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="recordings not at hand")
def test_a_published_recording(tmp_path):
    """FOV12: raw AFM in µm without a pitch, design in levels of 0.1 µm up to 1.2 µm (README of the recordings)."""
    folder, out = RECORDINGS / "two_photon", tmp_path / "a.tif"
    result = run(folder / "FOV12_design_levels.tif", out)
    assert result.exit_code == 1
    assert "pitch: no pitch in the file" in result.stderr
    assert run(folder / "FOV12_design_levels.tif", out, "--pitch-um", "0.1", "--z-scale", "0.1").exit_code == 0
    design = read_height_map(out)
    assert design.size_um == pytest.approx((51.2, 51.2))
    assert np.unique(design.heights_um) == pytest.approx(np.arange(13) / 10)

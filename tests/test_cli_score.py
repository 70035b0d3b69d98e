"""``score`` through the whole program."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from dlwpredict.cli import app
from dlwpredict.designs import air, f
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.heightmap import HeightMap

CONTRACT_KEYS = {
    *("rmse_um", "rmse_offset_free_um", "cc", "mean_difference_um", "sa_um", "sq_um", "sz_um", "alpha_z", "l_z_um"),
    *("material_ratio_range", "valid_fraction", "points"),
}


def run(*arguments):
    return CliRunner().invoke(app, ["score", *map(str, arguments)])


@pytest.fixture
def pair(tmp_path):
    """A roughness structure, and the same 0.9 times as high, 0.2 µm lower, with a hole."""
    reference = air(pitch_um=0.5, margin_um=0)
    heights = 0.9 * reference.heights_um - 0.2
    heights[:10, :20] = np.nan
    paths = tmp_path / "target.tif", tmp_path / "print.tif"
    write_height_map(paths[0], reference)
    write_height_map(paths[1], reference.with_heights(heights))
    return paths


def test_the_json_holds_every_figure_of_the_contract(pair, tmp_path):
    assert run(*pair, "--json", tmp_path / "score.json").exit_code == 0
    found = json.loads((tmp_path / "score.json").read_text())
    x, y = (read_height_map(path).heights_um for path in pair)
    x, y = x[~np.isnan(y)], y[~np.isnan(y)]
    assert set(found) >= CONTRACT_KEYS
    assert found["rmse_um"] == pytest.approx(np.sqrt(np.mean((y - x) ** 2)))
    assert found["rmse_offset_free_um"] == pytest.approx(np.std(y - x))
    assert found["mean_difference_um"] == pytest.approx(np.mean(y - x))
    assert found["sa_um"] == pytest.approx(np.mean(abs(y - y.mean())))
    assert found["sq_um"] == pytest.approx(np.std(y))
    assert found["sz_um"] == pytest.approx(np.ptp(y))
    assert found["cc"] == pytest.approx(1, abs=1e-9)
    assert found["alpha_z"] == pytest.approx(0.9, abs=1e-6)
    assert found["l_z_um"] == pytest.approx(0, abs=1e-5)
    assert found["material_ratio_range"] == [0.05, 0.95]
    assert found["points"] == 200 * 200 - 200
    assert found["valid_fraction"] == pytest.approx(1 - 200 / 40000)


def test_the_figures_are_printed_without_any_file(pair):
    result = run(*pair)
    assert result.exit_code == 0
    for words in ("rmse", "offset-free", "CC", "Sa, Sq, Sz", "alpha_z, l_z 0.05-0.95", "0.9000", "39800", "99.5 %"):
        assert words in result.stdout


def test_another_range_is_printed_and_kept(pair, tmp_path):
    result = run(*pair, "--material-ratio", 0.1, 0.8, "-o", tmp_path / "score.json")
    assert "alpha_z, l_z 0.1-0.8" in result.stdout
    assert json.loads((tmp_path / "score.json").read_text())["material_ratio_range"] == [0.1, 0.8]


def test_a_flat_map_gives_null_not_nan(tmp_path):
    for name in "ab":
        write_height_map(tmp_path / f"{name}.tif", HeightMap(np.ones((5, 5)), 1, 1))
    result = run(tmp_path / "a.tif", tmp_path / "b.tif", "--json", tmp_path / "score.json")
    assert result.exit_code == 0
    assert "undefined" in result.stdout
    text = (tmp_path / "score.json").read_text()
    assert json.loads(text)["cc"] is None
    assert "NaN" not in text


def test_substrate_is_told_and_can_be_left_out(tmp_path):
    path = tmp_path / "f.tif"
    write_height_map(path, f(pitch_um=0.5))
    assert "bare substrate" in run(path, path).stdout
    assert "100 % of the part" in run(path, path, "--part-only").stdout


@pytest.mark.slow
def test_the_picture_is_drawn(pair, tmp_path):
    picture = tmp_path / "score.png"
    assert run(*pair, "--plot", picture).exit_code == 0
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_wall_out_of_place_spoils_the_whole_map_and_nothing_away_from_walls(tmp_path):
    """The print stands one pixel to the left and is 0.1 µm low; the map ends within the part."""
    target = HeightMap(np.repeat([[0.0] * 20 + [5.0] * 40], 60, axis=0), 0.2, 0.2)
    heights = np.roll(target.heights_um, -1, axis=1) - 0.1
    heights[:, -1] = 0  # the rim of a map that was cut out of a larger part
    for name, one in (("target", target), ("print", target.with_heights(heights))):
        write_height_map(tmp_path / f"{name}.tif", one)
    words = [tmp_path / "target.tif", tmp_path / "print.tif", "--json", tmp_path / "score.json"]
    done = run(*words)
    found = json.loads((tmp_path / "score.json").read_text())
    away = found["away_from_walls"]
    off = heights - target.heights_um
    assert found["rmse_um"] == pytest.approx(np.sqrt(np.mean(off**2)), rel=1e-6)
    assert found["rmse_um"] > 0.8
    assert away["rmse_um"] == pytest.approx(0.1, rel=1e-5)
    assert away["rmse_offset_free_um"] == pytest.approx(0, abs=1e-5)
    assert (away["wall_px"], away["points"]) == (3, (60 - 2 * 3) * (14 + 34))
    assert "away from walls and rim (3 px): rmse 0.1000 µm, offset-free 0.0000 µm, CC 1.0000" in done.stdout
    assert run(*words, "--wall-px", 0, "--overwrite").stdout.count("walls") == 0
    assert "away_from_walls" not in json.loads((tmp_path / "score.json").read_text())
    far = run(*words, "--wall-px", 40, "--overwrite")
    assert far.exit_code == 0 and "no point lies 40 px from them" in far.stdout
    assert json.loads((tmp_path / "score.json").read_text())["away_from_walls"]["rmse_um"] is None


def test_relative_heights_are_told(pair, tmp_path):
    relative = HeightMap(read_height_map(pair[1]).heights_um, 0.5, 0.5, height_reference="relative")
    write_height_map(tmp_path / "relative.tif", relative)
    assert "heights are relative" in run(pair[0], tmp_path / "relative.tif").stderr


def test_bad_input_is_refused_in_one_line_and_leaves_nothing(pair, tmp_path):
    other = tmp_path / "other.tif"
    write_height_map(other, HeightMap(np.ones((5, 5)), 1, 1))
    before = sorted(tmp_path.iterdir())
    json_file = ["--json", tmp_path / "score.json"]
    for arguments, words in [
        ([pair[0], other, *json_file], f"error: {other}: grid: "),
        ([pair[0], tmp_path / "absent.tif", *json_file], "absent.tif"),
        ([*pair, "--material-ratio", 0.9, 0.1, *json_file], "material_ratio_range: found 0.9 0.1"),
        ([*pair, "--plot", tmp_path / "score.gif", *json_file], "--plot: ends in .gif"),
        ([*pair, "--json", tmp_path / "nowhere" / "score.json"], "folder does not exist"),
        ([*pair, "--json", pair[0]], "is read by this command"),
    ]:
        result = run(*arguments)
        assert result.exit_code == 1
        assert words in result.stderr
        assert result.stderr.count("\n") == 1
        assert sorted(tmp_path.iterdir()) == before

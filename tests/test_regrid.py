"""Maps cut, smoothed and resampled by hand: means over area, of what was measured."""

import numpy as np
import pytest
from typer.testing import CliRunner

from dlwpredict.cli import app
from dlwpredict.errors import InputError
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.heightmap import HeightMap
from dlwpredict.metrology.regrid import cropped, resampled, smoothed, widened

RNG = np.random.default_rng(0)


@pytest.mark.parametrize(("pitch", "off"), [(0.5, 0.03), (0.73, 0.03), (1.0, 0.03), (2.0, 1e-9)])
def test_resampling_keeps_a_plane(pitch, off):
    """To a share of a step of the map, which is flat within a pixel; exactly where its pixels are filled whole."""
    grid = HeightMap(np.zeros((40, 60)), 0.5, 0.4)
    plane = grid.with_heights(3 + 0.2 * grid.x_um - 0.1 * grid.y_um[:, None])
    found = resampled(plane, pitch)
    error = found.heights_um - (3 + 0.2 * found.x_um - 0.1 * found.y_um[:, None])
    assert np.abs(error).max() < off and abs(error.mean()) < 1e-9


def test_resampling_keeps_the_volume():
    noise = HeightMap(RNG.random((40, 60)), 0.5, 0.4)
    found = resampled(noise, 2.0)
    assert found.size_um == noise.size_um
    assert found.heights_um.mean() == pytest.approx(noise.heights_um.mean())


def test_resampling_by_a_whole_factor_is_the_mean_of_blocks():
    part = HeightMap(RNG.random((12, 18)), 0.1, 0.1)
    blocks = part.heights_um.reshape(4, 3, 6, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(resampled(part, 0.3).heights_um, blocks)


def test_what_was_not_measured_has_no_say_and_half_a_pixel_must_have_been():
    heights = np.ones((8, 8))
    heights[:4, :2], heights[4:6, 4:6], heights[4, 4] = np.nan, np.nan, 5.0
    found = resampled(HeightMap(heights, 1.0, 1.0), 2.0).heights_um
    assert np.isnan(found[:2, 0]).all() and np.isnan(found[2, 2])
    assert np.nanmax(found) == 1.0
    soft = smoothed(HeightMap(heights, 1.0, 1.0), 1.0).heights_um
    assert (np.isnan(soft) == np.isnan(heights)).all() and soft[0, 3] == pytest.approx(1.0, abs=1e-3)


def test_smoothing_spreads_a_point_to_the_width_that_is_said():
    point = np.zeros((61, 61))
    point[30, 30] = 1.0
    soft = smoothed(HeightMap(point, 0.1, 0.2), 1.6).heights_um
    assert soft.sum() == pytest.approx(1, abs=1e-3)
    assert soft[30, 38] / soft[30, 30] == pytest.approx(0.5, abs=0.01)
    assert soft[34, 30] / soft[30, 30] == pytest.approx(0.5, abs=0.01)


def test_a_cut_is_in_the_frame_of_the_map():
    part = HeightMap(np.add.outer(10 * np.arange(6), np.arange(8)), 0.5, 0.5, filled=np.eye(6, 8) > 0)
    found = cropped(part, (0.0, 2.0), (-1.5, 0.0))
    assert found.heights_um.tolist() == part.heights_um[3:, 4:].tolist()
    assert found.filled.tolist() == part.filled[3:, 4:].tolist()


def test_a_margin_is_bare_and_the_map_stays_in_the_middle():
    part = HeightMap(RNG.random((4, 6)), 0.5, 1.0, filled=np.ones((4, 6), dtype=bool))
    found = widened(part, 1.2)
    assert found.shape == (8, 12)
    assert (found.heights_um[2:-2, 3:-3] == part.heights_um).all() and found.filled.sum() == 24
    assert np.count_nonzero(found.heights_um) == part.heights_um.size
    again = cropped(found, (-1.5, 1.5), (-2.0, 2.0))
    assert (again.heights_um == part.heights_um).all()


@pytest.mark.parametrize(
    ("does", "key"),
    [
        (lambda part: resampled(part, 0.4), "--resample-um"),
        (lambda part: resampled(part, 4.0), "--resample-um"),
        (lambda part: resampled(part, np.nan), "--resample-um"),
        (lambda part: cropped(part, (9, 10), (0, 1)), "--crop"),
        (lambda part: smoothed(part, -1.0), "--smooth-um"),
        (lambda part: smoothed(part, np.nan), "--smooth-um"),
        (lambda part: widened(part, 0.0), "--margin-um"),
        (lambda part: widened(part, 1e9), "--margin-um"),
    ],
)
def test_what_cannot_be_is_refused(does, key):
    with pytest.raises(InputError, match=key):
        does(HeightMap(np.ones((6, 8)), 0.5, 0.5))


def test_convert_cuts_smooths_and_resamples(tmp_path):
    part = HeightMap(RNG.random((40, 60)), 0.1, 0.1)
    write_height_map(tmp_path / "in.tif", part)
    words = [
        "convert",
        "in.tif",
        "out.tif",
        "--crop",
        "-2",
        "-1",
        "2",
        "1",
        "--smooth-um",
        "0.2",
        "--resample-um",
        "0.4",
    ]
    words = [str(tmp_path / word) if word.endswith(".tif") else word for word in words]
    ended = CliRunner().invoke(app, words)
    assert ended.exit_code == 0, ended.output
    found = read_height_map(tmp_path / "out.tif")
    wanted = resampled(smoothed(cropped(read_height_map(tmp_path / "in.tif"), (-2, 2), (-1, 1)), 0.2), 0.4)
    assert (found.shape, found.dx_um) == ((5, 10), 0.4)
    np.testing.assert_allclose(found.heights_um, wanted.heights_um, atol=1e-6)
    ended = CliRunner().invoke(app, [words[0], words[1], str(tmp_path / "no.tif"), "--resample-um", "0.01"])
    assert ended.exit_code == 1 and "--resample-um" in ended.stderr and not (tmp_path / "no.tif").exists()

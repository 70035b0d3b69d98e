"""TIFF: what ImageJ and other programs write, and what they see of ours."""

import numpy as np
import pytest
import tifffile

from dlwpredict.errors import InputError
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.heightmap import HeightMap

LEVELS = np.arange(12, dtype=np.uint8).reshape(3, 4)


def written(path, values=LEVELS, **options):
    tifffile.imwrite(path, values, **options)
    return path


@pytest.mark.parametrize(
    ("unit", "um"), [("um", 1), ("micron", 1), ("\\u00B5m", 1), ("nm", 1e-3), ("mm", 1e3), ("inch", 25400)]
)
def test_pitch_from_imagej_tags(tmp_path, unit, um):
    path = written(tmp_path / "a.tif", LEVELS, imagej=True, resolution=(4, 2), metadata={"unit": unit})
    part = read_height_map(path)
    assert (part.dx_um, part.dy_um) == pytest.approx((um / 4, um / 2))


@pytest.mark.parametrize(("unit", "um"), [("CENTIMETER", 1e4), ("INCH", 25400)])
def test_pitch_from_resolution_unit(tmp_path, unit, um):
    path = written(tmp_path / "a.tif", resolution=(1e5, 5e4), resolutionunit=unit)
    part = read_height_map(path)
    assert (part.dx_um, part.dy_um) == pytest.approx((um / 1e5, um / 5e4))


@pytest.mark.parametrize(
    "options", [{}, {"resolution": (1, 1), "resolutionunit": 1}, {"imagej": True, "metadata": {"unit": "pixel"}}]
)
def test_no_unit_is_no_pitch(tmp_path, options):
    path = written(tmp_path / "a.tif", **options)
    with pytest.raises(InputError, match=r"a\.tif: pitch: no pitch in the file, allowed with --pitch-um"):
        read_height_map(path)
    assert read_height_map(path, pitch_um=0.1).size_um == pytest.approx((0.4, 0.3))


def test_description_wins_over_tags_and_the_user_over_both(tmp_path):
    lines = {"unit": "um", "pitch_x_um": "0.123456789012345", "pitch_y_um": "0.5"}
    path = written(tmp_path / "a.tif", imagej=True, resolution=(4, 2), metadata=lines)
    assert read_height_map(path).dx_um == 0.123456789012345
    assert read_height_map(path, pitch_um=(2, 3)).dy_um == 3


@pytest.mark.parametrize(("unit", "um"), [("nm", 1e-3), ("m", 1e6), ("um", 1)])
def test_heights_in_another_unit_are_converted(tmp_path, unit, um):
    path = written(tmp_path / "a.tif", imagej=True, metadata={"unit": "um", "z_unit": unit}, resolution=(1, 1))
    assert read_height_map(path).heights_um.max() == pytest.approx(11 * um)
    assert read_height_map(path, z_scale=0.1).heights_um.max() == pytest.approx(1.1)


def test_an_unknown_unit_of_heights_needs_a_scale(tmp_path):
    path = written(tmp_path / "a.tif", imagej=True, metadata={"unit": "um", "z_unit": "counts"}, resolution=(1, 1))
    with pytest.raises(InputError, match=r"z_unit: found 'counts', allowed: m, .*um"):
        read_height_map(path)
    assert read_height_map(path, z_scale=2).heights_um.max() == 22


def test_other_programs_see_one_plain_picture(tmp_path):
    heights = np.array([[0.0, np.nan, 2.5], [1.0, 0.5, 3.0]])
    write_height_map(tmp_path / "a.tif", HeightMap(heights, 0.1, 0.25, filled=heights > 2))
    seen = tifffile.imread(tmp_path / "a.tif")
    assert seen.dtype == np.float32
    assert np.array_equal(seen, heights, equal_nan=True)
    with tifffile.TiffFile(tmp_path / "a.tif") as file:
        assert file.is_imagej
        assert file.imagej_metadata["unit"] == "um"
        lines = file.pages.first.description.splitlines()
        assert {"z_unit=um", "pitch_x_um=0.1", "pitch_y_um=0.25", "filled_points=2"} <= set(lines)
        x, y = (file.pages.first.tags[name].value for name in ("XResolution", "YResolution"))
        assert (x[0] / x[1], y[0] / y[1]) == pytest.approx((10, 4))
        assert "DateTime" not in file.pages.first.tags


def test_lzw_is_read_without_further_packages(tmp_path):
    from PIL import Image

    Image.fromarray(LEVELS).save(tmp_path / "a.tif", compression="tiff_lzw")
    assert np.array_equal(read_height_map(tmp_path / "a.tif", pitch_um=1).heights_um, LEVELS)


@pytest.mark.parametrize(
    ("values", "options", "match"),
    [
        (np.zeros((4, 5, 3), np.uint8), {"photometric": "rgb"}, "channels: picture of shape"),
        (np.zeros((3, 4, 5), np.float32), {"photometric": "minisblack"}, "channels: picture of shape"),
        (np.zeros((3, 4, 5), np.float32), {"imagej": True}, "channels: picture of shape"),
        (np.zeros((4, 5), np.complex64), {}, "type: values of type complex64"),
        (LEVELS, {"extratags": [(274, 3, 1, 4, True)]}, "orientation: orientation 4"),
        (LEVELS, {"description": "pitch_x_um=-1\npitch_y_um=1"}, "pitch_x_um: found -1"),
        (LEVELS, {"description": "pitch_x_um=1"}, "pitch_y_um: missing"),
        (LEVELS, {"description": "height_reference=sea"}, "height_reference: found sea, allowed: substrate, relative"),
        (LEVELS, {"extratags": [(65001, 7, 3, b"abc", True)]}, "filled: damaged mask"),
    ],
)
def test_what_is_no_height_map_is_refused_by_name(tmp_path, values, options, match):
    path = written(tmp_path / "a.tif", values, **options)
    with pytest.raises(InputError, match=match):
        read_height_map(path, pitch_um=1)


def test_no_cut_off_file_is_taken_for_whole(tmp_path):
    path = tmp_path / "a.tif"
    write_height_map(path, HeightMap(np.random.default_rng(0).random((20, 20)), 1, 1))
    content = path.read_bytes()
    for length in range(1, len(content), 37):
        path.write_bytes(content[:length])
        with pytest.raises(InputError, match=r"a\.tif: file: not a readable TIFF"):
            read_height_map(path)


@pytest.mark.parametrize(
    ("heights", "pitch", "match"),
    [(1.0, 1e-12, "pitch: found 1e-12, 1, allowed 1e-9 to 1e9"), (1e39, 1.0, "heights: heights beyond float32")],
)
def test_what_a_tiff_cannot_hold_is_not_written(tmp_path, heights, pitch, match):
    with pytest.raises(InputError, match=rf"a\.tif: {match}"):
        write_height_map(tmp_path / "a.tif", HeightMap(np.full((2, 2), heights), pitch, 1.0))
    assert list(tmp_path.iterdir()) == []

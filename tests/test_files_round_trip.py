"""Every format that is written reads back: an F is not mirrored, random maps survive, equal maps give equal bytes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.formats import formats
from dlwpredict.heightmap import HeightMap

DX, DY = 0.1, 0.3
WRITTEN = [ending for ending, this in formats().items() if this.write]
RESOLUTION = {
    ".png": 3.0 / 65535,
    ".gsf": 1e-6,
    ".x3p": 1e-6,
    ".tif": 0,
    ".tiff": 0,
    ".stl": 0,
}  # of heights up to 3 µm


def letter_f():
    """An F, 12 rows x 9 columns, of three heights so that no flip or turn maps it onto itself."""
    heights = np.zeros((12, 9))
    heights[1:11, 2:4] = 1.0
    heights[1:3, 2:8] = 2.0
    heights[5:7, 2:6] = 3.0
    return HeightMap(heights, DX, DY)


def numbers(low, high):
    return st.floats(low, high, width=32, allow_subnormal=False)


def maps(low=-1e3, high=1e3, missing=True):
    values = st.one_of(numbers(low, high), st.just(np.nan)) if missing else numbers(low, high)
    heights = arrays(float, array_shapes(min_dims=2, max_dims=2, min_side=2, max_side=9), elements=values)
    pitch = st.floats(1e-3, 1e3)
    reference = st.sampled_from(["substrate", "relative"])
    return st.builds(HeightMap, heights, pitch, pitch, reference).filter(lambda m: m.missing_fraction < 1)


def there_and_back(folder, ending, height_map, **options):
    path = folder / f"map{ending}"
    write_height_map(path, height_map)
    return read_height_map(path, **options)


@pytest.mark.parametrize("ending", WRITTEN)
def test_an_f_comes_back_upright_and_with_its_pitch(tmp_path, ending):
    part = letter_f()
    pitch = (DX, DY) if ending in (".npy", ".stl") else None
    back = there_and_back(tmp_path, ending, part, pitch_um=pitch)
    expected = part.heights_um
    if ending == ".stl":  # knows the part only, not the margin
        expected = expected[1:11, 2:8]
    assert back.heights_um == pytest.approx(expected, abs=RESOLUTION.get(ending, 0))
    assert (back.dx_um, back.dy_um) == pytest.approx((DX, DY), rel=1e-12)


@pytest.mark.parametrize("ending", WRITTEN)
def test_equal_maps_give_equal_bytes(tmp_path, ending):
    first, second = (tmp_path / f"{name}{ending}" for name in ("one", "two"))
    for path in (first, second):
        write_height_map(path, letter_f())
    assert first.read_bytes() == second.read_bytes()
    assert sorted(tmp_path.iterdir()) == [first, second]


@pytest.mark.slow
@given(part=maps())
@settings(max_examples=60, deadline=None)
def test_tiff_and_text_keep_everything(tmp_path_factory, part):
    folder = tmp_path_factory.mktemp("maps")
    for ending in (".tif", ".csv", ".txt.gz"):
        back = there_and_back(folder, ending, part)
        assert np.array_equal(back.heights_um, part.heights_um, equal_nan=True)
        assert (back.dx_um, back.dy_um, back.height_reference) == (part.dx_um, part.dy_um, part.height_reference)


@pytest.mark.slow
@given(part=maps())
@settings(max_examples=40, deadline=None)
def test_gsf_x3p_and_npy_keep_heights_and_missing_points(tmp_path_factory, part):
    folder = tmp_path_factory.mktemp("maps")
    for ending in (".gsf", ".x3p"):
        back = there_and_back(folder, ending, part)
        assert back.heights_um == pytest.approx(part.heights_um, rel=2e-7, abs=1e-30, nan_ok=True)
        assert back.same_grid(part)
        assert back.height_reference == part.height_reference
    back = there_and_back(folder, ".npy", part, pitch_um=(part.dx_um, part.dy_um))
    assert np.array_equal(back.heights_um, part.heights_um, equal_nan=True)


@given(part=maps(missing=False))
@settings(max_examples=40, deadline=None)
def test_png_keeps_heights_to_half_a_level(tmp_path_factory, part):
    back = there_and_back(tmp_path_factory.mktemp("maps"), ".png", part)
    level = np.ptp(part.heights_um) / 65535
    assert np.abs(back.heights_um - part.heights_um).max() <= 0.5 * level + 1e-9
    assert (back.dx_um, back.dy_um, back.height_reference) == (part.dx_um, part.dy_um, part.height_reference)


@given(part=maps(low=0.5, high=50, missing=False))
@settings(max_examples=30, deadline=None)
def test_a_slab_survives_stl(tmp_path_factory, part):
    back = there_and_back(tmp_path_factory.mktemp("maps"), ".stl", part, pitch_um=(part.dx_um, part.dy_um))
    steepest = np.ptp(part.heights_um)
    assert back.shape == part.shape
    assert back.heights_um == pytest.approx(part.heights_um, rel=1e-6, abs=1e-5 * steepest)


@given(data=st.data())
@settings(max_examples=30, deadline=None)
def test_the_mask_of_filled_points_survives_in_tiff_only(tmp_path_factory, data):
    part = data.draw(maps(missing=False))
    filled = data.draw(arrays(bool, part.shape))
    marked = HeightMap(part.heights_um, part.dx_um, part.dy_um, filled=filled)
    folder = tmp_path_factory.mktemp("maps")
    back = there_and_back(folder, ".tif", marked)
    assert np.array_equal(back.measured, ~filled)
    remarks = write_height_map(folder / "map.csv", marked)
    assert bool(remarks) == filled.any()


def test_a_gsf_that_names_no_units_is_in_metres(tmp_path):
    """So says the format's specification; Gwyddion writes it so where units are metres."""
    head = b"Gwyddion Simple Field 1.0\nXRes = 3\nYRes = 2\nXReal = 6e-6\nYReal = 1e-6\n"
    heights = np.arange(6, dtype="<f4") * np.float32(1e-6)
    (tmp_path / "a.gsf").write_bytes(head + b"\0" * (4 - len(head) % 4) + heights.tobytes())
    found = read_height_map(tmp_path / "a.gsf")
    assert (found.dx_um, found.dy_um) == pytest.approx((2.0, 0.5))
    np.testing.assert_allclose(found.heights_um, np.arange(6).reshape(2, 3), rtol=1e-6)


def test_a_png_of_gwyddion_has_the_pitch_of_its_size(tmp_path):
    """Size in metres over pixels: 3 columns over 6 µm, 2 rows over 1 µm; levels from ZMin to ZMax."""
    info = PngInfo()
    for key, value in {"XReal": "6e-6", "YReal": "1e-6", "ZMin": "1e-6", "ZMax": "3e-6"}.items():
        info.add_text(f"Gwy::{key}", value)
    levels = np.array([[0, 65535, 0], [0, 0, 65535]], dtype=np.uint16)
    Image.fromarray(levels).save(tmp_path / "a.png", pnginfo=info)
    found = read_height_map(tmp_path / "a.png")
    assert (found.dx_um, found.dy_um) == pytest.approx((2.0, 0.5))
    np.testing.assert_allclose(found.heights_um, [[1, 3, 1], [1, 1, 3]])

"""Delimited text: what microscopes, spreadsheets and scripts export."""

import gzip
import os
import time
from pathlib import Path

import numpy as np
import pytest

from dlwpredict.errors import InputError
from dlwpredict.files import read_height_map

RECORDINGS = Path(
    os.environ.get("DLWPREDICT_RECORDINGS", Path(__file__).resolve().parents[2] / "shared" / "recordings")
)
EXPECTED = [[1.5, 2, 3], [4, 5, 6.25]]


def read(folder, content, name="a.txt", **options):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_height_map(path, **({"pitch_um": 1} | options))


@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("delimiter", ["\t", ",", ";", " ", "   ", ", ", " ;"])
def test_delimiter_and_line_ends_are_recognised(tmp_path, delimiter, ending):
    text = ending.join(delimiter.join(map(str, row)) for row in EXPECTED) + ending
    assert read(tmp_path, text).heights_um.tolist() == EXPECTED


@pytest.mark.parametrize("delimiter", ["\t", ";", " "])
def test_decimal_commas(tmp_path, delimiter):
    text = "\n".join(delimiter.join(map(str, row)) for row in EXPECTED).replace(".", ",")
    assert read(tmp_path, text).heights_um.tolist() == EXPECTED


@pytest.mark.parametrize("word", ["nan", "NaN", "", "BAD", "bad", "***", "*****"])
def test_not_measured(tmp_path, word):
    part = read(tmp_path, f"1,{word},3\n4,5,6\n")
    assert np.array_equal(part.heights_um, [[1, np.nan, 3], [4, 5, 6]], equal_nan=True)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "latin-1"])
def test_byte_order_marks_and_comments(tmp_path, encoding):
    text = "# heights in µm\n# more: 7\n\n1\t2\n3\t4\n\n"
    assert read(tmp_path, text.encode(encoding)).heights_um.tolist() == [[1, 2], [3, 4]]


def test_gzip_and_other_endings(tmp_path):
    for name in ("a.asc", "a.dat", "A.CSV"):
        assert read(tmp_path, "1 2\n3 4\n", name).heights_um.sum() == 10
    assert read(tmp_path, gzip.compress(b"1 2\n3 4\n"), "a.dat.gz").heights_um.sum() == 10


@pytest.mark.parametrize("corner", ["", "0", "y\\x"])
def test_axes_around_the_heights_give_the_pitch(tmp_path, corner):
    """NanoFocus µSurf: first row x, first column y, last column empty; row order is kept."""
    heights = np.random.default_rng(0).random((5, 4)).round(6)
    lines = ["\t".join([corner, *(f"{0.3125 * k:.4f}" for k in range(1, 5)), ""])]
    lines += ["\t".join([f"{0.5 * k:.4f}", *map(str, row), ""]) for k, row in enumerate(heights)]
    part = read(tmp_path, "\r\n".join(lines), pitch_um=None)
    assert np.array_equal(part.heights_um, heights)
    assert (part.dx_um, part.dy_um) == pytest.approx((0.3125, 0.5))


def test_a_tilted_plane_has_no_axes(tmp_path):
    plane = np.add.outer(0.5 * np.arange(6), 0.25 * np.arange(7))
    assert read(tmp_path, "\n".join(" ".join(map(str, row)) for row in plane)).shape == (6, 7)


def test_a_mirrored_x_axis_is_refused(tmp_path):
    rng = np.random.default_rng(0)
    lines = ["0 4 3 2 1"] + [f"{k} " + " ".join(map(str, rng.random(4))) for k in range(4)]
    with pytest.raises(InputError, match=r"x: x falls from left to right"):
        read(tmp_path, "\n".join(lines))


def test_header_of_gwyddion_text(tmp_path):
    text = "# Channel: Height\n# Width: 6.0 µm\n# Height: 400 nm\n# Value units: m\n1e-6\t2e-6\t3e-6\n0\t0\t0\n"
    part = read(tmp_path, text, pitch_um=None)
    assert (part.dx_um, part.dy_um, part.heights_um.max()) == pytest.approx((2, 0.2, 3))


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("1 2\n3 4 5\n", r"rows: line 2 has 3 values, line 1 has 2, the same number"),
        ("# c\n1,2\n\n3\n", r"rows: line 4 has 1 values, line 2 has 2"),
        ("1,2\n3,abc\n", r"numbers: found 'abc' in line 2, column 2"),
        ("x,y\n3,4\n", r"numbers: found 'x' in line 1, column 1|found 'y' in line 1, column 2"),
        ("oops,2\n3,4\n", r"numbers: found 'oops' in line 1, column 1"),
        ("# nothing\n\n", r"file: no numbers found"),
        ("1 2 3\n", r"shape: height map of shape \(1, 3\)"),
        ("1\n2\n", r"shape: height map of shape \(2, 1\)"),
        ("1 inf\n2 3\n", r"heights: 1 infinite heights"),
        ("nan nan\nnan nan\n", r"heights: not one measured point"),
        (b"\x00\x01\x02\x03", r"file: not a text file"),
        ("# pitch_x_um=0\n# pitch_y_um=1\n1 2\n3 4\n", r"pitch_x_um: found 0, allowed"),
        ("# Width: 5 apples\n# Height: 5 m\n1 2\n3 4\n", r"Width: found 5 apples"),
    ],
)
def test_faults_are_named(tmp_path, text, match):
    with pytest.raises(InputError, match=match) as caught:
        read(tmp_path, text)
    assert str(caught.value).startswith(str(tmp_path / "a.txt"))


@pytest.mark.slow
def test_large_texts_are_read_in_seconds(tmp_path):
    heights = np.random.default_rng(0).random((2000, 2000))
    text = "\n".join("\t".join(f"{value:.5e}" for value in row) for row in heights.tolist())
    path = tmp_path / "large.txt"
    path.write_text(text)
    start = time.process_time()
    part = read_height_map(path, pitch_um=0.1)
    assert time.process_time() - start < 10
    assert np.allclose(part.heights_um, heights, rtol=1e-5, atol=0)


@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="recordings not at hand")
def test_published_afm_text():
    """README of the recordings: metres, 540 x 540, nothing missing, lowest pixel 0, ranges 0.74 to 1.14 µm."""
    part = read_height_map(RECORDINGS / "two_photon" / "FOV11_afm.txt", pitch_um=0.1, z_scale=1e6)
    assert part.shape == (540, 540)
    assert part.missing_fraction == 0
    assert part.heights_um.min() == 0
    assert 0.74 <= part.heights_um.max() <= 1.14
    assert part.heights_um[0, 0] == pytest.approx(0.55864)


def test_a_list_of_points_is_no_map(tmp_path):
    places = [(x, y, np.sin(x + y)) for y in range(20) for x in range(30)]
    np.savetxt(tmp_path / "xyz.txt", places)
    with pytest.raises(InputError, match="600 lines of x, y and z, a matrix of heights"):
        read_height_map(tmp_path / "xyz.txt", pitch_um=0.3)
    np.savetxt(tmp_path / "narrow.txt", np.random.default_rng(0).normal(size=(600, 3)))
    assert read_height_map(tmp_path / "narrow.txt", pitch_um=0.3).shape == (600, 3)

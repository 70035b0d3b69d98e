"""Instrument files: read as they were made, refused in one line, and the real recordings as their README has them."""

import importlib.util
import os
import struct
import subprocess
import sys
import tracemalloc
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter
from typer.testing import CliRunner

from dlwpredict.cli import app
from dlwpredict.errors import InputError
from dlwpredict.files import instruments, read_height_map, write_height_map, x3p
from dlwpredict.files.formats import formats
from dlwpredict.heightmap import HeightMap, Instrument
from tests import instrument_files as make

RECORDINGS = Path(
    os.environ.get("DLWPREDICT_RECORDINGS", Path(__file__).resolve().parents[2] / "shared" / "recordings")
)
needs_extra = pytest.mark.skipif(
    importlib.util.find_spec("SurfaceTopography") is None, reason="extra `instruments` not installed"
)
F = make.letter_f()
LEVELS = np.rint(F * 1000).astype(int)
FILES = {
    "a.nms": make.nms(LEVELS, np.full(F.shape, 255)),
    "plain.nms": make.nms(LEVELS),
    "text.sdf": make.ascii_sdf(F),
    "bcr.sdf": make.ascii_sdf(F, magic="aBCR-1.0"),
    "binary.sdf": make.binary_sdf(F),
    "a.gwy": make.gwy([("Height", make.gwy_field(F * 1e-6))]),
    "nm.gwy": make.gwy([("Height", make.gwy_field(F * 1e3, unit="nm", size_m=(0.9, 3.6), xy_unit="µm"))]),
    "float.x3p": make.x3p(make.main_xml(F.shape), [("bindata/data.bin", (F * 1e-6).astype("<f4").tobytes())]),
    "amended.x3p": make.x3p(
        make.main_xml(F.shape, revision="ISO25178-72:2017/DAM1", kind="L", step=1e-9),
        [("bindata/data.bin", LEVELS.astype("<i4").tobytes())],
    ),
}


def write(folder, name, content):
    path = folder / name
    path.write_bytes(content)
    return path


def read(folder, name, content, **options):
    return read_height_map(write(folder, name, content), **options)


def convert(*arguments):
    return CliRunner().invoke(app, ["convert", *map(str, arguments)])


def one_line(result):
    assert result.exit_code == 1
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    return result.stderr


@pytest.mark.parametrize("name", FILES)
def test_an_f_is_read_upright_in_um_with_its_pitch(tmp_path, name):
    part = read(tmp_path, name, FILES[name])
    assert part.heights_um == pytest.approx(F, abs=1e-6)
    assert (part.dx_um, part.dy_um) == pytest.approx((0.1, 0.3), rel=1e-12)


@pytest.mark.parametrize("ending", [ending for ending, this in formats().items() if this.write])
@pytest.mark.parametrize("name", FILES)
def test_every_instrument_file_converts_to_every_format(tmp_path, name, ending):
    source, target = write(tmp_path, name, FILES[name]), tmp_path / f"out{ending}"
    result = convert(source, target)
    assert result.exit_code == 0, result.output
    pitch = (0.1, 0.3) if ending in (".npy", ".stl") else None
    back = read_height_map(target, pitch_um=pitch)
    expected = F[1:11, 2:8] if ending == ".stl" else F
    assert back.heights_um == pytest.approx(expected, abs=5e-5)
    assert (back.dx_um, back.dy_um) == pytest.approx((0.1, 0.3), rel=1e-9)


# -- not measured ------------------------------------------------------------------------------
HOLES = {(0, 0), (5, 3), (11, 8)}


def with_holes():
    heights = F.copy()
    for place in HOLES:
        heights[place] = np.nan
    return heights


def intensity():
    picture = np.full(F.shape, 7)
    for place in HOLES:
        picture[place] = 0
    return picture


def valid_bits():
    return np.packbits(~np.isnan(with_holes()).ravel(), bitorder="little").tobytes()


MISSING = {
    "a.nms": make.nms(LEVELS, intensity()),
    "text.sdf": make.ascii_sdf(F, missing=HOLES),
    "binary.sdf": make.binary_sdf(F, missing=HOLES),
    "bcr.sdf": make.ascii_sdf(F, magic="aBCR-1.0", missing=HOLES, bad=2**31 - 1),
    "mask.gwy": make.gwy([("Height", make.gwy_field(F * 1e-6))], [(0, np.isnan(with_holes()).astype(float))]),
    "nan.gwy": make.gwy([("Height", make.gwy_field(with_holes() * 1e-6))]),
    "float.x3p": make.x3p(
        make.main_xml(F.shape), [("bindata/data.bin", (with_holes() * 1e-6).astype("<f4").tobytes())]
    ),
    "valid.x3p": make.x3p(
        make.main_xml(F.shape, kind="L", step=1e-9, valid="bindata/valid.bin"),
        [("bindata/data.bin", LEVELS.astype("<i4").tobytes()), ("bindata/valid.bin", valid_bits())],
    ),
}


@pytest.mark.parametrize("name", MISSING)
def test_points_not_measured_are_nan_and_no_others(tmp_path, name):
    part = read(tmp_path, name, MISSING[name])
    assert part.heights_um == pytest.approx(with_holes(), abs=1e-6, nan_ok=True)


# -- .nms --------------------------------------------------------------------------------------
def test_nms_levels_span_the_stated_range(tmp_path):
    raw = np.array([[0, 65535], [1, 32768]])
    part = read(tmp_path, "a.nms", make.nms(raw, low_um=-2.0, high_um=4.5535, pitch_nm=(312.5, 312.5)))
    assert part.heights_um == pytest.approx(-2 + raw * 1e-4, abs=1e-12)
    assert part.size_um == (0.625, 0.625)
    part = read(tmp_path, "b.nms", make.nms(raw, low_um=1.0, high_um=2.0, levels=(32768, 65535)))
    assert part.heights_um[1, 1] == 1.0
    assert part.heights_um[0, 1] == 2.0


BAD_NMS = {
    "version": (make.nms(LEVELS, version=b"OM_MS_3.0"), "version: not an .nms of this version, allowed: OM_MS_2.0"),
    "version goes on": (make.nms(LEVELS, version=b"OM_MS_2.0b"), "version: "),
    "cut": (FILES["plain.nms"][:-1], "length: 3683 bytes, 3684 for 9 x 12 points"),
    "too long": (FILES["plain.nms"] + b"\0", "length: 3685 bytes"),
    "cut head": (FILES["plain.nms"][:2000], "version: "),
    "no columns": (make.nms(np.zeros((3, 0))), "length: "),
    "pitch": (make.nms(LEVELS, pitch_nm=(0, 300)), "pitch: found 0 300 nm, allowed: positive numbers"),
    "range": (make.nms(LEVELS, low_um=2, high_um=1), "z range: levels 0 to 65535 for 2 to 1 µm"),
    "no levels": (make.nms(LEVELS, levels=(5, 5)), "z range: levels 5 to 5"),
    "nan range": (make.nms(LEVELS, low_um=np.nan), "z range: "),
    "type": (struct.pack("<i", 3) + FILES["plain.nms"][4:], "type: type 3, dimension 1, allowed: 2, 1"),
}


@pytest.mark.parametrize("case", BAD_NMS)
def test_faulty_nms_are_refused(tmp_path, case):
    content, expected = BAD_NMS[case]
    source = write(tmp_path, "a.nms", content)
    assert one_line(convert(source, tmp_path / "a.tif")).startswith(f"error: {source}: {expected}")


def test_a_clipped_recording_is_told_from_a_flat_design(tmp_path):
    raw = np.clip(np.random.default_rng(0).normal(30000, 9000, (200, 200)), 0, 40000).round()
    out = tmp_path / "a.tif"
    result = convert(write(tmp_path, "a.nms", make.nms(raw, pitch_nm=(300, 300))), out)
    points = int((raw == 40000).sum())
    assert f"{points} points at the highest height, 40 µm: is the recording clipped?" in result.stderr
    assert "lowest" not in result.stderr
    assert (
        convert(
            write(tmp_path, "b.nms", make.nms(np.where(raw > 30000, 20000, 0), pitch_nm=(300, 300))), tmp_path / "b.tif"
        ).stderr
        == ""
    )


# -- .sdf --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "content", [b"hello", FILES["text.sdf"][:150], FILES["binary.sdf"][:200], b"aISO-9.0\r\n*\r\n"]
)
def test_faulty_sdf_are_refused(tmp_path, content):
    source = write(tmp_path, "a.sdf", content)
    assert f"{source}: file: not a readable SDF" in one_line(convert(source, tmp_path / "a.tif"))


def test_negative_sdf_pitch_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"a\.sdf: pitch"):
        read(tmp_path, "a.sdf", make.ascii_sdf(F, pitch_m=(-1e-7, 3e-7)))


# -- .gwy --------------------------------------------------------------------------------------
SEVERAL = make.gwy(
    [
        ("Amplitude", make.gwy_field(F, unit="V")),
        ("Trace", make.gwy_field(F * 1e-6)),
        ("Retrace", make.gwy_field(F[::-1] * 1e-6)),
        ("Retrace", make.gwy_field(F * 2e-6)),
    ]
)


def test_one_of_several_channels_is_named(tmp_path):
    source, out = write(tmp_path, "a.gwy", SEVERAL), tmp_path / "a.tif"
    error = one_line(convert(source, out))
    assert "channels: 3 channels (1 Trace, 2 Retrace, 3 Retrace), use convert --channel" in error
    for channel, expected in (("Trace", F), ("1", F), ("2", F[::-1]), ("3", 2 * F)):
        assert convert(source, out, "--channel", channel, "--overwrite").exit_code == 0
        assert read_height_map(out).heights_um == pytest.approx(expected, abs=1e-6)
    for channel in ("Retrace", "4", "0", "Amplitude", "²"):
        assert "--channel: found " in one_line(convert(source, out, "--channel", channel, "--overwrite"))
    assert "given for ImageJ TIFF" in one_line(convert(out, tmp_path / "b.tif", "--channel", "1"))


BAD_GWY = {
    "nothing": (b"GWYP", "file: not a whole Gwyddion file"),
    "another": (b"GWYO" + FILES["a.gwy"][4:], "file: not a Gwyddion file, first bytes GWYP"),
    "cut": (FILES["a.gwy"][:-30], "file: not a whole"),
    "text without end": (b"GWYP" + make.gwy_object("GwyContainer", [b"title\0sHeight"]), "file: not a whole"),
    "endless list": (b"GWYP" + make.gwy_object("GwyContainer", [b"a\0S\xff\xff\xff\xff"]), "file: not a whole"),
    "name without type": (b"GWYP" + make.gwy_object("GwyContainer", [b"abc\0"]), "file: not a whole"),
    "number cut": (b"GWYP" + make.gwy_object("GwyContainer", [b"a\0d123"]) + b"45678", "file: not a whole"),
    "unknown type": (b"GWYP" + make.gwy_object("GwyContainer", [b"a\0?1234567"]), "file: not a whole"),
    "no channel": (b"GWYP" + make.gwy_object("GwyContainer", []), "channels: no channel of heights"),
    "volts only": (make.gwy([("U", make.gwy_field(F, unit="V"))]), "channels: no channel of heights"),
    "points missing": (FILES["a.gwy"].replace(b"xres\0i\x09", b"xres\0i\x08"), "channels: xres, yres and data"),
    "no size": (make.gwy([("z", make.gwy_field(F, size_m=(0.0, 1.0)))]), "xreal: found 0.0, allowed"),
    "lateral volts": (make.gwy([("z", make.gwy_field(F, xy_unit="V"))]), "si_unit_xy: found 'V'"),
    "odd mask": (make.gwy([("z", make.gwy_field(F))], [(0, F[1:])]), "mask: mask of (11, 9)"),
}


def nested(depth):
    content = make.gwy_object("a", [])
    for _ in range(depth):
        content = make.gwy_object("a", [make.gwy_component("b", "o", content)])
    return b"GWYP" + content


@pytest.mark.parametrize("case", [*BAD_GWY, "really deep"])
def test_faulty_gwy_are_refused(tmp_path, case):
    content, expected = BAD_GWY.get(case) or (nested(5000), "file: not a whole")
    source = write(tmp_path, "a.gwy", content)
    assert f"{source}: {expected}" in one_line(convert(source, tmp_path / "a.tif"))


# -- .x3p --------------------------------------------------------------------------------------
def test_x3p_is_written_in_the_revision_that_everyone_reads(tmp_path):
    path = tmp_path / "a.x3p"
    write_height_map(path, HeightMap(with_holes(), 0.1, 0.3, "relative"))
    with zipfile.ZipFile(path) as archive:
        text = archive.read("main.xml").decode()
        data = np.frombuffer(archive.read("bindata/data.bin"), "<f4").reshape(F.shape)
    assert "<Revision>ISO5436 - 2000</Revision>" in text
    assert "<DataType>F</DataType>" in text
    assert data == pytest.approx((with_holes() * 1e-6).astype("<f4"), nan_ok=True)
    assert read_height_map(path).height_reference == "relative"


def two_layers():
    xml = make.main_xml(F.shape).replace("<SizeZ>1", "<SizeZ>2")
    return make.x3p(xml, [("bindata/data.bin", np.zeros((2, *F.shape), "<f4").tobytes())])


def with_xml(xml, *members):
    return make.x3p(xml, [("bindata/data.bin", (F * 1e-6).astype("<f4").tobytes()), *members])


LAUGHS = "<!DOCTYPE x [" + "".join(f'<!ENTITY l{k} "{"ha" if k == 0 else f"&l{k - 1};" * 10}">' for k in range(10))
OUTSIDE = '<!DOCTYPE x [<!ENTITY out SYSTEM "file:///etc/passwd">]>'
COMMENT = "<Record2><Date>2020-01-01T00:00:00</Date><Comment>{}</Comment></Record2>"
BAD_X3P = {
    "no zip": (b"hello world", "file: not a readable zip"),
    "cut": (FILES["float.x3p"][:-40], "file: not a readable zip"),
    "names differ": (
        FILES["float.x3p"].replace(b"main.xml", bytes(range(1, 9)), 1),
        "file: not a readable zip (File name in directory",
    ),
    "no xml": (make.x3p("", []), "file: not a readable x3p (main.xml is not valid XML"),
    "laughs": (
        with_xml(make.main_xml(F.shape, prolog=LAUGHS + "]>", extra=COMMENT.format("&l9;"))),
        "file: not a readable x3p (main.xml is not valid XML: EntitiesForbidden",
    ),
    "file outside": (
        with_xml(make.main_xml(F.shape, prolog=OUTSIDE, extra=COMMENT.format("&out;"))),
        "file: not a readable x3p (main.xml is not valid XML: EntitiesForbidden",
    ),
    "link outside": (with_xml(make.main_xml(F.shape, link="../../etc/passwd")), "file: not a readable x3p (Link"),
    "absolute link": (with_xml(make.main_xml(F.shape, link="/etc/passwd")), "file: not a readable x3p (Link"),
    "address": (with_xml(make.main_xml(F.shape, link="http://a.b/c")), "file: not a readable x3p (Link"),
    "climbs": (with_xml(make.main_xml(F.shape), ("../a", b"1")), "path: member '../a' leads out of the archive"),
    "absolute": (with_xml(make.main_xml(F.shape), ("/a", b"1")), "path: member '/a' leads out of the archive"),
    "drive": (with_xml(make.main_xml(F.shape), ("C:\\a", b"1")), "path: member"),
    "fewer points": (with_xml(make.main_xml((13, 9))), "file: not a readable x3p (The data file"),
    "endless grid": (with_xml(make.main_xml((10**9, 10**9))), "file: not a readable x3p (The data file"),
    "layers": (two_layers(), "channels: surface of 2 layers, a surface of one layer"),
    "pitch 0": (with_xml(make.main_xml(F.shape).replace("1e-07", "0")), "file: not a readable x3p (CX: Increment"),
}


@pytest.mark.parametrize("case", BAD_X3P)
def test_faulty_and_hostile_x3p_are_refused(tmp_path, case):
    content, expected = BAD_X3P[case]
    source = write(tmp_path, "a.x3p", content)
    assert f"{source}: {expected}" in one_line(convert(source, tmp_path / "a.tif"))


BOMB_BYTES = 2**26


@pytest.mark.parametrize("member", ["bindata/data.bin", "main.xml", "extra.bin"])
@pytest.mark.parametrize("stated", ["true size", "lied size"])
def test_zip_bombs_are_refused_without_unpacking_them(tmp_path, monkeypatch, member, stated):
    monkeypatch.setattr(x3p, "LARGEST_BYTES", 2**20)
    members = {"main.xml": make.main_xml(F.shape), member: bytes(BOMB_BYTES)}
    content = make.x3p(members.pop("main.xml"), list(members.items()))
    if stated == "lied size":  # 432 bytes and their checksum, in both headers
        content = content.replace(struct.pack("<I", BOMB_BYTES), struct.pack("<I", 432))
        content = content.replace(
            struct.pack("<I", zlib.crc32(bytes(BOMB_BYTES))), struct.pack("<I", zlib.crc32(bytes(432)))
        )
    source = write(tmp_path, "a.x3p", content)
    assert source.stat().st_size < BOMB_BYTES / 500
    read_height_map(write(tmp_path, "b.x3p", FILES["float.x3p"]))  # imports are not what is measured
    tracemalloc.start()
    try:
        result = convert(source, tmp_path / "a.tif")
        assert tracemalloc.get_traced_memory()[1] < 2**23
    finally:
        tracemalloc.stop()
    if stated == "true size":
        assert f"{source}: size: {member} unpacks to more than " in one_line(result)
    elif member == "extra.bin":
        assert "file: not a readable x3p" in one_line(result)  # its heights are absent
    else:
        assert result.exit_code == (0 if member == "bindata/data.bin" else 1)


# -- the extra ---------------------------------------------------------------------------------
def test_without_the_extra_one_line_says_what_to_do(tmp_path, monkeypatch):
    for name in [name for name in sys.modules if name.split(".")[0] == "SurfaceTopography"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "SurfaceTopography", None)
    for name, content in (("a.tmd", make.tmd(F)), ("a.dat", b"\x88\x1b\x03\x6f" + bytes(900)), ("a.vk4", b"VK4_")):
        source = write(tmp_path, name, content)
        error = one_line(convert(source, tmp_path / "a.tif"))
        assert f"{source}: format: needs the readers for other instruments, pip install '.[instr" in error


def test_a_dat_of_text_needs_no_extra(tmp_path):
    assert read(tmp_path, "a.dat", b"1 2\n3 4\n", pitch_um=1).heights_um.tolist() == [[1, 2], [3, 4]]


def test_libraries_are_loaded_only_when_needed():
    names = ("SurfaceTopography", "x3pio", "sdfio", "h5py", "pandas")
    code = (
        "import sys, dlwpredict.cli; from dlwpredict.files.formats import formats; formats();"
        f"print([name for name in {names} if name in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


@needs_extra
def test_an_instrument_file_is_read_upright_in_um(tmp_path):
    part = read(tmp_path, "a.tmd", make.tmd(F))
    assert part.heights_um == pytest.approx(F, abs=1e-6)
    assert (part.dx_um, part.dy_um) == pytest.approx((0.1, 0.3), rel=1e-6)


@needs_extra
def test_every_ending_belongs_to_a_reader_of_that_ending():
    readers = instruments._library()
    for ending, name in instruments.READERS.items():
        assert ending == ".000" or ending[1:] in readers[name].file_extensions(), ending
    library = {magic for _, magic in readers["metropro"]._magic}
    assert library == set(instruments.METROPRO_FIRST_BYTES)


@needs_extra
@pytest.mark.parametrize("ending", sorted(instruments.READERS))
@pytest.mark.parametrize("content", [b"hello world\n" * 50, bytes(5000), bytes(range(256)) * 9])
def test_what_its_reader_refuses_gets_one_line(tmp_path, ending, content):
    source = write(tmp_path, f"a{ending}", content)
    error = one_line(convert(source, tmp_path / "a.tif"))
    assert str(source) in error
    assert len(error) < 500


@needs_extra
def test_x3p_written_here_is_read_alike_by_another_library(tmp_path):
    path = tmp_path / "a.x3p"
    write_height_map(path, HeightMap(with_holes(), 0.1, 0.3))
    surface = instruments._library()["x3p"](str(path)).topography().to_unit("um")
    heights = np.ma.filled(surface.heights(), np.nan).T
    assert heights == pytest.approx(with_holes(), abs=1e-6, nan_ok=True)
    assert surface.physical_sizes == pytest.approx((0.9, 3.6))


# -- real recordings ---------------------------------------------------------------------------
REAL = {  # rows, cols, pitch x, y, z low, high in µm, missing in %; the README's figures
    "usurf_crater_a.nms": (512, 512, 0.3125, 0.3125, 2.689, 6.007, 0),
    "usurf_crater_b.nms": (512, 512, 0.3125, 0.3125, 6.321, 8.280, 0),
    "sphere_r500um_50x_converted.x3p": (960, 1280, 0.07488, 0.07488, -0.369, 3.355, 3.70),
    "turned_lines_anisotropic_pixels.x3p": (650, 650, 0.12766, 0.31458, -0.314, 0.240, 0),
    "sphere_r500um_50x.mnt": (960, 1280, 0.07488, 0.07488, -0.369, 3.355, 3.70),
    "confocal_tilted_flat.plu": (576, 768, 1.660, 1.660, -111.23, -101.21, 0),
    "rotated_square_plate.frt": (500, 500, 24, 24, 0, 305.2, 30.6),
    "wli_fine_texture.opd": (480, 640, 0.197, 0.197, -0.353, -0.223, 0.038),
    "coin_relief.tmd": (300, 300, 63.19, 63.19, 0, 351, 0),
    "fizeau_circular_aperture.dat": (432, 425, 117.92, 117.92, -0.2505, 0.0802, 25.7),
}
DIGITS = {  # half of the last digit printed: pitch, z, missing
    ".nms": (5e-5, 5e-4, 1e-9),
    ".x3p": (5e-6, 5e-4, 5e-3),
    ".mnt": (5e-6, 5e-4, 5e-3),
    ".plu": (5e-4, 5e-3, 1e-9),
    ".frt": (1e-6, 5e-2, 5e-2),
    ".opd": (5e-4, 5e-4, 5e-4),
    ".tmd": (5e-3, 5e-1, 1e-9),
    ".dat": (5e-3, 5e-5, 5e-2),
}


@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="recordings not at hand")
@pytest.mark.parametrize("name", REAL)
def test_real_recordings_are_read_as_their_readme_has_them(name):
    if Path(name).suffix not in (".nms", ".x3p") and importlib.util.find_spec("SurfaceTopography") is None:
        pytest.skip("extra `instruments` not installed")
    part = read_height_map(RECORDINGS / name)
    rows, cols, dx, dy, low, high, missing = REAL[name]
    pitch, z, percent = DIGITS[Path(name).suffix]
    assert part.shape == (rows, cols)
    assert (part.dx_um, part.dy_um) == pytest.approx((dx, dy), abs=pitch)
    assert (np.nanmin(part.heights_um), np.nanmax(part.heights_um)) == pytest.approx((low, high), abs=z)
    assert 100 * part.missing_fraction == pytest.approx(missing, abs=percent)


@needs_extra
@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="recordings not at hand")
@pytest.mark.parametrize("name", REAL)
def test_recordings_cut_short_are_refused(tmp_path, name):
    content = (RECORDINGS / name).read_bytes()
    source = write(tmp_path, name, content[: len(content) * 3 // 10])
    assert str(source) in one_line(convert(source, tmp_path / "a.tif"))


@needs_extra
@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="recordings not at hand")
def test_the_tilt_of_the_polished_flat_is_told(tmp_path):
    """7.70 mrad along x, 0.19 mrad along y (README of the recordings; it does not say which way y runs)."""
    result = convert(RECORDINGS / "confocal_tilted_flat.plu", tmp_path / "a.tif")
    along_x, along_y = result.stdout.split("tilt ")[1].split(" mrad")[0].split(" x ")
    assert (abs(float(along_x)), abs(float(along_y))) == pytest.approx((7.70, 0.19), abs=5e-3)


@needs_extra
@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="recordings not at hand")
def test_two_readers_agree_on_the_sphere():
    """The .x3p was converted from the .mnt without resampling, in float32."""
    one, two = (read_height_map(RECORDINGS / f"sphere_r500um_50x{end}") for end in (".mnt", "_converted.x3p"))
    assert one.same_grid(two)
    assert np.allclose(one.heights_um, two.heights_um, rtol=0, atol=1e-6, equal_nan=True)


@needs_extra
@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="recordings not at hand")
@pytest.mark.parametrize(
    ("name", "directions"),
    [
        ("afm_both_directions.ibw", ("HeightTrace", "HeightRetrace")),
        ("afm_both_directions.nid", ("Scan forward (Z-AxisSensor)", "Scan backward (Z-AxisSensor)")),
    ],
)
def test_both_directions_of_a_scan_are_read_the_same_way_round(tmp_path, name, directions):
    """Each by its channel, not mirrored against the other, with the fast axis along x."""
    assert all(direction in one_line(convert(RECORDINGS / name, tmp_path / "a.tif")) for direction in directions)
    maps = []
    for number, direction in enumerate(directions):
        out = tmp_path / f"{number}.tif"
        assert convert(RECORDINGS / name, out, "--channel", direction).exit_code == 0
        maps.append(read_height_map(out))
    trace, retrace = (np.diff(gaussian_filter(one.heights_um, 1.5), axis=1) for one in maps)
    assert maps[0].same_grid(maps[1]) and maps[0].instrument == maps[1].instrument == Instrument("afm", 0.0)
    alike, mirrored = (np.corrcoef(trace.ravel(), one.ravel())[0, 1] for one in (retrace, retrace[:, ::-1]))
    assert 0.5 < alike < 0.999 and mirrored < 0.5


@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="recordings not at hand")
@pytest.mark.parametrize("name", ["FOV11_afm.txt", "FOV33_afm.txt", "FOV71_afm.txt"])
def test_published_text_maps_are_read(name):
    """Metres, 540 x 540, nothing missing, lowest pixel 0 (README of the prints)."""
    part = read_height_map(RECORDINGS / "two_photon" / name, pitch_um=0.1, z_scale=1e6)
    assert (part.shape, part.missing_fraction, np.min(part.heights_um)) == ((540, 540), 0, 0)
    assert 0.74 <= np.max(part.heights_um) <= 1.14


@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="recordings not at hand")
def test_the_legacy_bullet_is_refused_in_one_line(tmp_path):
    error = one_line(convert(RECORDINGS / "bullet_land_legacy.x3p", tmp_path / "a.tif"))
    assert "bullet_land_legacy.x3p: file: not a readable x3p (main.xml has the unexpected root" in error


# -- the family --------------------------------------------------------------------------------
@pytest.mark.parametrize("name", sorted(FILES))
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_damaged_instrument_files_are_read_or_refused(tmp_path_factory, name, seed):
    """Up to five bytes changed, and half of the files cut."""
    rng = np.random.default_rng(seed)
    content = bytearray(FILES[name])
    for place in rng.integers(0, len(content), rng.integers(1, 6)):
        content[place] = rng.integers(256)
    path = tmp_path_factory.mktemp("bad") / name
    path.write_bytes(content[: rng.integers(1, len(content))] if rng.random() < 0.5 else content)
    try:
        read_height_map(path)
    except InputError as error:
        assert str(path) in str(error)
        assert "\n" not in str(error)
        assert len(str(error)) < len(str(path)) + 300


def test_a_file_that_no_reader_takes_gets_one_line(tmp_path):
    noise = np.random.default_rng(0).integers(0, 256, 4000, dtype=np.uint8).tobytes()
    core = [ending for ending, this in formats().items() if this.read and this.name != "other instruments"]
    for ending in [*core, ".xyz"]:
        source = write(tmp_path, f"a{ending}", noise)
        assert (
            str(source) in one_line(convert(source, tmp_path / "out.tif", "--pitch-um", 1, "--z-range", 0, 1)) or ending
        )

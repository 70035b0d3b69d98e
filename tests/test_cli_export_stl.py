"""``export-stl`` through the whole program; the file is judged by trimesh alone."""

import re

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

from dlwpredict.cli import app
from dlwpredict.errors import ResultError
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.stl import read_triangles, write_solid
from dlwpredict.heightmap import HeightMap
from dlwpredict.solid.mesh import Solid, solid_of


def run(*arguments):
    return CliRunner().invoke(app, ["export-stl", *map(str, arguments)])


def letter_f():
    heights = np.zeros((40, 30))
    heights[5:35, 6:10] = 1.5
    heights[5:9, 6:25] = 1.5
    heights[18:22, 6:20] = 0.5
    return heights


def windings(mesh, point):
    """How often the surface winds around a point: 1 inside, 0 outside (sum of solid angles over 4 pi)."""
    a, b, c = (mesh.triangles[:, k] - point for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", u, v) for u, v in ((a, b), (b, c), (c, a)))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    return np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb).sum() / (2 * np.pi)


@pytest.fixture
def part(tmp_path):
    write_height_map(tmp_path / "f.tif", HeightMap(letter_f(), 0.2, 0.1))
    return tmp_path / "f.tif"


def test_the_f_becomes_a_solid_in_um(tmp_path, part):
    out = tmp_path / "f.stl"
    result = run(part, "-o", out)
    assert result.exit_code == 0, result.output
    assert result.stdout.count("\n") == 1
    assert "watertight" in result.stdout
    mesh = trimesh.load_mesh(out)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(letter_f().sum() * 0.2 * 0.1, rel=1e-5)
    assert mesh.bounds == pytest.approx(np.array([[5.5 * 0.2, 4.5 * 0.1, 0], [24.5 * 0.2, 34.5 * 0.1, 1.5]]), rel=1e-5)
    assert out.stat().st_size == 84 + 50 * len(mesh.faces)
    assert not out.read_bytes().startswith(b"solid")


def test_seen_from_above_it_is_the_same_picture(tmp_path, part):
    """The stem of the F lies left (small x), its long arm at the top (large y)."""
    out = tmp_path / "f.stl"
    run(part, "-o", out)
    mesh = trimesh.load_mesh(out)
    for row, col in [(7, 20), (32, 8), (7, 8), (20, 15), (32, 20), (20, 23)]:
        x, y = col * 0.2 + 0.013, (39 - row) * 0.1 + 0.007
        assert windings(mesh, (x, y, 0.3)) == pytest.approx(int(letter_f()[row, col] > 0.3), abs=1e-6)
    back = read_height_map(out, pitch_um=(0.2, 0.1)).heights_um
    assert back == pytest.approx(letter_f()[5:35, 6:25], abs=1e-5)  # float32 corners, steps of 1 µm per pixel


def test_ascii_stl_is_read_as_well(tmp_path, part):
    run(part, "-o", tmp_path / "f.stl")
    (tmp_path / "g.stl").write_text(trimesh.load_mesh(tmp_path / "f.stl").export(file_type="stl_ascii"))
    first, second = (np.sort(read_triangles(tmp_path / name), axis=1) for name in ("f.stl", "g.stl"))
    assert second == pytest.approx(first, abs=1e-6)


def test_missing_points_need_a_word(tmp_path):
    heights = letter_f()
    heights[0, 0] = np.nan
    write_height_map(tmp_path / "a.tif", HeightMap(heights, 0.2, 0.1))
    out = tmp_path / "a.stl"
    result = run(tmp_path / "a.tif", "-o", out)
    assert (result.exit_code, out.exists()) == (1, False)
    assert result.stderr.startswith(f"error: {tmp_path / 'a.tif'}: heights: 1 points not measured")
    assert run(tmp_path / "a.tif", "-o", out, "--fill", "zero").exit_code == 0
    assert trimesh.load_mesh(out).volume == pytest.approx(letter_f().sum() * 0.02, rel=1e-5)


def test_lifts_are_reported(tmp_path):
    write_height_map(tmp_path / "a.tif", HeightMap(letter_f() / 10, 0.2, 0.1))
    result = run(tmp_path / "a.tif", "-o", tmp_path / "a.stl")
    assert result.exit_code == 0
    assert "56 points lifted to the smallest thickness, by up to 0.05 µm" in result.stderr


@pytest.mark.parametrize(
    ("heights", "match"),
    [(letter_f() - 1, "heights: .* negative heights, lowest -1 µm, allowed"), (letter_f() * 0, "nothing written")],
)
def test_negative_or_empty_maps_leave_no_file(tmp_path, heights, match):
    write_height_map(tmp_path / "a.tif", HeightMap(heights, 0.2, 0.1))
    result = run(tmp_path / "a.tif", "-o", tmp_path / "a.stl")
    assert result.exit_code == 1
    assert re.search(match, result.stderr)
    assert list(tmp_path.iterdir()) == [tmp_path / "a.tif"]


def test_a_leaking_solid_is_never_written(tmp_path):
    good = solid_of(HeightMap(letter_f(), 0.2, 0.1))
    for faces in (good.faces[1:], np.vstack([good.faces[:1, ::-1], good.faces[1:]]), good.faces[:, ::-1]):
        with pytest.raises(ResultError, match="mesh"):
            write_solid(tmp_path / "a.stl", Solid(good.vertices_um, faces))


@pytest.mark.slow
def test_a_million_pixels_take_seconds(tmp_path):
    x = np.linspace(-1, 1, 1001)
    lens = np.clip(3 - 4 * (x[:, None] ** 2 + x**2), 0, None)
    write_height_map(tmp_path / "a.tif", HeightMap(lens, 0.1, 0.1))
    result = run(tmp_path / "a.tif", "-o", tmp_path / "a.stl")
    assert result.exit_code == 0, result.output
    paraboloid = np.pi * 50**2 * (3 / 4) * 3 / 2  # half of the cylinder around it
    lifted = np.pi * 50**2 * (0.1 / 4) * 0.1 / 2  # the ring below 0.1 µm
    volume = float(result.stdout.split("volume ")[1].split()[0])
    assert volume == pytest.approx(paraboloid + lifted, rel=1e-4)

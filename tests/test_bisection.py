"""Grids covered with few triangles: no gaps, no overlap, within the stated error; and `export-stl --max-faces`."""

import json

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from typer.testing import CliRunner

from dlwpredict.cli import app
from dlwpredict.designs import air, cin, lens
from dlwpredict.files import write_height_map
from dlwpredict.heightmap import HeightMap
from dlwpredict.solid.bisection import triangles
from dlwpredict.solid.mesh import boundary_edges, largest_distance_um, solid_of


def off_by(heights, found):
    """Largest distance of the heights from the triangles, each point by the plane of every triangle that holds it."""
    worst, seen = 0.0, np.zeros(heights.shape, dtype=bool)
    rows, cols = np.indices(heights.shape)
    for corners in found:
        plane = np.linalg.solve(np.column_stack([corners, np.ones(3)]), heights[tuple(corners.T)])
        weights = np.linalg.solve(
            np.vstack([corners.T, np.ones(3)]), np.stack([rows.ravel(), cols.ravel(), np.ones(rows.size)])
        )
        holds = (weights > -1e-9).all(axis=0).reshape(rows.shape)
        worst = max(worst, abs(plane[0] * rows + plane[1] * cols + plane[2] - heights)[holds].max())
        seen |= holds
    assert seen.all()
    return worst


@pytest.mark.slow
@given(
    heights=arrays(float, array_shapes(min_dims=2, max_dims=2, min_side=2, max_side=12), elements=st.floats(0, 2)),
    tolerance=st.sampled_from([0.0, 0.1, 0.7, 3.0]),
)
@settings(max_examples=60, deadline=None)
def test_any_grid_is_covered_once_and_within_the_tolerance(heights, tolerance):
    found = triangles(heights, np.zeros(heights.shape, dtype=bool), tolerance)
    assert off_by(heights, found) <= tolerance + 1e-9
    a, b, c = found.transpose(1, 0, 2)
    area = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    assert area.min() > 0
    assert area.sum() == (heights.shape[0] - 1) * (heights.shape[1] - 1)
    number = found[..., 0] * heights.shape[1] + found[..., 1]
    assert len(boundary_edges(number)) == 2 * (sum(heights.shape) - 2)  # the border whole, nothing open inside


def test_a_plane_needs_no_more_than_its_border():
    rows, cols = np.indices((257, 257))
    found = triangles(0.3 * rows + 0.1 * cols, np.zeros((257, 257), dtype=bool), 1e-9)
    assert len(found) < 0.05 * 2 * 256**2


@pytest.mark.parametrize("pitch", [(0.2, 0.2), (0.2, 0.5)])
@pytest.mark.parametrize("error", [0.003, 0.05])
def test_solids_with_holes_and_steps_stay_watertight_and_near(pitch, error):
    heights = np.array(air(size_um=16, pitch_um=0.2, margin_um=2).heights_um)
    heights[30:41, 25:60] = 0
    heights[60:62, 10:80] = 3
    part = HeightMap(heights, *pitch)
    whole, found = solid_of(part), solid_of(part, error_um=error)
    mesh = trimesh.Trimesh(found.vertices_um.astype(np.float32), found.faces, process=True)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert len(found.faces) < len(whole.faces)
    assert largest_distance_um(found, whole, part) <= error + 1e-9
    assert found.volume_um3 == pytest.approx(whole.volume_um3, rel=error / 3)
    assert found.vertices_um.max(axis=0)[:2] == pytest.approx(whole.vertices_um.max(axis=0)[:2])


def run(*arguments):
    return CliRunner().invoke(app, ["export-stl", *map(str, arguments)])


@pytest.mark.slow
def test_max_faces_merges_within_the_bound_or_refuses(tmp_path):
    path, out = tmp_path / "lens.tif", tmp_path / "lens.stl"
    write_height_map(path, lens(size_um=40, pitch_um=0.2, margin_um=4))
    whole = json.loads(run(path, "-o", tmp_path / "whole.stl", "--json", "-").stdout)
    result = run(path, "-o", out, "--max-faces", whole["triangles"] // 2, "--json", tmp_path / "lens.json")
    assert result.exit_code == 0, result.output
    found = json.loads((tmp_path / "lens.json").read_text())
    mesh, full = trimesh.load_mesh(out), trimesh.load_mesh(tmp_path / "whole.stl")
    assert mesh.is_watertight
    assert len(mesh.faces) == found["triangles"] <= whole["triangles"] // 2
    assert 0 < found["surface_error_um"] <= 0.01
    assert f"triangles within {1e3 * found['surface_error_um']:.3g} nm" in result.stdout
    assert mesh.volume == pytest.approx(full.volume, rel=1e-3)
    refused = run(path, "-o", tmp_path / "no.stl", "--max-faces", 1000)
    assert (refused.exit_code, refused.stderr.count("\n")) == (1, 1)
    assert "triangles are needed to stay within 0.01 µm" in refused.stderr
    assert not (tmp_path / "no.stl").exists()
    assert (
        "--max-error-um: found 2" in run(path, "-o", out, "--max-faces", 9, "--max-error-um", 2, "--overwrite").stderr
    )


def test_enough_faces_change_nothing(tmp_path):
    write_height_map(tmp_path / "a.tif", cin(size_um=20, pitch_um=0.5, margin_um=2))
    for name, words in (("a", []), ("b", ["--max-faces", 10**6])):
        assert run(tmp_path / "a.tif", "-o", tmp_path / f"{name}.stl", *words).exit_code == 0
    assert (tmp_path / "a.stl").read_bytes() == (tmp_path / "b.stl").read_bytes()

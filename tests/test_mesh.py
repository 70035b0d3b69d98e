"""Solids from height maps: watertight, right way round, right volume; and how meshes are seen from above."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from dlwpredict.errors import InputError
from dlwpredict.heightmap import HeightMap
from dlwpredict.metrology.missing import fill_missing
from dlwpredict.solid.mesh import boundary_edges, solid_of
from dlwpredict.solid.rasterise import seen_from_above

DX, DY = 0.1, 0.25


def solid(heights, **options):
    return solid_of(HeightMap(heights, DX, DY), **options)


def checked(heights, **options):
    """Build a solid and have trimesh check it as loaded from a file: equal float32 corners joined."""
    made = solid(heights, **options)
    mesh = trimesh.Trimesh(made.vertices_um.astype(np.float32), made.faces, process=True)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(made.volume_um3, rel=1e-5)
    assert mesh.volume > 0
    assert len(mesh.vertices) == len(made.vertices_um)
    assert mesh.area_faces.min() > 0
    assert len(boundary_edges(made.faces)) == 0
    return made


def with_margin(part, margin=3):
    return np.pad(np.asarray(part, dtype=float), margin)


def letter_f():
    return with_margin([[2, 2, 2, 2], [1, 0, 0, 0], [1, 3, 3, 0], [1, 0, 0, 0], [1, 0, 0, 0]])


def seen(made):
    return seen_from_above(made.vertices_um[made.faces], DX, DY)


@pytest.mark.slow
@given(
    heights=arrays(
        float,
        array_shapes(min_dims=2, max_dims=2, min_side=2, max_side=20),
        elements=st.one_of(st.just(0.0), st.floats(0.01, 5)),
    ).filter(lambda h: h.any())
)
@settings(max_examples=150, deadline=None)
def test_any_map_is_watertight(heights):
    checked(heights)


def test_pixels_that_touch_by_a_corner_stay_apart():
    board = np.indices((9, 9)).sum(axis=0) % 2 * 1.0
    made = checked(board)
    mesh = trimesh.Trimesh(made.vertices_um, made.faces, process=True)
    assert mesh.body_count == board.sum()
    assert made.volume_um3 < board[1:-1, 1:-1].sum() * DX * DY + 16 * DX * DY / 2


def test_a_part_within_a_margin_has_the_volume_of_its_pixels():
    """Pixels of equal height own dx x dy each, wherever the border runs; only corner contacts lose a little."""
    part = with_margin(np.ones((30, 40)) * 2.5)
    part[10:14, 12:20] = 0  # a hole
    assert checked(part).volume_um3 == pytest.approx(part.sum() * DX * DY, rel=1e-12)


def test_stairs_with_margin_have_the_volume_of_the_prisms_between_their_pixels():
    """Between steps the top is linear over one pixel, so each pixel still counts fully: sum of h·dx·dy."""
    stairs = with_margin(np.repeat([0.5, 1.0, 1.5, 2.0], 6) * np.ones((20, 1)))
    assert checked(stairs).volume_um3 == pytest.approx(stairs.sum() * DX * DY, rel=1e-12)


def test_a_map_without_zeros_is_a_slab_between_its_outer_pixel_centres():
    y, x = np.mgrid[50:-1:-1, 0:41].astype(float)
    slope = 1 + 0.01 * x + 0.02 * y
    made = checked(slope)
    width, depth = 40 * DX, 50 * DY
    assert made.vertices_um.min(axis=0) == pytest.approx((0, 0, 0))
    assert made.vertices_um.max(axis=0) == pytest.approx((width, depth, slope.max()))
    assert made.volume_um3 == pytest.approx(width * depth * slope.mean(), rel=1e-12)
    assert len(made.faces) < 2.2 * slope.size + 1000  # the base is coarse


def test_the_base_is_flat_and_the_walls_upright():
    made = checked(letter_f())
    a, b, c = (made.vertices_um[made.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    lowest = (made.vertices_um[made.faces][..., 2] == 0).all(axis=1)
    assert (normals[lowest, 2] < 0).all()
    assert normals[lowest, :2] == pytest.approx(0)
    walls = normals[:, 2] == 0
    assert walls.any()
    assert (normals[~lowest & ~walls, 2] > 0).all()


def test_seen_from_above_the_part_looks_like_the_picture():
    heights = letter_f()
    assert seen(checked(heights)) == pytest.approx(heights[3:-3, 3:-3])
    full = heights + 1
    assert seen(checked(full)) == pytest.approx(full)


def test_a_foreign_solid_is_rasterised_exactly():
    """A box 4 x 2 x 3 µm with a roof z = 3 + x/8 added by moving its top corners."""
    box = trimesh.creation.box(bounds=[(-2, -1, 5), (2, 1, 8)])
    corners = box.vertices.copy()
    corners[corners[:, 2] > 6, 2] += corners[corners[:, 2] > 6, 0] / 8
    heights = seen_from_above(corners[box.faces], 0.5, 0.25)
    assert heights.shape == (9, 9)
    assert heights == pytest.approx(np.tile(3 + np.linspace(-2, 2, 9) / 8, (9, 1)))


def test_a_ball_is_seen_as_its_upper_half():
    ball = trimesh.creation.icosphere(subdivisions=5, radius=10.0)
    heights = seen_from_above(ball.vertices[ball.faces], 0.5, 0.5)
    y, x = np.mgrid[10:-10.1:-0.5, -10:10.1:0.5]
    inside = np.hypot(x, y) < 9
    assert heights[inside] == pytest.approx(10 + np.sqrt(100 - x[inside] ** 2 - y[inside] ** 2), abs=0.02)
    assert (heights[np.hypot(x, y) > 10.1] == 0).all()


def test_low_heights_are_lifted_and_reported():
    made = checked(with_margin([[0.02, 0.5], [0.5, 1e-5]]))
    assert (made.lifted_points, made.largest_lift_um) == (1, pytest.approx(0.08))
    assert "1 points lifted" in made.remarks[0]
    tops = made.vertices_um[made.vertices_um[:, 2] > 0, 2]
    assert tops.min() == pytest.approx(0.1)
    assert solid(letter_f()).remarks == []


def test_a_plate_carries_the_whole_map():
    heights = letter_f()
    made = checked(heights, base_um=0.5)
    assert seen(made) == pytest.approx(heights + 0.5)
    assert made.lifted_points == 0


@pytest.mark.parametrize(
    ("heights", "options", "match"),
    [
        ([[1, np.nan], [1, 1]], {}, "heights: 1 points not measured, a solid has no NaN: use --fill"),
        ([[1, -0.5], [1, 1]], {}, "heights: 1 negative heights, lowest -0.5"),
        ([[0, 0], [0, 0]], {}, "heights: nothing written"),
        ([[1, 1], [1, 1]], {"min_thickness_um": 0}, "--min-thickness-um: found 0, allowed 0.001"),
        ([[1, 1], [1, 1]], {"base_um": 0.05}, "--base-um: found 0.05, allowed: 0 or 0.1 to"),
        ([[1, 1], [1, 1]], {"base_um": np.nan}, "--base-um: found nan"),
    ],
)
def test_what_cannot_be_a_solid_is_refused(heights, options, match):
    with pytest.raises(InputError, match=match):
        solid(heights, **options)


def test_filling():
    part = HeightMap([[1, np.nan, np.nan, 4], [1, 1, 4, 4]], 1, 10)
    assert fill_missing(part, "nearest").heights_um[0].tolist() == [1, 1, 4, 4]
    assert fill_missing(part, "zero").heights_um[0].tolist() == [1, 0, 0, 4]
    assert fill_missing(part, "2.5").filled.sum() == 2
    for how in ("mean", "nan", "inf"):
        with pytest.raises(InputError, match=r"--fill: found .*, allowed: zero, nearest, or a height"):
            fill_missing(part, how)


def test_a_corner_is_cut_at_the_mean_of_its_two_neighbours():
    """Of four pixels one is not written: the surface ends half-way between the two beside it, at their mean height."""
    solid = solid_of(HeightMap([[1.0, 2.0], [5.0, 0.0]], 1.0, 1.0))
    middle = solid.vertices_um[(np.abs(solid.vertices_um[:, :2] - 0.5) < 1e-9).all(axis=1)]
    assert sorted(middle[:, 2].tolist()) == pytest.approx([0.0, 3.5])

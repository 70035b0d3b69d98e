"""What effects ask of a plane, each on a map whose answer is plain: pixels of 0.5 × 0.25 µm."""

import numpy as np
import pytest

from dlwpredict.effects.plane import (
    centroid_um,
    edge_distance_um,
    field_coordinates,
    gaussian_um,
    half_width_um,
    occupied,
    pixel_of,
    resampled,
    slopes,
    standing,
    where_written,
)
from dlwpredict.heightmap import HeightMap

GRID = HeightMap(np.zeros((8, 10)), 0.5, 0.25)


def part() -> np.ndarray:
    """Four columns (2 µm) and six rows (1.5 µm), off the middle: columns 1–4, rows 0–5."""
    footprint = np.zeros(GRID.shape, bool)
    footprint[0:6, 1:5] = True
    return footprint


def test_the_field_is_counted_from_its_centre_in_units_of_50_um():
    x, y = field_coordinates(GRID, 10.0, -20.0)
    np.testing.assert_allclose(x, (GRID.x_um - 10) / 50)
    np.testing.assert_allclose(y[:, 0], (GRID.y_um + 20) / 50)


def test_what_is_not_written_stays_so_and_nothing_lies_below_the_glass():
    target = GRID.with_heights(np.where(part(), 1.0, 0.0))
    np.testing.assert_array_equal(where_written(target, np.full(GRID.shape, 2.0)), 2.0 * part())
    assert not where_written(target, np.full(GRID.shape, -1.0)).any()


def test_a_layer_is_occupied_up_to_the_height_itself():
    target = GRID.with_heights(np.where(part(), 1.0, 0.0))
    np.testing.assert_array_equal(occupied(target, 1.0), part())
    assert not occupied(target, 1.01).any()
    np.testing.assert_array_equal(occupied(target, 0.0), part())


def test_slopes_are_per_um_and_y_points_upwards():
    x, y = np.meshgrid(GRID.x_um, GRID.y_um)
    right, up = slopes(GRID.with_heights(0.3 * x - 0.7 * y))
    np.testing.assert_allclose(right, 0.3)
    np.testing.assert_allclose(up, -0.7)


def test_centre_and_half_width_of_a_footprint():
    assert centroid_um(part(), GRID) == pytest.approx((-1.0, 0.25))
    assert half_width_um(part(), GRID) == pytest.approx((2.0 + 1.5) / 4)


def test_distance_to_the_edge_starts_at_the_edge_of_the_outermost_pixel():
    """From the pixel's centre to the next free one, less half a pixel; the map's border is an edge."""
    distance = edge_distance_um(part(), GRID)
    assert distance[0, 2] == pytest.approx(0.25 - 0.125)
    assert distance[2, 1] == pytest.approx(0.5 - 0.125)
    assert distance[2, 2] == pytest.approx(0.75 - 0.125)
    assert distance[7, 7] == 0


def test_a_footprint_ends_where_a_wall_leaves_less_than_half_of_a_column():
    low, high = (part() * 4.0 for _ in range(2))
    low[:, 4], high[:, 4] = 1.9 * part()[:, 4], 2.1 * part()[:, 4]
    assert not standing(GRID.with_heights(low))[:, 4].any() and standing(GRID.with_heights(low))[:6, 1:4].all()
    np.testing.assert_array_equal(standing(GRID.with_heights(high)), part())


@pytest.mark.parametrize("base_um", [0.1, 1.9, 2.1])
def test_a_low_base_round_a_tower_is_no_edge(base_um):
    """Else the footprint would change all at once where shrinkage brings the base below half of the tower."""
    base = np.pad(np.ones((7, 8)), 1)
    heights = base_um * base
    heights[3:6, 3:6] = 4.0
    np.testing.assert_array_equal(standing(HeightMap(heights, 0.5, 0.25)), base > 0)


def test_a_gaussian_has_its_width_along_both_axes():
    spot = HeightMap(np.zeros((101, 101)), 0.5, 0.25)
    plane = np.zeros(spot.shape)
    plane[50, 50] = 1
    cloud = gaussian_um(plane, spot, 4.0)
    assert cloud[50, 54] / cloud[50, 50] == pytest.approx(0.5, rel=1e-3)
    assert cloud[58, 50] / cloud[50, 50] == pytest.approx(0.5, rel=1e-3)


def test_a_place_is_found_by_its_coordinates():
    x, y = np.meshgrid(GRID.x_um, GRID.y_um)
    np.testing.assert_allclose(pixel_of(GRID, x, y), np.indices(GRID.shape), atol=1e-12)
    heights = np.random.default_rng(0).normal(size=GRID.shape)
    np.testing.assert_allclose(resampled(GRID.with_heights(heights), x, y), heights, atol=1e-9)


def test_a_wall_leaves_no_trace_beyond_three_pixels():
    """A recording has none there; a spline rings."""
    edge = 10
    wall = HeightMap(np.where(np.arange(20) < edge, 3.0, 0.0) + np.zeros((8, 1)), 0.5, 0.25)
    x, y = np.meshgrid(wall.x_um - 0.3 * wall.dx_um, wall.y_um)
    change = np.abs(resampled(wall, x, y) - wall.heights_um)
    assert change[:, edge].min() > 0.5
    assert change[:, : edge - 2].max() < 1e-12
    assert change[:, edge + 3 :].max() < 1e-12


def test_a_wave_is_moved_by_the_transfer_of_hermites_cubics():
    """At t between two pixels: h₀ + h₁·e^(ik) + i·σ·(g₀ + g₁·e^(ik)), σ = (8·sin k − sin 2k)/6 the slope of sin kx."""
    k, t = 2 * np.pi / 6, 0.7
    wave = HeightMap(np.sin(k * np.arange(40)) + np.zeros((8, 1)), 0.5, 0.25)
    x, y = np.meshgrid(wave.x_um + (t - 1) * wave.dx_um, wave.y_um)
    slope, rise = (8 * np.sin(k) - np.sin(2 * k)) / 6, t * t * (3 - 2 * t)
    ends = np.array([1 - rise + 1j * slope * t * (1 - t) ** 2, rise - 1j * slope * t * t * (1 - t)])
    wanted = (ends @ np.exp([0, 1j * k]) * np.exp(1j * k * (np.arange(40) - 1))).imag
    inner = slice(6, -6)
    np.testing.assert_allclose(resampled(wave, x, y)[:, inner], np.tile(wanted[inner], (8, 1)), atol=1e-12)

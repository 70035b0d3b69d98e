"""Reading a plane between its pixels."""

import numpy as np
import pytest

from dlwpredict.numerics.interpolation import moved_along, read_locally, read_means


@pytest.mark.parametrize(("pixels", "third"), [(4, 0.0), (6, 0.25)])
def test_reading_locally_is_exact_on_powers_and_takes_no_pixel_further_than_it_says(pixels, third):
    row, col = np.indices((11, 13))
    place = np.array([[3.25, 5.0, 6.75], [4.5, 7.0, 8.25]])

    def power(y, x):
        return 1 + 2 * y - x + 0.5 * y**2 + x * y + third * x**3 - third * y**3

    np.testing.assert_allclose(read_locally(power(row, col), place, pixels), power(*place), rtol=1e-12)
    far = (np.abs(row[..., None] - place[0]) >= pixels / 2) | (np.abs(col[..., None] - place[1]) >= pixels / 2)
    broken = power(row, col) + 100.0 * far.all(axis=-1)
    np.testing.assert_array_equal(read_locally(broken, place, pixels), read_locally(power(row, col), place, pixels))


def test_slopes_of_what_is_read_do_not_jump_and_are_those_of_waves():
    """At a pixel, of sin kx, read from six: (8·sin k − sin 2k)/6·cos kx in the place of k·cos kx."""
    k, x = 2 * np.pi / 6, np.arange(40.0)
    plane, step = np.sin(k * x) + np.zeros((8, 1)), 1e-6
    at = x[8:-8]
    left, here, right = (
        read_locally(plane, np.stack([np.full(len(at), 4.0), at + move]), 6) for move in (-step, 0, step)
    )
    expected = (8 * np.sin(k) - np.sin(2 * k)) / 6 * np.cos(k * at)
    np.testing.assert_allclose((here - left) / step, expected, atol=1e-4)
    np.testing.assert_allclose((right - here) / step, expected, atol=1e-4)


def test_beyond_its_rim_a_plane_read_locally_goes_on_as_it_ends():
    assert read_locally(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[-3.0, 7.0], [0.0, 1.0]])).tolist() == [1.0, 4.0]


@pytest.mark.parametrize("width_px", [0.3, 1.0, 1.7])
def test_means_of_a_cubic_are_read_exactly(width_px):
    """Of x³ + y² over a rectangle w wide: x³ + x·w²/4 + y² + w²/12."""
    row, col = np.indices((9, 11)).astype(float)
    means = col**3 + col / 4 + row**2 + 1 / 12
    place = np.array([[2.25, 4.0, 5.75], [3.5, 6.0, 7.25]])
    expected = place[1] ** 3 + place[1] * width_px**2 / 4 + place[0] ** 2 + width_px**2 / 12
    np.testing.assert_allclose(read_means(means, place, (width_px, width_px)), expected, rtol=1e-10)


def test_a_mean_over_a_pixel_is_the_pixel():
    heights = np.random.default_rng(1).standard_normal((8, 8))
    place = np.array(np.meshgrid([2.0, 4.0], [3.0, 5.0], indexing="ij"))
    np.testing.assert_allclose(read_means(heights, place, (1.0, 1.0)), heights[np.ix_([2, 4], [3, 5])], atol=1e-12)
    both = (heights[2, 3] + heights[2, 4]) / 2
    np.testing.assert_allclose(read_means(heights, np.array([2.0, 3.5]), (1.0, 2.0)), both, atol=1e-12)


def test_waves_of_few_pixels_are_read_from_six():
    """A wave of eight pixels, means sin(kx)·sinc(k/2): cubics are wrong by 8e-3 of it, quintics by 1e-3."""
    k, col = 2 * np.pi / 8, np.arange(40.0) + np.zeros((8, 1))
    means = np.sin(k * col) * np.sinc(k / 2 / np.pi)
    x = np.linspace(12, 28, 33)
    left = read_means(means, np.stack([np.full(33, 4.0), x]), (1.0, 1.0)) - np.sin(k * x) * np.sinc(k / 2 / np.pi)
    assert np.abs(left).max() < 1.2e-3


def test_beside_a_wall_four_count():
    wall = np.where(np.arange(20) < 10, 1.0, 6.0) + np.zeros((8, 1))
    x = np.array([7.4, 7.9, 11.1, 11.6])
    assert read_means(wall, np.stack([np.full(4, 4.0), x]), (1.0, 1.0)).tolist() == pytest.approx(
        [1, 1, 6, 6], abs=1e-12
    )


@pytest.mark.parametrize("by_px", [0.0, 0.3, -0.75, 2.0, -3.4])
def test_what_is_moved_is_what_is_read_there_and_its_derivative_is_exact(by_px):
    plane, step = np.random.default_rng(0).normal(size=(9, 21)), 1e-6
    row, col = np.indices(plane.shape, dtype=float)
    moved, by_shift = moved_along(plane, by_px, 1)
    np.testing.assert_allclose(moved, read_locally(plane, np.stack([row, col - by_px]), 6), atol=1e-12)
    ahead, behind = (moved_along(plane, by_px + sign * step, 1)[0] for sign in (1, -1))
    np.testing.assert_allclose(by_shift, (ahead - behind) / (2 * step), atol=1e-4)
    across, _ = moved_along(plane.T, by_px, 0)
    np.testing.assert_array_equal(across, moved.T)

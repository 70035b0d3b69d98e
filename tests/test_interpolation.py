"""Reading a plane between its pixels."""

import numpy as np
import pytest

from dlwpredict.numerics.interpolation import read_locally, read_means


def test_reading_locally_is_exact_on_parabolas_and_takes_no_pixel_further_than_two():
    row, col = np.indices((9, 11))
    place = np.array([[2.25, 4.0, 5.75], [3.5, 6.0, 7.25]])
    parabola = 1 + 2 * row - col + 0.5 * row**2 + 0.25 * col**2 + row * col
    expected = 1 + 2 * place[0] - place[1] + 0.5 * place[0] ** 2 + 0.25 * place[1] ** 2 + place[0] * place[1]
    np.testing.assert_allclose(read_locally(parabola, place), expected, rtol=1e-12)
    far = (np.abs(row[..., None] - place[0]) >= 2) | (np.abs(col[..., None] - place[1]) >= 2)
    broken = parabola + 100.0 * far.all(axis=-1)
    np.testing.assert_array_equal(read_locally(broken, place), read_locally(parabola, place))


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

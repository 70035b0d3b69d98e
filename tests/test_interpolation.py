"""Reading a plane between its pixels."""

import numpy as np

from dlwpredict.numerics.interpolation import read_locally


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

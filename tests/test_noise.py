"""The noise model against dense algebra and against its own draws."""

import numpy as np
import pytest

from dlwpredict.noise import PURE, SMOOTHNESSES, Noise, estimate, matern, scatter
from dlwpredict.whitening import Neighbourhood

MODEL = Noise(white_um=0.005, correlated_um=0.02, length_um=1.5, dx_um=0.4, dy_um=0.5)


@pytest.fixture(scope="module")
def used() -> np.ndarray:
    return np.random.default_rng(2).random((24, 30)) > 0.15


@pytest.fixture(scope="module")
def dense(used) -> np.ndarray:
    row, col = np.nonzero(used)
    distance = np.hypot(np.subtract.outer(row, row) * MODEL.dy_um, np.subtract.outer(col, col) * MODEL.dx_um)
    return MODEL.correlated_um**2 * matern(distance, MODEL.length_um) + MODEL.white_um**2 * np.eye(len(row))


class TestAlgebra:
    def test_times_is_the_dense_product(self, used, dense):
        v = np.random.default_rng(0).normal(size=used.sum())
        np.testing.assert_allclose(MODEL.times(scatter(v, used))[used], dense @ v, rtol=1e-10, atol=1e-14)

    def test_solve_is_the_dense_inverse_on_the_pixels_that_count(self, used, dense):
        v = np.random.default_rng(1).normal(size=(2, used.sum()))
        np.testing.assert_allclose(MODEL.solve(v, used, tolerance=1e-10), np.linalg.solve(dense, v.T).T, rtol=1e-5)

    def test_gaps_are_filled_by_the_conditional_mean(self, used, dense):
        v = np.random.default_rng(3).normal(size=used.sum())
        row, col = np.nonzero(used)
        gap = np.argwhere(~used)[5]
        distance = np.hypot((row - gap[0]) * MODEL.dy_um, (col - gap[1]) * MODEL.dx_um)
        expected = MODEL.correlated_um**2 * matern(distance, MODEL.length_um) @ np.linalg.solve(dense, v)
        filled = MODEL.conditional_mean(v, used)
        assert filled[tuple(gap)] == pytest.approx(expected, rel=1e-4)
        np.testing.assert_array_equal(filled[used], v)

    def test_effective_points_are_those_of_the_mean(self, used, dense):
        n = used.sum()
        assert MODEL.effective_points(used) == pytest.approx(n**2 * MODEL.sigma_um**2 / dense.sum())

    def test_white_noise_counts_every_pixel(self, used):
        assert Noise(0.01, 0.0, 1.0, 0.4, 0.4).effective_points(used) == pytest.approx(used.sum())


class TestEstimate:
    @pytest.mark.parametrize(("white", "correlated", "length"), [(0.003, 0.02, 1.0), (0.01, 0.02, 2.0)])
    def test_gappy_maps_give_the_model_back(self, white, correlated, length):
        rng = np.random.default_rng(0)
        truth = Noise(white, correlated, length, 0.4, 0.4)
        used = np.ones((100, 100), dtype=bool)
        used[40:50], used[:, 70:74] = False, False
        used &= rng.random(used.shape) > 0.05
        found = [estimate([truth.simulate(used.shape, rng)], used, 0.4, 0.4) for _ in range(6)]
        assert np.mean([f.white_um for f in found]) == pytest.approx(white, abs=0.001)
        assert np.mean([f.correlated_um for f in found]) == pytest.approx(correlated, rel=0.1)
        assert np.mean([f.length_um for f in found]) == pytest.approx(length, rel=0.12)

    def test_smoothed_noise_keeps_its_weight_at_long_waves(self):
        truth = Noise(0.001, 0.02, 1.4, 0.5, 0.5, smoothness=np.inf)
        used = np.ones((90, 90), dtype=bool)
        found = estimate([truth.simulate(used.shape, np.random.default_rng(9))], used, 0.5, 0.5)
        assert found.effective_points(used) == pytest.approx(truth.effective_points(used), rel=0.25)

    def test_white_noise_is_not_taken_for_correlated(self):
        rng = np.random.default_rng(4)
        found = estimate([0.02 * rng.normal(size=(80, 80))], np.ones((80, 80), dtype=bool), 0.5, 0.5)
        assert found.sigma_um == pytest.approx(0.02, rel=0.08)
        assert found.effective_points(np.ones((80, 80), dtype=bool)) > 0.5 * 6400

    def test_long_waves_count_as_much_as_the_many_short_ones(self):
        rng = np.random.default_rng(11)
        short, long = (Noise(0.002, 0.02, length, 0.2, 0.2, smoothness=np.inf) for length in (0.3, 3.0))
        used = np.ones((160, 160), dtype=bool)
        found = estimate([short.simulate(used.shape, rng) + 0.5 * long.simulate(used.shape, rng)], used, 0.2, 0.2)
        power = sum(f**2 * n.sigma_um**2 / n.effective_points(used) for f, n in ((1, short), (0.5, long)))
        ratio = found.sigma_um**2 / found.effective_points(used) / power  # variance of the mean, found over true
        assert 1 / 3 < ratio < 3  # of neither form; with equal weight for every wave it is 1/18

    def test_spikes_do_not_pass_for_noise(self):
        rng = np.random.default_rng(5)
        values = MODEL.simulate((90, 90), rng)
        values[rng.random(values.shape) < 0.005] += 3.0
        found = estimate([values], np.ones(values.shape, dtype=bool), MODEL.dx_um, MODEL.dy_um)
        assert found.correlated_um == pytest.approx(MODEL.correlated_um, rel=0.2)
        assert found.sigma_um == pytest.approx(MODEL.sigma_um, rel=0.15)

    def test_unmeasured_pixels_are_not_looked_at(self):
        values = MODEL.simulate((60, 60), np.random.default_rng(6))
        used = np.ones(values.shape, dtype=bool)
        used[20:30, 10:50] = False
        gap = np.where(used, values, np.nan)
        assert estimate([gap], used, 0.4, 0.5) == estimate([values], used, 0.4, 0.5)


def test_draws_have_the_models_covariance():
    rng = np.random.default_rng(7)
    draws = np.array([MODEL.simulate((12, 12), rng) for _ in range(4000)])
    assert draws.std() == pytest.approx(MODEL.sigma_um, rel=0.03)
    beside = np.mean(draws[:, 5, 5] * draws[:, 5, 8])
    assert beside == pytest.approx(MODEL.correlated_um**2 * matern(np.array(1.2), 1.5), rel=0.12)


def test_a_grain_smears_the_white_part_and_leaves_its_size():
    grainy = Noise(0.3, 0.5, 1.2, 0.4, 0.7, grain_um=0.3)
    assert grainy.at(np.array(0.0)) == pytest.approx(grainy.sigma_um**2)
    correlated = 0.25 * matern(np.array(0.4), 1.2)
    shared = (1 - PURE) * 0.09 * np.exp(-((0.4 / 0.3) ** 2) / 2)
    assert grainy.at(np.array(0.4)) == pytest.approx(correlated + shared)
    assert grainy.covariance((9, 8))[0, 1] == pytest.approx(correlated + shared)


@pytest.mark.parametrize("smoothness", SMOOTHNESSES)
def test_distances_are_um_along_rows_and_columns(smoothness):
    covariance = Noise(0.3, 0.5, 1.2, 0.4, 0.7, smoothness).covariance((9, 8))
    assert covariance[0, 0] == pytest.approx(0.3**2 + 0.5**2)
    for row, col, distance in ((1, 0, 0.7), (0, 1, 0.4), (2, 0, 1.4), (8, 7, np.hypot(0.7, 0.4))):
        assert covariance[row, col] == pytest.approx(0.25 * matern(distance, 1.2, smoothness))


def test_matern_correlations_are_the_textbooks():
    """Rasmussen & Williams, Gaussian Processes, 2006, Eq. 4.17."""
    t = 0.8
    assert matern(0.8, 1.0, 0.5) == pytest.approx(np.exp(-t))
    assert matern(0.8, 1.0, 1.5) == pytest.approx((1 + 3**0.5 * t) * np.exp(-(3**0.5) * t))
    assert matern(0.8, 1.0, 2.5) == pytest.approx((1 + 5**0.5 * t + 5 / 3 * t**2) * np.exp(-(5**0.5) * t))
    assert matern(0.8, 1.0, np.inf) == pytest.approx(np.exp(-(t**2) / 2))


@pytest.mark.parametrize(("shape", "distance"), [((2, 1), 0.7), ((1, 2), 0.4)])
def test_a_neighbour_is_as_far_as_the_pitch_along_its_axis(shape, distance):
    """Given its only neighbour, a point has the mean b·ε with b = C(d)/C(0), and the variance C(0) − b·C(d)."""
    noise = Noise(0.1, 0.5, 1.2, 0.4, 0.7)
    beside = 0.25 * matern(distance, 1.2)
    coefficients, variances = Neighbourhood.of(np.ones(shape, bool), 0.4, 0.7).rows(noise)
    assert np.abs(coefficients).sum(axis=1) == pytest.approx([0, beside / 0.26])
    assert variances == pytest.approx([0.26, 0.26 - beside**2 / 0.26])

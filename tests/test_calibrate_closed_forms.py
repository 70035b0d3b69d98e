"""What calibration says of its certainty, where it can be derived on paper."""

from dataclasses import replace

import numpy as np
import pytest

from dlwpredict.calibrate.descend import _secant, bounded_step, descend, normal_root
from dlwpredict.calibrate.holdout import _grown, hold_out
from dlwpredict.calibrate.intervals import Information, _given_back, linear_interval, open_directions, sandwich
from dlwpredict.calibrate.loss import Huber
from dlwpredict.calibrate.problem import Point, Problem
from dlwpredict.calibrate.profile import _allowed_rise
from dlwpredict.calibrate.recordings import Recording, coarser, prepare, with_nuisances
from dlwpredict.effects.z_linearity import ZLinearity
from dlwpredict.flat import Free, choose
from dlwpredict.heightmap import HeightMap
from dlwpredict.noise import Noise
from dlwpredict.parameters import Paper, ParameterSet

SIDE = 40
WHITE = Noise(0.03, 0.0, 1.0, 0.5, 0.5)
FREE = choose(ParameterSet(), free=("shrinkage_max",))


def recording(heights=None, *, reference="substrate") -> Recording:
    heights = np.full((SIDE, SIDE), 2.0) if heights is None else heights
    measured = HeightMap(heights, 0.5, 0.25, height_reference=reference)
    return prepare(HeightMap(np.full((SIDE, SIDE), 2.0), 0.5, 0.25), measured, wall_px=0)


def place(residual: np.ndarray, weights: np.ndarray | None = None) -> Point:
    weights = np.ones_like(residual) if weights is None else weights
    return Point(FREE.start, (), (np.zeros(0),), (residual,), (weights,), float(residual @ residual))


class TestNuisances:
    def test_of_a_plane_are_its_slopes_and_edges(self):
        """Shifting by +x lowers what rises along x; y grows upwards, rows downwards; tilts are µm at the rim."""
        pair = recording(reference="relative")
        grid = pair.target
        x, y = np.meshgrid(grid.x_um, grid.y_um)
        columns = dict(zip(*_named(with_nuisances(pair, 0.3 * x - 0.2 * y)), strict=True))
        np.testing.assert_allclose(columns["shift_x"], -0.3, atol=1e-12)
        np.testing.assert_allclose(columns["shift_y"], 0.2, atol=1e-12)
        np.testing.assert_allclose(columns["tilt_x"], (x / 10).ravel(), atol=1e-12)
        np.testing.assert_allclose(columns["tilt_y"], (y / 5).ravel(), atol=1e-12)

    def test_a_wide_pixel_counts_where_most_of_it_did(self):
        heights = np.full((SIDE, SIDE), 2.0)
        heights[0, 0] = heights[2, 2:4] = heights[4, 4] = heights[5, 4:6] = np.nan
        used = coarser(recording(heights), 2).used
        assert used[0, 0] and not used[1, 1] and not used[2, 2] and used[3:, 3:].all()


def _named(pair: Recording) -> tuple[tuple[str, ...], np.ndarray]:
    return pair.column_names, pair.columns.T


class Banana:
    """Rosenbrock's valley, residuals 3 (v − u²) and 1 − u, in noise: a full step along its floor ends up its flank."""

    free = Free(ParameterSet(), ("u", "v"), np.array([-5.0, -30.0]), np.array([5.0, 30.0]))

    def __init__(self):
        self.jacobians = self.places = 0

    def at(self, vector: np.ndarray, known: Point | None = None) -> Point:
        self.places += 1
        residual = np.array([3 * (vector[1] - vector[0] ** 2), 1 - vector[0], 100])
        return Point(vector, (), (), (residual,), (np.ones(3),), float(residual @ residual))

    def jacobian(self, point: Point) -> tuple[np.ndarray]:
        """Differentiate what is subtracted: recording − prediction is the residual."""
        self.jacobians += 1
        return (np.array([[6 * point.vector[0], -3.0], [1.0, 0.0], [0.0, 0.0]]),)


class TestBentValley:
    @pytest.mark.parametrize("start", [(-1.2, 1.0), (-4.0, 16.0), (3.0, 9.0)])
    def test_is_not_crawled_along(self, start):
        """The way over the flank takes a few steps; along the floor alone, up to 13 Jacobians and 37 places."""
        valley = Banana()
        found = descend(valley, valley.at(np.array(start)), gain=1e-9, iterations=20)
        np.testing.assert_allclose(found.vector, 1, atol=3e-3)
        assert valley.jacobians <= 4 and valley.places <= 8


class TestCertainty:
    """One parameter, derivative 1 at every one of n points: it is a mean, and its error σ/√n."""

    jacobian = (np.ones((SIDE**2, 1)),)

    def information(self, noise: Noise) -> Information:
        pair = recording()
        point = place(np.zeros(SIDE**2))
        return Information(sandwich((pair,), FREE, point, self.jacobian, (noise,)), np.array([np.inf]))

    def test_of_a_mean_is_the_textbook(self):
        assert self.information(WHITE).standard_errors[0] == pytest.approx(0.03 / SIDE, rel=1e-4)

    def test_correlated_noise_leaves_fewer_points(self):
        noise = Noise(0.0, 0.03, 1.0, 0.5, 0.25)
        expected = 0.03 / np.sqrt(noise.effective_points(np.ones((SIDE, SIDE), bool)))
        assert expected > 5 * 0.03 / SIDE
        assert self.information(noise).standard_errors[0] == pytest.approx(expected, rel=2e-3)

    def test_interval_of_95_percent(self):
        found = self.information(WHITE)
        reach = 1.959964 * 0.03 / SIDE
        ((low, high),) = linear_interval(FREE, np.array([0.8]), found)
        assert (low, high) == pytest.approx((0.8 * np.exp(-reach / 0.8), 0.8 * np.exp(reach / 0.8)), rel=1e-6)

    @pytest.mark.parametrize(("phase", "expected"), [(0.5, (0.5 - 1.96, 0.5 + 1.96)), (2.5, (-np.pi, np.pi))])
    def test_phase_beyond_its_end_goes_on_at_the_other(self, phase, expected):
        free = choose(ParameterSet(effects=(ZLinearity(periodic_um=0.02),)), free=("z-linearity.phase_rad",))
        found = Information(np.eye(1), np.array([np.inf]))
        assert linear_interval(free, np.array([phase]), found)[0] == pytest.approx(expected, abs=1e-4)

    def test_few_degrees_of_freedom_reach_further(self):
        assert Information(np.eye(1), np.array([5.0])).quantiles[0] == pytest.approx(2.570582, rel=1e-6)

    def test_profile_may_rise_by_the_squared_quantile_of_white_noise(self):
        problem = Problem((recording(),), FREE)
        rise = _allowed_rise(problem, place(np.zeros(SIDE**2)), self.jacobian, self.information(WHITE), (WHITE,))
        assert rise[0] == pytest.approx((1.959964 * 0.03) ** 2, rel=1e-6)

    def test_a_direction_is_open_by_its_95_percent_reach(self):
        width = FREE.high - FREE.low
        found = open_directions(FREE, Information(np.diag((0.2 * width) ** 2), np.array([np.inf])))
        assert found[0]["shrinkage_max"] == pytest.approx(1.96 * 0.2 * width[0])
        assert open_directions(FREE, Information(np.diag((0.09 / 1.96 * width) ** 2), np.array([np.inf]))) == []

    def test_what_the_fit_took_from_the_noise_is_given_back(self):
        noise = Noise(0.01, 0.02, 3.0, 0.5, 0.5)
        more = _given_back(noise, np.array([-0.1, -0.2, -0.3]))
        assert (more.white_um, more.correlated_um) == pytest.approx((0.01, 0.02 * np.exp(0.2)))
        assert more.length_um == pytest.approx(3 * np.exp(0.3))
        assert _given_back(noise, np.array([0.1, 0.2, 0.3])) == noise


class TestHoldout:
    def test_what_a_mean_explains_is_explained_on_the_blocks_left_out(self):
        found = hold_out((recording(),), FREE, place(np.full(SIDE**2, 0.01)), TestCertainty.jacobian, (WHITE,))
        assert found.rmse_um == pytest.approx(0, abs=1e-9)
        assert found.buffer_um == 2.0

    def test_points_near_a_block_do_not_help_to_predict_it(self):
        left_out = np.zeros((SIDE, SIDE), bool)
        left_out[10:20, 10:20] = True
        near = _grown(left_out, recording(), 1.0)
        assert near[15, 21] and not near[15, 22]  # 0.5 µm a pixel
        assert near[23, 15] and not near[24, 15]  # 0.25 µm


def test_derivatives_at_a_bound_are_those_beside_it():
    """At the upper end of a range the step goes the other way."""
    rng = np.random.default_rng(0)
    target = HeightMap(np.pad(rng.uniform(1, 3, (12, 12)), 2), 0.5, 0.5)
    pair = prepare(target, target, wall_px=0)

    def derivative(low: float) -> np.ndarray:
        free = choose(ParameterSet(paper=Paper(shrinkage_min=low, shrinkage_max=1.1)), free=("shrinkage_max",))
        problem = Problem((pair,), free)
        return problem.jacobian(problem.at(free.start - (0.05 if low < 0.5 else 0.0)))[0]

    np.testing.assert_allclose(derivative(0.6), derivative(0.4), rtol=1e-6, atol=1e-9)
    assert derivative(0.6).max() > 0.5


@pytest.mark.parametrize("name", ["crosslink_fwhm_xy_um", "exposure_fwhm_z_um", "threshold"])
def test_finite_differences_are_derivatives(name):
    """Against central differences of a step ten times smaller, to a tenth."""
    rng = np.random.default_rng(1)
    target = HeightMap(np.pad(rng.uniform(2, 5, (16, 16)), 3), 0.5, 0.5)
    free = choose(ParameterSet(paper=Paper(threshold=0.4)), free=(name,))
    problem = Problem((prepare(target, target, wall_px=0),), free)
    found = problem.jacobian(problem.at(free.start))[0][:, 0]
    step = 2e-3 * free.start[0]
    above, below = (problem.at(free.start + sign * step).traces[0].heights_um.ravel() for sign in (1, -1))
    expected = (above - below) / (2 * step)
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.1 * np.sqrt(np.mean(expected**2))


class TestDescent:
    def test_the_root_is_that_of_weighted_least_squares(self):
        rng = np.random.default_rng(0)
        jacobian, residual, weights = rng.normal(size=(60, 3)), rng.normal(size=60), rng.uniform(0.1, 1, 60)
        root, right = normal_root([jacobian], place(residual, weights))
        np.testing.assert_allclose(root.T @ root, jacobian.T @ (weights[:, None] * jacobian), atol=1e-12)
        np.testing.assert_allclose(root.T @ right, jacobian.T @ (weights * residual), atol=1e-12)

    def test_on_the_border_both_height_factors_move_as_one(self):
        """The nearest place to (1.1, 0.9) with κ_min ≤ κ_max is (1, 1)."""
        free = choose(ParameterSet(), free=("shrinkage_min", "shrinkage_max"))
        here, wanted = np.array([0.7, 0.95]), np.array([1.1, 0.9])
        step = bounded_step(free, here, (free.low, free.high), np.eye(2), wanted - here, damping=0.0)
        np.testing.assert_allclose(here + step, 1.0, atol=1e-9)

    def test_an_updated_jacobian_explains_the_last_step(self):
        rng = np.random.default_rng(1)
        old, new = (replace(place(rng.normal(size=60)), vector=np.array([value])) for value in (0.9, 1.0))
        (found,) = _secant(FREE, [rng.normal(size=(60, 1))], old, new)
        np.testing.assert_allclose(found @ (new.vector - old.vector), old.residuals[0] - new.residuals[0], atol=1e-12)


def test_a_spike_costs_a_straight_line():
    """2cσ|r| − c²σ² from c = 3 standard deviations on, and the weight cσ/|r|; one curve, without a jump."""
    loss = Huber(0.02)
    assert loss.cost(np.array([0.2])) == pytest.approx((2 * 3 * 10 - 9) * 0.02**2)
    assert loss.cost(np.array([0.06 + 1e-9])) == pytest.approx(0.06**2, rel=1e-6)
    assert loss.weights(np.array([0.2, -0.2])) == pytest.approx([0.3, 0.3])

"""Calibration against parameters that are known."""

from dataclasses import replace

import numpy as np
import pytest

import dlwpredict as dlw
from dlwpredict import designs
from dlwpredict.calibration import calibrate
from dlwpredict.calibration.run import _open_directions
from dlwpredict.calibration.words import OPEN, WEAK, identified, nuisances_um, width_if_square
from dlwpredict.effects import library
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.free import choose, value_of
from dlwpredict.infer.intervals import Intervals
from dlwpredict.infer.objective import Work
from dlwpredict.infer.priors import PARAMETERS
from dlwpredict.infer.recording import prepare
from dlwpredict.noise.covariance import Noise
from dlwpredict.pairing import Pair
from dlwpredict.parameters import Paper, ParameterSet, declarations
from dlwpredict.process import predict

TRUTH = ParameterSet(paper=Paper(0.55, 1.7, 0.42, 6.0, 8.0, 0.74, 0.96))
KAPPAS = ("shrinkage_min", "shrinkage_max")
COMMON = {"pitch_um": 0.5, "margin_um": 4.0}


@pytest.fixture(scope="module")
def air() -> HeightMap:
    return designs.air(size_um=24.0, **COMMON)


@pytest.fixture(scope="module")
def printed(air) -> HeightMap:
    return predict(air, TRUTH)


def noisy(heights: HeightMap, seed: int) -> HeightMap:
    noise = Noise(0.003, 0.02, 1.0, heights.dx_um, heights.dy_um)
    return heights.with_heights(heights.heights_um + noise.simulate(heights.shape, np.random.default_rng(seed)))


class TestLoss:
    @pytest.mark.slow
    def test_a_robust_fit_hardly_feels_spikes(self, air, printed):
        clean, free = noisy(printed, 0), choose(TRUTH, free=KAPPAS)
        spikes = np.random.default_rng(0).random(air.shape) < 0.02
        spiky = clean.with_heights(clean.heights_um + 2.0 * spikes)

        def moved(robust):
            fits = [calibrate([prepare(air, m)], free, robust=robust, profile=False) for m in (clean, spiky)]
            return np.abs(fits[1].end.vector - fits[0].end.vector).max()

        assert moved(True) < 2e-3
        assert moved(True) < 0.2 * moved(False)

    @pytest.mark.slow
    def test_both_methods_find_the_height_factors(self, air, printed):
        free = choose(replace(TRUTH, paper=replace(TRUTH.paper, shrinkage_min=0.6)), free=KAPPAS)
        for method, tolerance in (("fast", 1e-3), ("simplex", 2e-3)):
            found = calibrate([prepare(air, printed)], free, method=method, profile=False)
            np.testing.assert_allclose(found.end.vector, [0.74, 0.96], atol=tolerance)

    @pytest.mark.slow
    def test_the_simplex_ends_where_the_plain_error_is_lowest(self, air, printed):
        """What the likelihood takes for noise of a long correlation, the simplex fits."""
        x = np.broadcast_to(air.x_um, air.shape)
        bent = noisy(printed.with_heights(printed.heights_um * (1 + 0.03 * np.sin(x / 5))), 0)
        fits = [
            calibrate([prepare(air, bent, free_shift=False)], choose(TRUTH, free=KAPPAS), method=method, profile=False)
            for method in ("fast", "simplex")
        ]
        assert fits[1].end.rmse_um() <= fits[0].end.rmse_um() + 1e-6


@pytest.mark.slow
def test_priors_decide_what_the_data_leave_open(air):
    """A flat part cannot tell threshold from focus: with its prior the focus stays, bare it may be anything."""
    flat = air.with_heights(np.where(air.heights_um > 0, 4.0, 0.0))
    free = choose(TRUTH, free=("exposure_fwhm_z_um", "threshold"))
    pair = prepare(flat, noisy(predict(flat, TRUTH), 0))
    known, bare = (calibrate([pair], free, priors=priors, profile=False) for priors in (True, False))
    for found in (known, bare):
        assert not found.identified["exposure_fwhm_z_um"]
        assert any(f"{OPEN}: exposure_fwhm_z_um" in w for w in found.warnings)
    assert any("the data leave open" in w for w in bare.warnings)
    assert known.intervals.sd[0] < 0.5 * bare.intervals.sd[0]
    assert known.end.vector[0] == pytest.approx(1.5, rel=0.3)


@pytest.mark.slow
def test_the_worst_known_has_its_profile_taken_and_the_others_on_demand(air):
    flat = air.with_heights(np.where(air.heights_um > 0, 4.0, 0.0))
    pair = prepare(flat, noisy(predict(flat, TRUTH), 0))
    free = choose(TRUTH, free=("exposure_fwhm_z_um", "threshold"))
    taken = [calibrate([pair], free, profile=profile).intervals.profiled for profile in (False, None, True)]
    assert taken[0] == () and taken[1] == ("exposure_fwhm_z_um",)
    assert set(taken[2]) >= set(taken[1])


@pytest.mark.slow
def test_offset_tilt_and_shift_of_a_relative_map_are_found(air, printed):
    x, y = np.meshgrid(air.x_um, air.y_um)
    tilted = HeightMap(noisy(printed, 0).heights_um - 3.0 + 0.01 * x - 0.004 * y, 0.5, 0.5, "relative")
    found = calibrate([prepare(air, tilted)], choose(TRUTH, free=("crosslink_fwhm_xy_um",)), profile=False)
    low, high = found.intervals.ends[0]
    assert low < 6.0 < high
    moved = nuisances_um(found.end, 0)
    assert (moved["offset"], moved["tilt_x"], moved["tilt_y"]) == pytest.approx((-3.0, 0.16, -0.064), abs=0.02)
    assert abs(moved["shift_x"]) < 0.05


@pytest.mark.slow
def test_a_shift_does_not_bend_the_parameters_where_it_is_free(air, printed):
    moved = printed.heights_um - 0.1 * np.gradient(printed.heights_um, 0.5, axis=1)
    seen, free = noisy(printed.with_heights(moved), 0), choose(TRUTH, free=("exposure_fwhm_xy_um",))
    loose, fixed = (calibrate([prepare(air, seen, free_shift=s)], free, profile=False) for s in (True, False))
    assert nuisances_um(loose.end, 0)["shift_x"] == pytest.approx(0.1, abs=0.02)
    assert nuisances_um(fixed.end, 0) == {}
    assert loose.end.rmse_um() < fixed.end.rmse_um()
    far = printed.heights_um - 0.8 * np.gradient(printed.heights_um, 0.5, axis=1)
    found = calibrate([prepare(air, noisy(printed.with_heights(far), 0))], free, profile=False)
    assert any("against its prediction: align it again" in w for w in found.warnings)


@pytest.mark.slow
def test_effects_of_the_start_are_fitted_too(air):
    curl = library()["curl"]
    truth = replace(TRUTH, effects=(curl(rise_um=0.3),))
    part = noisy(predict(air, truth, as_measured=True), 0)
    start = replace(TRUTH, effects=(curl(rise_um=0.1),))
    found = calibrate([prepare(air, part)], choose(start, free=["shrinkage_min", "curl.rise_um"]), profile=False)
    assert found.free.names == ("shrinkage_min", "curl.rise_um")
    low, high = found.intervals.as_dict()["curl.rise_um"]
    assert low < 0.3 < high and found.identified["curl.rise_um"]
    assert found.parameters.effects[0].rise_um == pytest.approx(0.3, abs=0.05)


@pytest.fixture(scope="module")
def found():
    parts = [
        designs.cin(size_um=28.0, **COMMON),
        designs.air(size_um=28.0, **COMMON),
        designs.stairs(size_um=32.0, feature_um=4.0, **COMMON),
    ]
    pairs = [prepare(part, noisy(predict(part, TRUTH), k), name=f"part {k}") for k, part in enumerate(parts)]
    return calibrate(pairs, choose(ParameterSet()))


@pytest.mark.slow
class TestRecovery:
    def test_residual_is_the_noise(self, found):
        assert found.end.rmse_um() == pytest.approx(0.0202, rel=0.08)
        assert found.end.rmse_um() < found.holdout.rmse_um < 1.2 * found.end.rmse_um()

    def test_noise_is_found(self, found):
        for estimate, recording in zip(found.noises, found.recordings, strict=True):
            noise = estimate.model.even
            points = Noise(0.003, 0.02, 1.0, 0.5, 0.5).effective_points(recording.used)
            assert noise.sigma_um == pytest.approx(0.0202, rel=0.15)
            assert noise.effective_points(recording.used) == pytest.approx(points, rel=0.5)

    def test_intervals_hold_the_truth(self, found):
        values = np.array([value_of(TRUTH, name) for name in found.free.names])
        outside = (values < found.intervals.ends[:, 0]) | (values > found.intervals.ends[:, 1])
        reach = (found.intervals.ends[:, 1] - found.intervals.ends[:, 0]) / 2
        assert outside.sum() <= 1  # of seven at 95 %
        assert (np.abs(found.end.vector - values) < 2 * reach).all()

    def test_what_is_identified_is_near(self, found):
        for name in ("shrinkage_min", "shrinkage_max", "crosslink_fwhm_xy_um", "crosslink_fwhm_z_um"):
            assert found.identified[name]
            assert value_of(found.parameters, name) == pytest.approx(value_of(TRUTH, name), rel=0.15)

    def test_what_is_badly_known_is_said(self, found):
        said = next(w for w in found.warnings if OPEN in w or WEAK in w)
        assert said.partition(": ")[2].startswith("exposure_fwhm_z_um ") and "crosslink" not in said.partition(" µm")[0]
        assert set(found.intervals.profiled) <= {"exposure_fwhm_z_um"}
        assert len(found.warnings) <= 3 and all(len(w.split(": ")) >= 2 for w in found.warnings)

    def test_bounds_and_intervals_stand_in_the_parameters(self, found):
        assert set(found.parameters.intervals) == set(found.parameters.bounds) == set(declarations(Paper))


class TestPixels:
    """The same target, taken as smooth between its pixels and as squares."""

    @pytest.mark.slow
    def test_width_of_the_focus_depends_on_the_reading_as_is_said(self):
        chirp, width = designs.cin(size_um=24.0, **COMMON), TRUTH.paper.exposure_fwhm_xy_um
        squares = HeightMap(np.kron(chirp.heights_um, np.ones((9, 9))), 0.5 / 9, 0.5 / 9)
        printed = chirp.with_heights(predict(squares, TRUTH).heights_um[4::9, 4::9])
        read, free = prepare(chirp, printed), choose(TRUTH, free=("exposure_fwhm_xy_um",))
        found, doubted = (calibrate([one], free) for one in (replace(read, unsaid_px=0.0), read))
        assert found.end.vector[0] > 1.15 * width
        assert width_if_square(found.end.vector[0], 0.5) == pytest.approx(width, rel=0.05)
        assert any("how pixels of 0.5 µm are read" in w for w in found.warnings)
        low, high = doubted.intervals.ends[0]  # nobody says whether the recording holds points or means
        assert low < width < high and not any("are read" in w for w in doubted.warnings)

    @pytest.mark.slow
    def test_a_smooth_target_needs_no_finer_pixels(self):
        fine = designs.cin(size_um=24.0, pitch_um=0.5 / 3, margin_um=4.0)
        chirp, printed = (HeightMap(part.heights_um[1::3, 1::3], 0.5, 0.5) for part in (fine, predict(fine, TRUTH)))
        found = calibrate([prepare(chirp, noisy(printed, 0))], choose(TRUTH, free=("exposure_fwhm_xy_um",)))
        low, high = found.intervals.ends[0]
        assert low < TRUTH.paper.exposure_fwhm_xy_um < high


@pytest.mark.slow
def test_rounding_does_not_lift_the_lowest_factor_above_a_fixed_highest_one(air, printed):
    fixed = replace(TRUTH, paper=replace(TRUTH.paper, shrinkage_min=0.3, shrinkage_max=0.30983617388769175))
    found = calibrate([prepare(air, printed)], choose(fixed, free=("shrinkage_min",)), profile=False)
    assert found.parameters.paper.shrinkage_min == found.parameters.paper.shrinkage_max


@pytest.mark.slow
def test_same_seed_same_result(air, printed):
    pair, free = prepare(air, noisy(printed, 0)), choose(ParameterSet(), free=KAPPAS)
    first, second = (calibrate([pair], free, seed=3) for _ in range(2))
    np.testing.assert_array_equal(first.end.vector, second.end.vector)
    np.testing.assert_array_equal(first.intervals.ends, second.intervals.ends)


@pytest.mark.slow
def test_work_is_counted_and_places_are_shown(air, printed):
    seen = []
    work = Work(seen=seen.append)
    pair, free = prepare(air, noisy(printed, 0)), choose(TRUTH, free=KAPPAS)
    found = calibrate([pair], free, work=work, profile=False)
    assert found.work["fit"] == found.work["all"] == work.predictions > 0
    assert found.end.vector.tolist() in [fit.vector.tolist() for fit in seen]


@pytest.mark.slow
def test_a_fit_never_ends_above_its_start(air, printed, monkeypatch):
    """The rough fit has another loss: where the start costs less than its end, the descent begins at the start."""
    from dlwpredict.calibration import run

    def astray(recordings, free, *rest, **options):
        recordings, first = rough(recordings, free, *rest, **options)
        far = replace(first, vector=free.allowed(0.9 * first.vector), traces=(None,))
        return recordings, replace(objective_at(first, far.vector), jacobian=first.jacobian)

    def objective_at(first, vector):
        return run.Objective(first.data).at(first.free, vector)

    rough = run.rough
    monkeypatch.setattr(run, "rough", astray)
    found = calibrate([prepare(air, noisy(printed, 0))], choose(TRUTH, free=KAPPAS), profile=False)
    assert found.end.cost <= found.start.cost


class TestWords:
    free = choose(ParameterSet(), free=("exposure_fwhm_z_um", "shrinkage_max"))

    def known(self, sd: list[float], ends: list[list[float]], priors=PARAMETERS) -> list[bool]:
        found = Intervals(self.free.names, np.array(sd), np.array(ends))
        return identified(self.free, np.array([1.5, 0.9]), found, priors).tolist()

    def test_what_rests_on_its_prior_is_not_identified(self):
        """The focus is known to 40 % beforehand, 0.6 µm."""
        ends = [[0.7, 3.0], [0.89, 0.91]]
        assert self.known([0.55, 0.005], ends) == [False, True]
        assert self.known([0.3, 0.005], ends) == self.known([0.55, 0.005], ends, {}) == [True, True]

    def test_neither_is_what_spans_half_of_its_bounds(self):
        assert self.known([0.1, 0.3], [[1.3, 1.7], [0.5, 1.1]]) == [True, False]

    def test_a_direction_is_open_by_its_95_percent_reach(self):
        width = self.free.high - self.free.low
        sd = np.array([0.2, 0.01]) * width
        (found,) = _open_directions(self.free, sd, np.eye(2))
        assert found == {"exposure_fwhm_z_um": pytest.approx(1.96 * 0.2 / np.sqrt(1.04) * width[0], rel=1e-3)}
        assert _open_directions(self.free, 0.1 * sd, np.eye(2)) == []
        (both,) = _open_directions(self.free, 0.2 * width, np.array([[1, -0.999], [-0.999, 1]]))
        assert list(both) == list(self.free.names) and min(both.values()) < 0

    def test_what_nothing_tells_is_open_and_no_more_than_its_bounds(self):
        (found,) = _open_directions(self.free, np.array([np.inf, 1e-3]), np.eye(2))
        width = self.free.high - self.free.low
        assert found["exposure_fwhm_z_um"] == pytest.approx(1.96 * width[0], rel=1e-3)


def test_the_process_is_learned_on_finer_pixels_than_effects_are_looked_for(monkeypatch):
    """Of a large map; the focus is what wider pixels tell least of."""
    given = []
    monkeypatch.setattr("dlwpredict.calibration.calibrate", lambda recordings, *of, **how: given.extend(recordings))
    part = HeightMap(np.pad(np.full((280, 280), 5.0), 10), 0.25, 0.25)
    dlw.calibrate([(part, part)])
    assert [one.target.dx_um for one in given] == [0.25]
    assert Pair.of(part, part, ParameterSet()).pitch_um == 0.5

"""Calibration against parameters that are known."""

from dataclasses import replace

import numpy as np
import pytest

from dlwpredict import designs
from dlwpredict.calibrate import Problem, calibrate, near_walls, prepare
from dlwpredict.calibrate.descend import descend
from dlwpredict.calibrate.fast import refocused
from dlwpredict.calibrate.loss import Huber, Square
from dlwpredict.calibrate.recordings import check_points, coarser, with_nuisances
from dlwpredict.calibrate.simplex import simplex
from dlwpredict.calibrate.straight import bending, bent, straight
from dlwpredict.calibrate.trace import trace
from dlwpredict.calibrate.words import width_if_square
from dlwpredict.effects import library
from dlwpredict.errors import InputError, ResultError
from dlwpredict.flat import choose, fittable, value_of, with_values
from dlwpredict.heightmap import HeightMap
from dlwpredict.model.levels import Levels
from dlwpredict.noise import Noise
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


class TestFlat:
    def test_values_go_in_and_come_out(self):
        changed = with_values(ParameterSet(), {"threshold": 0.4, "shrinkage_max": 0.9})
        assert (value_of(changed, "threshold"), value_of(changed, "shrinkage_max")) == (0.4, 0.9)

    @pytest.mark.parametrize("name", list(library()))
    def test_every_effect_is_reached_by_its_flat_names(self, name):
        process = ParameterSet(effects=(library()[name](),))
        names = [n for n in fittable(process) if n.startswith(f"{name}.")]
        wanted = [f"{name}.{key}" for key, (_, d) in declarations(library()[name]).items() if d.fitted]
        assert names == wanted
        free = choose(process)
        np.testing.assert_array_equal(free.values(free.parameters(free.start)), free.start)

    def test_what_effects_share_moves_once_and_in_all_of_them(self):
        """With one value for each, of which the model takes the largest, the others have no derivative: a trap."""
        memory, fading = library()["dose-memory"](gain=0.1), library()["vignetting"](strength=0.1, conversion=0.6)
        process = ParameterSet(effects=(memory, fading), bounds={"vignetting.conversion": (0.1, 0.9)})
        free = choose(process)
        assert [name for name in free.names if name.endswith("conversion")] == ["dose-memory.conversion"]
        k = free.index("dose-memory.conversion")
        assert (free.start[k], free.low[k], free.high[k]) == (0.6, 0.1, 0.9)
        assert [effect.conversion for effect in free.parameters(free.start).effects] == [0.6, 0.6]
        assert "dose-memory.conversion" not in choose(process, fix=["vignetting.conversion"]).names
        assert choose(process, free=["vignetting.conversion"]).names == ("dose-memory.conversion",)
        for names in (["vignetting.conversion"], ["dose-memory.conversion", "threshold"]):
            with pytest.raises(InputError, match="named for both"):
                choose(process, fix=["dose-memory.conversion"], free=names)
        with pytest.raises(InputError, match="found curl"):
            choose(process, fix=["curl.conversion"])

    @pytest.mark.parametrize(
        ("chosen", "said"),
        [
            ({"fix": ["kappa"]}, "--fix: found kappa"),
            ({"free": ["colour"]}, "--free: found colour"),
            ({"fix": list(declarations(Paper))}, "every parameter is fixed"),
            ({"fix": ["threshold"], "free": ["threshold"]}, "named for both"),
        ],
    )
    def test_wrong_choices_are_refused_by_name(self, chosen, said):
        with pytest.raises(InputError, match=said):
            choose(ParameterSet(), **chosen)

    def test_start_outside_its_bounds_is_refused(self):
        with pytest.raises(InputError, match=r"threshold: start value 0.5, allowed by the bounds: 0.1 to 0.3"):
            choose(ParameterSet(bounds={"threshold": (0.1, 0.3)}))


class TestTrace:
    def test_is_the_prediction(self, air, printed):
        np.testing.assert_array_equal(trace(air, TRUTH, Levels(1)).heights_um, printed.heights_um)

    @pytest.mark.parametrize(
        ("name", "value", "work"),
        [("shrinkage_min", 0.6, 0.0), ("crosslink_fwhm_z_um", 6.0, 0.8), ("threshold", 0.5, 1.0)],
    )
    def test_what_lies_upstream_is_taken_over_and_nothing_else(self, air, name, value, work):
        numerics = Levels(1)
        changed = with_values(TRUTH, {name: value})
        again = trace(air, changed, numerics, trace(air, TRUTH, numerics))
        np.testing.assert_array_equal(again.heights_um, predict(air, changed).heights_um)
        assert again.work == pytest.approx(work)


class TestRecordings:
    def test_walls_are_masked_and_slopes_are_not(self):
        wall = designs.stairs(size_um=32.0, feature_um=0.0, **COMMON)
        slope = HeightMap(np.pad(5 + np.sin(np.arange(80) / 4)[None, :].repeat(80, 0), 0), 0.5, 0.5)
        assert near_walls(wall)[32, 22:26].all()  # between the first and the second plateau
        assert not near_walls(slope)[5:-5, 5:-5].any()

    def test_border_of_a_part_that_fills_the_map_is_a_wall(self):
        full = HeightMap(np.full((20, 30), 2.0), 0.5, 0.5)
        assert not near_walls(full)[3:-3, 3:-3].any()
        assert near_walls(full)[[0, 2, -1], 5:-5].all() and near_walls(full)[5:-5, [0, 2, -1]].all()

    def test_filled_and_missing_points_do_not_count(self, air, printed):
        heights = printed.heights_um.copy()
        heights[20:24, 20:24] = np.nan
        filled = np.zeros(air.shape, dtype=bool)
        filled[30:34, 30:34] = True
        used = prepare(air, HeightMap(heights, 0.5, 0.5, filled=filled), wall_px=0).used
        assert used.sum() == air.heights_um.size - 32

    def test_another_grid_is_refused_with_a_hint(self, air):
        with pytest.raises(InputError, match=r"rec: grid: .* \(use align\)"):
            prepare(air, HeightMap(np.zeros((9, 9)), 0.5, 0.5), name="rec")

    def test_an_empty_target_is_refused(self, air):
        with pytest.raises(InputError, match="t: heights: nothing written"):
            prepare(air.with_heights(np.zeros(air.shape)), air, target_name="t")

    def test_too_few_points_are_refused(self, air, printed):
        heights = np.full(air.shape, np.nan)
        heights[20:30, 20:30] = printed.heights_um[20:30, 20:30]
        with pytest.raises(ResultError, match=r"100 measured points on the part .* at least 500"):
            check_points([prepare(air, air.with_heights(heights), wall_px=0)])

    def test_coarse_pixels_keep_the_mean_height(self, air, printed):
        pair = coarser(prepare(air, printed, wall_px=0), 2)
        assert pair.target.dx_um == 1.0
        assert pair.target.heights_um.mean() == pytest.approx(air.heights_um.mean())
        assert pair.measured.heights_um.mean() == pytest.approx(printed.heights_um.mean())


class TestStraight:
    def test_there_and_back(self):
        free = choose(TRUTH)
        np.testing.assert_allclose(bent(free, straight(free, free.start)), free.start, rtol=1e-12)

    def test_derivatives_are_those_of_the_map(self):
        free = choose(TRUTH)
        here = straight(free, free.start)
        numeric = [(bent(free, here + 1e-6 * e) - bent(free, here - 1e-6 * e)) / 2e-6 for e in np.eye(len(here))]
        np.testing.assert_allclose(bending(free, free.start), np.array(numeric).T, atol=1e-7)

    def test_another_focus_keeps_the_rise_of_flat_tops(self, air, printed):
        problem = Problem((prepare(air, printed),), choose(TRUTH))
        wide = problem.free.values(with_values(TRUTH, {"exposure_fwhm_z_um": 5.0, "threshold": 0.47}))
        again = refocused(problem, wide, problem.free.start)
        np.testing.assert_array_equal(again[:2], problem.free.start[:2])
        rise = problem.free.index("threshold")
        assert straight(problem.free, again)[rise] == pytest.approx(straight(problem.free, wide)[rise])
        assert again[rise] < 0.47


class TestDescent:
    def test_both_methods_find_the_height_factors(self, air, printed):
        problem = Problem(
            (prepare(air, printed),), choose(replace(TRUTH, paper=replace(TRUTH.paper, shrinkage_min=0.6)), free=KAPPAS)
        )
        start = problem.at(problem.free.start)
        fast = descend(problem, start, gain=1e-9, iterations=20)
        np.testing.assert_allclose(fast.vector, [0.74, 0.96], atol=1e-6)
        np.testing.assert_allclose(simplex(problem, start).vector, [0.74, 0.96], atol=2e-3)

    def test_stops_at_the_bound_that_is_in_the_way(self, air, printed):
        base = ParameterSet(paper=replace(TRUTH.paper, shrinkage_min=0.8), bounds={"shrinkage_min": (0.77, 0.9)})
        problem = Problem((prepare(air, printed),), choose(base, free=KAPPAS))
        found = descend(problem, problem.at(problem.free.start), gain=1e-9, iterations=20)
        assert found.vector[0] == 0.77

    def test_least_height_factor_never_passes_the_largest(self, air, printed):
        taller = printed.with_heights(air.heights_um * 0.8 + 0.02 * (printed.heights_um < 5.8))
        problem = Problem((prepare(air, taller),), choose(TRUTH, free=KAPPAS))
        low, high = descend(problem, problem.at(problem.free.start), gain=1e-9, iterations=20).vector
        assert low <= high

    def test_offset_tilt_and_shift_of_a_relative_map_cost_nothing(self, air, printed):
        x, y = np.meshgrid(air.x_um, air.y_um)
        tilted = HeightMap(printed.heights_um - 3.0 + 0.01 * x - 0.004 * y, 0.5, 0.5, "relative")
        problem = Problem((prepare(air, tilted),), choose(TRUTH))
        assert problem.at(problem.free.start).rmse_um < 1e-9
        known = Problem((prepare(air, replace(tilted, height_reference="substrate")),), choose(TRUTH))
        assert known.at(known.free.start).rmse_um > 1

    def test_free_shift_takes_out_what_registration_left(self, air, printed):
        gradient = np.gradient(printed.heights_um, 0.5, axis=1)
        moved = prepare(air, printed.with_heights(printed.heights_um - 0.04 * gradient))
        problem = Problem((with_nuisances(moved, printed.heights_um),), choose(TRUTH))
        point = problem.at(problem.free.start)
        np.testing.assert_allclose(point.nuisances[0], [0.04, 0.0], atol=1e-9)
        assert point.rmse_um < 1e-9

    def test_derivatives_are_taken_once_per_place(self, air, printed):
        """Another loss and freed shifts change what is made of them, not the prediction's derivatives."""
        problem = Problem((prepare(air, printed.with_heights(1.01 * printed.heights_um)),), choose(TRUTH))
        point = problem.at(problem.free.start)
        problem.jacobian(point)
        other = problem.with_loss_scaled(point, robust=True).with_free_shift(point)
        moved = other.compared(point.vector, point.traces)
        spent = other.work
        anew = Problem(other.recordings, other.free, other.loss)
        np.testing.assert_array_equal(other.jacobian(moved)[0], anew.jacobian(anew.at(point.vector))[0])
        assert other.work == spent
        elsewhere = problem.at(0.99 * point.vector, point)
        spent = problem.work
        assert np.abs(problem.jacobian(elsewhere)[0] - problem.jacobian(point)[0]).max() > 0
        assert problem.work > spent


class TestLoss:
    def test_huber_is_the_square_for_honest_residuals(self):
        r = np.array([-0.02, 0.05, 0.059])
        assert Huber(0.02).cost(r) == pytest.approx(Square().cost(r))
        np.testing.assert_array_equal(Huber(0.02).weights(r), 1.0)

    def test_robust_fit_hardly_feels_spikes(self, air, printed):
        clean, free = noisy(printed, 0), choose(TRUTH, free=KAPPAS)
        spikes = np.random.default_rng(0).random(air.shape) < 0.02
        spiky = clean.with_heights(clean.heights_um + 2.0 * spikes)

        def moved(robust):
            fits = [calibrate([prepare(air, m)], free, robust=robust, profile=False) for m in (clean, spiky)]
            return np.abs(fits[1].point.vector - fits[0].point.vector).max()

        assert moved(True) < 1e-3
        assert moved(True) < 0.1 * moved(False)


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
        assert found.point.rmse_um == pytest.approx(0.0202, rel=0.08)
        assert found.point.rmse_um < found.holdout.rmse_um < 1.2 * found.point.rmse_um

    def test_noise_is_found(self, found):
        for noise, recording in zip(found.noises, found.problem.recordings, strict=True):
            points = Noise(0.003, 0.02, 1.0, 0.5, 0.5).effective_points(recording.used)
            assert noise.sigma_um == pytest.approx(0.0202, rel=0.15)
            assert noise.effective_points(recording.used) == pytest.approx(points, rel=0.5)

    def test_intervals_hold_the_truth(self, found):
        values = np.array([value_of(TRUTH, name) for name in found.free.names])
        outside = (values < found.intervals[:, 0]) | (values > found.intervals[:, 1])
        reach = (found.intervals[:, 1] - found.intervals[:, 0]) / 2
        assert outside.sum() <= 1  # of seven at 95 %
        assert (np.abs(found.point.vector - values) < 2 * reach).all()

    def test_what_is_identified_is_near(self, found):
        for name in ("shrinkage_min", "shrinkage_max", "crosslink_fwhm_xy_um", "crosslink_fwhm_z_um"):
            assert found.identified[name]
            assert value_of(found.parameters, name) == pytest.approx(value_of(TRUTH, name), rel=0.15)

    def test_what_is_badly_known_is_said(self, found):
        said = [w.split()[0] for w in found.warnings if "weakly" in w or "not identified" in w]
        assert said == ["exposure_fwhm_z_um"]
        assert found.profiled == ("exposure_fwhm_z_um",)

    def test_bounds_and_intervals_stand_in_the_parameters(self, found):
        assert set(found.parameters.intervals) == set(found.parameters.bounds) == set(declarations(Paper))


def test_flat_part_cannot_tell_threshold_from_focus(air):
    flat = air.with_heights(np.where(air.heights_um > 0, 4.0, 0.0))
    free = choose(TRUTH, free=("exposure_fwhm_z_um", "threshold"))
    found = calibrate([prepare(flat, noisy(predict(flat, TRUTH), 0))], free)
    assert not all(found.identified.values())
    assert any("is not identified" in w for w in found.warnings)
    assert any("the data leave open" in w for w in found.warnings)


class TestPixels:
    """The same target, taken as smooth between its pixels and as squares."""

    def test_width_of_the_focus_depends_on_the_reading_as_is_said(self):
        chirp, width = designs.cin(size_um=24.0, **COMMON), TRUTH.paper.exposure_fwhm_xy_um
        squares = HeightMap(np.kron(chirp.heights_um, np.ones((9, 9))), 0.5 / 9, 0.5 / 9)
        printed = chirp.with_heights(predict(squares, TRUTH).heights_um[4::9, 4::9])
        found = calibrate([prepare(chirp, printed)], choose(TRUTH, free=("exposure_fwhm_xy_um",)))
        assert found.point.vector[0] > 1.15 * width
        assert width_if_square(found.point.vector[0], 0.5) == pytest.approx(width, rel=0.05)
        assert any("how pixels of 0.5 µm are read" in w for w in found.warnings)

    def test_a_smooth_target_needs_no_finer_pixels(self):
        fine = designs.cin(size_um=24.0, pitch_um=0.5 / 3, margin_um=4.0)
        chirp, printed = (HeightMap(part.heights_um[1::3, 1::3], 0.5, 0.5) for part in (fine, predict(fine, TRUTH)))
        found = calibrate([prepare(chirp, noisy(printed, 0))], choose(TRUTH, free=("exposure_fwhm_xy_um",)))
        low, high = found.intervals[0]
        assert low < TRUTH.paper.exposure_fwhm_xy_um < high


def test_same_seed_same_result(air, printed):
    pair, free = prepare(air, noisy(printed, 0)), choose(ParameterSet(), free=KAPPAS)
    first, second = (calibrate([pair], free, seed=3) for _ in range(2))
    np.testing.assert_array_equal(first.point.vector, second.point.vector)
    np.testing.assert_array_equal(first.intervals, second.intervals)


def test_a_descent_that_leads_astray_leaves_the_start(air, printed, monkeypatch):
    """The loss is scaled anew on the way, so a fit can end where the start would have cost less."""
    monkeypatch.setattr("dlwpredict.calibrate.run.fast", lambda problem, start, seed: problem.at(0.9 * start.vector))
    monkeypatch.setattr("dlwpredict.calibrate.run.descend", lambda problem, point, **_: point)
    free = choose(TRUTH, fix=[name for name in declarations(Paper) if name not in KAPPAS])
    found = calibrate([prepare(air, noisy(printed, 0))], free, profile=False)
    np.testing.assert_array_equal(found.point.vector, free.start)

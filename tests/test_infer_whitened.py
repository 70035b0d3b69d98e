"""Recordings in whitened space: columns are exact derivatives, of what registration shows; where their fits end."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import ndimage

from dlwpredict import designs
from dlwpredict.effects import library
from dlwpredict.heightmap import HeightMap, Instrument
from dlwpredict.infer.descend import descend
from dlwpredict.infer.fitter import Fitter, Start, far_widths, from_paper
from dlwpredict.infer.free import Free, choose
from dlwpredict.infer.intervals import deviations
from dlwpredict.infer.model import freed
from dlwpredict.infer.noises import plane
from dlwpredict.infer.null import Null
from dlwpredict.infer.objective import Fit, Nuisances, Objective
from dlwpredict.infer.objective import step as step_of
from dlwpredict.infer.priors import LEVELLING, NUISANCES, SHIFTS, bounded
from dlwpredict.infer.recording import coarser, doubted, prepare
from dlwpredict.infer.registration import Registered, nuisances_fitted, registered
from dlwpredict.infer.rows import Rows
from dlwpredict.infer.whitened import STEEPEST, Whitened, displacements, gradient, shifted, steepness
from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.unevenness import Uneven
from dlwpredict.noise.whitening import Whitener
from dlwpredict.numerics.smoothing import block_mean
from dlwpredict.parameters import Paper, ParameterSet, Readings
from dlwpredict.process import predict

NOISE = Noise(0.002, 0.004, 1.0, 0.4, 0.4)


def item_of(target: HeightMap, measured: HeightMap, wall_px: int = 3) -> Whitened:
    return Whitened.of(doubted(prepare(target, measured, wall_px=wall_px)), Uneven(NOISE))


def sampled(fine: np.ndarray, right: int = 0, up: int = 0) -> np.ndarray:
    """Return every fourth height of a map that is displaced by so many of its pixels."""
    rows, cols = (slice(16 + first, n - 16 + first, 4) for first, n in zip((up, -right), fine.shape, strict=True))
    return fine[rows, cols]


def deviations_of_shift(found: Registered) -> np.ndarray:
    """Return the standard deviations of a shift along x and y, µm."""
    return np.linalg.norm(found.spread[[found.item.nuisances.index(name) for name in SHIFTS]], axis=1)


class TestShift:
    @pytest.mark.parametrize("shift_um", [0.08, -0.5, 1.3])
    def test_a_wave_is_moved_however_far(self, shift_um):
        """By cubics with slopes of fourth order: an error of (2π/10)⁴/384 + (2π/10)⁵/240 at ten pixels a period."""
        x, k = (np.arange(80) - 39.5) * 0.4, 2 * np.pi / 4
        wave, bound = np.tile(np.sin(k * x), (20, 1)), (0.4 * k) ** 4 / 384 + (0.4 * k) ** 5 / 240
        grid = HeightMap(wave, 0.4, 0.4)
        expected = np.sin(k * (x - shift_um))
        np.testing.assert_allclose(shifted(wave, grid, (shift_um, 0, 0, 0))[0][10, 8:-8], expected[8:-8], atol=bound)
        across = shifted(wave.T, HeightMap(wave.T, 0.4, 0.4), (0, -shift_um, 0, 0))[0][8:-8, 10]
        np.testing.assert_allclose(across, expected[8:-8], atol=bound)

    def test_what_is_wider_is_read_nearer_to_the_centre(self):
        """The rim shows what the prediction has at x − u, u = shift + scale·x, along y as along x."""
        x, k = (np.arange(80) - 39.5) * 0.4, 2 * np.pi / 4
        wave, bound = np.tile(np.sin(k * x), (20, 1)), (0.4 * k) ** 4 / 384 + (0.4 * k) ** 5 / 240
        expected = np.sin(k * (x - 0.3 - 0.02 * x))
        wider = shifted(wave, HeightMap(wave, 0.4, 0.4), (0.3, 0.0, 0.02, 0.0))[0]
        np.testing.assert_allclose(wider[10, 8:-8], expected[8:-8], atol=bound)
        longer = shifted(wave.T, HeightMap(wave.T, 0.4, 0.4), (0.0, -0.3, 0.0, 0.02))[0]
        np.testing.assert_allclose(longer[8:-8, 10], expected[8:-8], atol=bound)

    def test_a_slope_is_that_of_a_wave(self):
        x, k = (np.arange(80) - 39.5) * 0.4, 2 * np.pi / 4
        wave = np.tile(np.sin(k * x), (20, 1))
        bound = k * (0.4 * k) ** 4 / 29  # leading error of the fourth-order difference
        np.testing.assert_allclose(gradient(wave, 0.4, 1)[10, 5:-5], (k * np.cos(k * x))[5:-5], atol=bound)

    def test_a_wall_is_no_steeper_than_walls_are(self):
        heights = np.zeros((20, 20))
        heights[:, 10:] = 50.0
        grid = HeightMap(heights, 0.4, 0.2)
        ramp = steepness(np.fromfunction(lambda i, j: 0.3 * 0.4 * j - 0.4 * 0.2 * i, (20, 20)), grid)
        assert steepness(heights, grid).max() == STEEPEST
        np.testing.assert_allclose(ramp[4:-4, 4:-4], 0.5, atol=1e-9)


class TestMeans:
    @pytest.mark.parametrize("shift_um", [0.0, 0.3])
    def test_what_align_has_read_is_a_mean_over_pixels(self, shift_um):
        """A wave of ten pixels is lower by sin(kp/2)/(kp/2), to (kp)⁶/2000; of a map at points nothing changes."""
        x, k, high = (np.arange(60) - 29.5) * 0.4, 2 * np.pi / 4, designs.cin(size_um=24, pitch_um=0.4, margin_um=0)
        wave, inner = np.tile(np.sin(k * x), (60, 1)), slice(10, -10)
        aligned = replace(high, instrument=Instrument(pitch_um=0.2))
        item = replace(item_of(high, aligned), place=(shift_um, 0.0, 0, 0))
        plain = replace(item, recording=replace(item.recording, width_px=0.0))
        lower = np.sinc(k * 0.4 / 2 / np.pi)
        bound = (0.4 * k) ** 6 / 2000
        shown, points = (one.moved(wave)[inner, inner] for one in (item, plain))
        np.testing.assert_allclose(shown, lower * points, atol=bound)
        assert np.ptp(points - shown) > 100 * bound

    def test_working_pixels_are_means_of_target_and_recording_alike(self):
        target = designs.cin(size_um=24, pitch_um=0.4, margin_um=4)
        own = prepare(target, replace(target, instrument=Instrument(pitch_um=0.3)))
        assert (own.width_px, coarser(own, 2).width_px, prepare(target, target).width_px) == (1.0, 0.5, 0.0)
        assert (own.unsaid_px, coarser(prepare(target, target), 2).unsaid_px) == (0.0, 0.5)


class TestNuisances:
    def test_columns_of_what_is_followed_are_the_derivatives_of_the_moved_map(self):
        """Exactly: by columns that are only nearly so, registration creeps where features are few pixels wide."""
        target = designs.cin(size_um=20, pitch_um=0.5, margin_um=2)
        printed = np.random.default_rng(5).normal(size=target.shape)
        item, at, step = item_of(target, target), np.array([0.2, -0.15, 0.013, -0.008]), 1e-6
        columns = dict(zip(item.nuisances, replace(item, place=at).nuisance_maps(printed), strict=True))
        for name, direction in zip(("shift_x", "shift_y", "scale_x", "scale_y"), np.eye(4), strict=True):
            ahead, behind = (replace(item, place=at + s * step * direction).moved(printed) for s in (1, -1))
            np.testing.assert_allclose(columns[name], (ahead - behind) / (2 * step), atol=1e-7)

    def test_displacements_are_those_of_a_turn_and_a_scale(self):
        grid = HeightMap(np.zeros((5, 7)), 0.5, 0.25)
        turned, x, y = displacements(grid)[2], grid.x_um[6], grid.y_um[1]
        np.testing.assert_allclose(turned[:, 1, 6], (-y, x))
        np.testing.assert_allclose(displacements(grid)[3:, :, 1, 6], [(x, 0), (0, y), (y, 0)])

    def test_registration_goes_no_further_than_a_pixel_at_once(self):
        item = item_of(*2 * (designs.cin(size_um=20, pitch_um=0.5, margin_um=2),))
        far = item.step_in(np.array([9.0 * name.startswith("shift") for name in item.nuisances]))
        assert item.moved_by(far).place[:2] == (0.5, 0.5)
        assert item.moved_by(far).moved_by(far).place[:2] == (1.0, 1.0)
        near = replace(item, place=(0.1, -0.2, 0, 0)).moved_by(0.01 * far)
        assert near.place[:2] == pytest.approx((0.19, -0.11))
        assert dict(zip(near.nuisances, near.known(), strict=True))["shift_x"] == near.place[0]

    def test_a_scale_moves_the_rim_by_no_more_than_a_pixel_at_once(self):
        """Half of 24 µm from the centre."""
        target = designs.cin(size_um=20, pitch_um=0.5, margin_um=2)
        item = item_of(target, replace(target, instrument=Instrument(scale=0.98)))
        small, far = (
            item.step_in(np.array([a * name.startswith("scale") for name in item.nuisances])) for a in (1e-3, 1)
        )
        assert small == pytest.approx([0, 0, 0.012, 0.012])
        assert item.moved_by(small).place == pytest.approx((0, 0, 1e-3, 1e-3))
        assert item.moved_by(far).moved_um == pytest.approx([0, 0, 0.5, 0.5])

    def test_registration_finds_a_part_several_pixels_away(self):
        target = designs.air(size_um=20, pitch_um=0.4, margin_um=4, seed=3)
        heights = predict(target, ParameterSet()).heights_um
        moved = shifted(heights, target, (1.1, -0.7, 0, 0))[0]
        away = registered(item_of(target, target.with_heights(moved), wall_px=6), heights)
        assert away.item.place[:2] == pytest.approx((1.1, -0.7), abs=1e-4)
        assert np.mean(away.residual**2) < 1e-4

    @pytest.mark.parametrize(
        ("kind", "shape", "moved"),
        [("stairs", {"size_um": 22, "feature_um": 2.5, "count": 3}, (1, 0)), ("air", {"size_um": 20}, (11, -7))],
    )
    def test_beside_walls_a_part_is_registered_as_well_as_elsewhere(self, kind, shape, moved):
        """Printed on fine pixels and displaced by whole ones; treads of six pixels are all beside walls."""
        fine = getattr(designs, kind)(**shape, pitch_um=0.1, margin_um=4)
        printed = predict(fine, ParameterSet()).heights_um
        target, seen_um = HeightMap(sampled(fine.heights_um), 0.4, 0.4), sampled(printed, *moved)
        found = registered(item_of(target, target.with_heights(seen_um)), sampled(printed))
        off_um = np.subtract(found.item.place[:2], np.multiply(moved, 0.1))
        left_um = (seen_um - found.item.moved(sampled(printed)))[found.item.recording.used]
        assert np.all(np.abs(off_um) < deviations_of_shift(found))
        assert np.sqrt(np.mean(left_um**2)) < 0.001

    def test_a_scale_is_followed_where_an_alignment_may_have_taken_the_print_s(self):
        """A part that is 1.2 % narrower than its prediction; a scale within the certificate is taken to first order."""
        target = designs.air(size_um=40, pitch_um=0.4, margin_um=4, seed=3)
        heights = predict(target, ParameterSet()).heights_um
        seen = target.with_heights(shifted(heights, target, (0.3, 0.1, -0.012, -0.01))[0])
        left_open, certified = (
            registered(item_of(target, replace(seen, instrument=Instrument(scale=scale)), wall_px=6), heights)
            for scale in (0.985, 1.0)
        )
        assert left_open.item.place == pytest.approx((0.3, 0.1, -0.012, -0.01), abs=2e-4)
        assert certified.item.place[2:] == (0, 0)
        assert np.mean(left_open.residual**2) < 0.01 * np.mean(certified.residual**2)

    def test_where_a_recording_lies_costs_what_its_other_nuisances_leave(self):
        """And what the prior asks for the shift there; a step that is still to come is promised, not counted."""
        target = designs.air(size_um=20, pitch_um=0.4, margin_um=2, seed=3)
        heights = predict(target, ParameterSet()).heights_um
        seen = target.with_heights(heights + 0.01 * target.heights_um)
        item = replace(item_of(target, seen), place=(0.3, -0.2, 0, 0))
        others = tuple(name for name in item.nuisances if name not in ("shift_x", "shift_y"))
        fixed = replace(item, recording=replace(item.recording, nuisances=others))
        here, there = (nuisances_fitted(one, heights) for one in (item, fixed))
        prior = sum((s / NUISANCES["shift_x"]) ** 2 for s in item.place[:2])
        assert here.cost == pytest.approx(there.cost + prior, rel=1e-6)
        assert here.residual @ here.residual < 0.9 * there.cost

    def test_nuisances_are_those_of_dense_least_squares_with_a_row_for_each_prior(self):
        target = designs.air(size_um=20, pitch_um=0.4, margin_um=2, seed=3)
        heights = predict(target, ParameterSet()).heights_um
        noise = NOISE.simulate(target.shape, np.random.default_rng(4))
        item = replace(item_of(target, target.with_heights(heights + noise)), place=(0.1, -0.05, 0, 0))
        columns, sds = item.white(item.nuisance_maps(heights)), [NUISANCES[name] for name in item.nuisances]
        known = np.isfinite(sds)
        rows = np.diag(1 / np.array(sds))[known]
        stacked = np.vstack([columns, rows])
        goal = np.concatenate([item.columns(heights)[0], -rows @ item.known()])
        expected = np.linalg.lstsq(stacked, goal, rcond=None)[0]
        np.testing.assert_allclose(nuisances_fitted(item, heights).coefficients, expected, rtol=1e-5, atol=1e-9)

    def test_of_levelling_only_what_is_free_has_columns(self):
        target = designs.air(size_um=20, pitch_um=0.4, margin_um=2, seed=3)
        item, free = item_of(target, target), ("offset", "tilt_y", "shift_x")
        item = replace(item, recording=replace(item.recording, nuisances=free))
        heights = predict(target, ParameterSet()).heights_um
        maps, columns = item.nuisance_maps(heights), item.columns(heights)[1]
        np.testing.assert_allclose(columns, item.white(maps), atol=1e-9)
        np.testing.assert_allclose(maps[1], np.broadcast_to(2 * target.y_um[:, None] / target.size_um[1], target.shape))

    @pytest.mark.parametrize("start_um", [-1.2, -0.8, 0.6])
    def test_registration_never_leads_uphill(self, start_um):
        """Of stairs with treads of six pixels hardly a point counts beside the part, and a linear step means little."""
        target = designs.stairs(size_um=20, feature_um=2.5, pitch_um=0.4, margin_um=4)
        heights = predict(target, ParameterSet()).heights_um
        seen = target.with_heights(heights + NOISE.simulate(target.shape, np.random.default_rng(2)))
        item = replace(item_of(target, seen), place=(start_um, 0.0, 0, 0))
        assert registered(item, heights).cost <= nuisances_fitted(item, heights).cost

    def test_no_wall_is_read_wherever_it_is_printed(self):
        """Two pixels of a part's rim gone: to the points that count it makes no difference, nor to their slopes."""
        target = designs.air(size_um=20, pitch_um=0.4, margin_um=4, seed=3)
        item = replace(item_of(target, target), place=(0.15, -0.1, 0, 0))
        heights = predict(target, ParameterSet()).heights_um
        shrunk = np.where(ndimage.binary_erosion(target.heights_um > 0, iterations=2), heights, 0.0)
        used = item.recording.used
        np.testing.assert_array_equal(item.moved(shrunk)[used], item.moved(heights)[used])
        there, here = (item.nuisance_maps(one)[:, used] for one in (shrunk, heights))
        np.testing.assert_array_equal(there, here)

    def test_a_flank_that_pixels_resolve_is_read(self):
        """Beside the middle of fine rings, which counts as a wall; a parabola from beside it is off by 30 nm."""
        target = designs.cin(size_um=20.4, pitch_um=0.4, margin_um=2, height_um=2.4, period_min_um=2.6)
        item = item_of(target, target)
        heights, beside = predict(target, ParameterSet()).heights_um, (slice(20, 40), slice(20, 40))
        assert not item.recording.used[beside].all()
        moved = replace(item, place=(0.0, -0.1, 0, 0)).moved(heights)
        np.testing.assert_array_equal(moved[beside], shifted(heights, target, (0, -0.1, 0, 0))[0][beside])

    def test_what_is_registered_is_the_change_with_nuisances_as_they_are(self):
        """F ↦ f − ∇f·u is linear: by hand, of two maps and of their difference."""
        target = designs.air(size_um=20, pitch_um=0.4, margin_um=2, seed=3)
        item = replace(item_of(target, target), place=(0.12, -0.07, 0, 0))
        first, second = np.random.default_rng(0).normal(size=(2, *target.shape))
        values = np.array([0.01 * k for k in range(len(item.nuisances))])
        lateral = np.array([0.0 if name in LEVELLING else v for name, v in zip(item.nuisances, values, strict=True)])

        def shown(heights):
            return item.moved(heights) + np.tensordot(lateral, item.nuisance_maps(heights), axes=1)

        np.testing.assert_allclose(item.registered(second - first, values), shown(second) - shown(first), atol=1e-9)


def test_a_prior_draws_the_whole_shift_and_not_only_its_last_step():
    """Two and a half standard deviations remain in its row: what was registered before counts."""
    target = designs.air(size_um=20, pitch_um=0.4, margin_um=2, seed=3)
    heights = predict(target, ParameterSet()).heights_um
    seen = target.with_heights(shifted(heights, target, (0.25, 0, 0, 0))[0])
    objective, free = Objective((item_of(target, seen),)), choose(ParameterSet())
    found = objective.at(free, free.start)
    (item,), own = found.data, found.residual[found.rows.nuisance_priors(0)]
    row = [item.nuisances[k] for k in bounded(item.nuisances)].index("shift_x")
    assert item.place[:2] == pytest.approx((0.25, 0.0), abs=0.01)
    assert own[row] == pytest.approx(-item.place[0] / NUISANCES["shift_x"], rel=0.02)


def test_a_plane_is_an_offset_and_a_tilt_along_either_side():
    offset, right, up = plane(HeightMap(np.zeros((4, 5)), 0.5, 0.25))
    assert (offset.min(), right[0, -1], right[-1, -1], up[0, 0], up[0, -1]) == (1, 0.4, 0.4, 0.375, 0.375)


@pytest.mark.parametrize("louder", [1.0, 2.0])
def test_a_parameter_is_as_uncertain_as_noise_numerics_and_priors_make_it(louder):
    """The mean of 144 heights with white noise of 5 nm, that may be louder: 5/12 nm times that, and 0.4 nm of numerics.

    Another parameter that a prior alone tells, and one that nothing tells.
    """
    used, rows = np.ones((12, 12), bool), Rows((144,), (2,), 1)
    whitener = Whitener.of(used, Uneven(Noise(0.005, 0.0, 1.0, 1.0, 1.0)))
    draws = np.zeros((147, 4000), np.float32)
    draws[:144] = louder * np.random.default_rng(0).standard_normal((144, 4000))
    mean, prior = np.pad(whitener @ np.full(144, 0.005**2 / 144), (0, 3)), np.append(np.zeros(146), 0.4)
    item = SimpleNamespace(
        recording=SimpleNamespace(points=144, used=used, read_px=0.0, unsaid_px=0.0), whitener=whitener
    )
    estimators = np.column_stack([mean, prior, 0 * mean])
    fitted = SimpleNamespace(
        estimators=estimators,
        data=[item],
        rows=rows,
        residual=np.zeros(147),
        vector=np.zeros(3),
        parameters=ParameterSet(),
    )
    expected = [np.hypot(louder * 0.005 / 12, 0.0004), 0.4, np.inf]
    assert deviations(fitted, Null(draws)) == pytest.approx(expected, rel=0.03)
    unit = np.column_stack([mean / np.linalg.norm(mean), 0 * mean])
    assert Null(draws).spread(fitted, unit) == pytest.approx([np.hypot(louder, 0.4 * 12 / 5), 0.0], rel=0.03)


def test_derivatives_are_those_of_what_registration_shows():
    """Of a print that lies displaced, turned and stretched: that by the focus's width is a tenth off without it."""
    target = designs.air(size_um=24, pitch_um=0.4, margin_um=2, seed=3)
    x, y = np.meshgrid(target.x_um, target.y_um)
    heights, free = predict(target, ParameterSet()).heights_um, choose(ParameterSet())
    right, up = gradient(heights, 0.4, 1), -gradient(heights, 0.4, 0)
    seen = heights - right * (0.15 - 2e-3 * y + 3e-3 * x) - up * (-0.1 + 2e-3 * x)
    objective = Objective((item_of(target, target.with_heights(seen)),))
    found = objective.differentiated(objective.at(free, free.start))
    assert found.data[0].place[:2] == pytest.approx((0.15, -0.1), abs=0.02)
    for k, name in enumerate(free.names):
        step = step_of(free, k, found.vector)
        moved = objective.at(free, found.vector + step * np.eye(len(free.names))[k]).traces
        changed = replace(found, traces=moved).predicted_um(0) - found.predicted_um(0)
        expected = found.data[0].white(changed) / step
        assert np.abs(found.jacobian[found.rows.of(0), k] - expected).max() < 1e-3 * np.abs(expected).max()
        if name == "exposure_fwhm_xy_um":
            alone = found.data[0].white(moved[0].heights_um - found.traces[0].heights_um) / step
            assert np.linalg.norm(alone - expected) > 0.1 * np.linalg.norm(expected)


@pytest.mark.parametrize("seed", [4, 6])
def test_pixels_are_no_part_of_the_width(seed):
    """A focus of 0.5 µm printed on squares of 0.4 µm and seen on pixels of 0.4 µm is found as wide as it is."""
    truth = ParameterSet(paper=Paper(exposure_fwhm_xy_um=0.5), readings=Readings(pixels="squares"))
    target = designs.air(size_um=24, pitch_um=0.4, margin_um=2, seed=3)
    fine = HeightMap(np.kron(target.heights_um, np.ones((4, 4))), 0.1, 0.1)
    printed = block_mean(predict(fine, ParameterSet(paper=truth.paper)).heights_um, (4, 4))
    noise = Noise(0.002, 0.002, 0.8, 0.4, 0.4)
    noisy = printed + noise.simulate(printed.shape, np.random.default_rng(seed))
    item = Whitened.of(doubted(prepare(target, target.with_heights(noisy))), Uneven(noise))
    found = Fitter(Objective((item,)), choose(truth)).best(Start(truth))
    place = found.free.index("exposure_fwhm_xy_um")
    assert abs(found.vector[place] - 0.5) < 3 * np.linalg.norm(found.estimators[:, place])


class Misled:
    """Residual 1 + u, with a derivative of the wrong sign: every step that it promises climbs."""

    explained = 0.0

    def at(self, free, vector, near=None):
        layout, none = Rows((1,), (0,), 0), (np.zeros((1, 0)),)
        nothing = Nuisances(layout, none, (np.zeros((0, 0)),))
        return Fit((), free, vector, (), layout, 10 * (1 + vector), nothing, (), np.zeros((1, 1)))

    def differentiated(self, now):
        return replace(now, jacobian=np.array([[10.0]]))


def test_a_descent_never_climbs_even_by_wrong_derivatives():
    objective, free = Misled(), Free(ParameterSet(), ("u",), np.array([-5.0]), np.array([5.0]))
    begun = objective.differentiated(objective.at(free, np.array([0.3])))
    assert descend(objective, begun).vector == 0.3


@pytest.mark.slow
def test_of_quick_fits_the_lowest_counts_and_it_is_not_converged_where_it_does_not_matter():
    target = designs.air(size_um=20, pitch_um=0.5, margin_um=3)
    truth = ParameterSet(paper=Paper(0.6, 1.5, 0.4, 6.0, 7.0, 0.7, 0.95))
    far = replace(truth, paper=replace(truth.paper, exposure_fwhm_z_um=8.0, threshold=0.1))
    objective = Objective((item_of(target, predict(target, truth)),))

    def quick(*starts):
        fitter = Fitter(objective, choose(truth))
        (found,) = fitter.contest([[Start(one) for one in starts]]).values()
        assert not fitter.known and len(fitter.quick) == 1
        return found.cost

    alone = quick(truth)
    assert quick(far, truth) == quick(truth, far) == alone < quick(far)


def test_where_a_width_went_far_a_fit_begins_again_from_the_paper_and_typical_effects():
    far = ParameterSet(paper=Paper(exposure_fwhm_z_um=6.0), effects=(library()["curl"](rise_um=-0.01),))
    near = replace(far, paper=Paper(exposure_fwhm_z_um=1.6, threshold=0.3))
    free = freed(far, choose(ParameterSet()))

    def again(process):
        return from_paper(free, free.values(process))

    assert again(near) is None and far_widths(free, free.values(near)) == {}
    assert far_widths(free, free.values(far)) == {"exposure_fwhm_z_um": -4.5}
    found = free.parameters(again(far))
    assert found.paper == Paper() and found.effects[0].rise_um == pytest.approx(-0.2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "name", "weak", "strong"),
    [(18, "dose-proximity", {"gain": 0.05}, {"gain": 0.2}),
     (19, "shrinkage-nonlinearity", {"exponent": 1.225}, {"exponent": 1.9})],
)  # fmt: skip
def test_the_best_fit_comes_to_rest_where_one_from_the_truth_does(seed, name, weak, strong):
    """Along valleys that bend: from the paper's defaults χ² used to stay 130 to 840 higher."""
    rng = np.random.default_rng(seed)
    ranges = ((0.4, 0.8), (1, 2.5), (0.3, 0.6), (4, 9), (4, 9), (0.6, 0.75), (0.85, 1))
    paper = Paper(*(rng.uniform(*limits) for limits in ranges))
    truth, begun = (library()[name](**values) for values in (strong, weak))
    target, noise = designs.cin(size_um=24, pitch_um=0.5, margin_um=3), Noise(0.002, 0.004, 1.0, 0.5, 0.5)
    process = ParameterSet(paper=paper, effects=(truth,))
    heights = predict(target, process).heights_um + noise.simulate(target.shape, rng)
    objective = Objective((Whitened.of(prepare(target, target.with_heights(heights)), Uneven(noise)),))
    like = choose(ParameterSet())
    found, best = (Fitter(objective, like).best(Start(s)) for s in (ParameterSet(effects=(begun,)), process))
    assert found.free.names == freed(process, like).names
    assert found.cost == pytest.approx(best.cost, abs=1)


@pytest.mark.slow
def test_a_valley_beside_the_paper_is_found_from_where_the_smaller_model_ended():
    """The seven alone answer to a memory of the dose with a far-off threshold; from there χ² ended 880 higher."""
    rng, memory = np.random.default_rng(0), library()["dose-memory"]
    ranges = ((0.4, 0.8), (1, 2.5), (0.3, 0.6), (4, 9), (4, 9), (0.6, 0.75), (0.85, 1))
    paper = Paper(*(rng.uniform(*limits) for limits in ranges))
    truth = ParameterSet(paper=paper, effects=(memory(gain=0.15, length_um=8, conversion=0.5),))
    target, noise = designs.cin(size_um=30, pitch_um=0.5, margin_um=4), Noise(0.002, 0.004, 1.0, 0.5, 0.5)
    heights = predict(target, truth).heights_um + noise.simulate(target.shape, rng)
    objective = Objective((Whitened.of(prepare(target, target.with_heights(heights)), Uneven(noise)),))
    fitter, like = Fitter(objective, choose(ParameterSet())), choose(ParameterSet())
    alone = fitter.best(Start(ParameterSet()))
    found = fitter.best(Start(replace(alone.parameters, effects=(memory(gain=0.05),)), alone))
    best = Fitter(objective, like).best(Start(truth))
    assert found.cost == pytest.approx(best.cost, abs=1)

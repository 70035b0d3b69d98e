"""Intervals and errors on what was left out, where they can be derived on paper."""

from dataclasses import replace

import numpy as np
import pytest

from dlwpredict import designs
from dlwpredict.effects import library
from dlwpredict.heightmap import HeightMap, Instrument
from dlwpredict.infer import held_out
from dlwpredict.infer.descend import descend
from dlwpredict.infer.free import Free, choose
from dlwpredict.infer.intervals import NORMAL, considered, curved, deviations, held, intervals, linear, profile
from dlwpredict.infer.noises import compressed, noises, plane
from dlwpredict.infer.null import COHERENT_UM, Null, numerical
from dlwpredict.infer.objective import Fit, Nuisances, Objective, Work
from dlwpredict.infer.recording import prepare
from dlwpredict.infer.rows import Rows
from dlwpredict.infer.whitened import Whitened
from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.estimate import NoiseEstimate
from dlwpredict.noise.evened import Unevenness
from dlwpredict.noise.unevenness import Uneven
from dlwpredict.numerics.smoothing import means_over
from dlwpredict.parameters import Paper, ParameterSet, Readings
from dlwpredict.process import predict

SIDE = 40
KAPPAS = ("shrinkage_min", "shrinkage_max")
WHITE = Noise(0.03, 0.0, 1.0, 0.5, 0.5)
FREE = choose(ParameterSet(), free=("shrinkage_max",))
ONE = np.ones((1, SIDE, SIDE))


def known(noise: Noise) -> NoiseEstimate:
    """Return a noise model that is no estimate."""
    return NoiseEstimate(Uneven(noise), np.zeros(3), np.zeros((3, 3)), "repeats", Unevenness(0.0, 0.0), {})


class Exact(NoiseEstimate):
    """Draws of noise from the model itself."""

    def draw(self, rng: np.random.Generator) -> Uneven:
        return self.model


def exact(noise: Noise) -> Exact:
    return Exact(**vars(known(noise)))


def fit_of(maps: np.ndarray, residual_um: np.ndarray, noise: Noise, free: Free) -> Fit:
    """Return a fit of a linear model whose derivatives are these maps, at a place that leaves this residual."""
    target = HeightMap(np.full((SIDE, SIDE), 2.0), 0.5, 0.5)
    measured = predict(target, free.base).heights_um + residual_um
    recording = replace(prepare(target, target.with_heights(measured), wall_px=0), nuisances=(), unsaid_px=0.0)
    item = Whitened.of(recording, Uneven(noise))
    layout = Rows((recording.points,), (0,), 0)
    nothing = Nuisances(layout, (np.zeros((recording.points, 0)),), (np.zeros((0, 0)),))
    seen = Objective((item,)).at(free, free.start)
    left = item.white(residual_um)
    return Fit((item,), free, free.start, seen.traces, layout, left, nothing, (np.zeros(0),), item.white(maps))


def null_of(fit: Fit, noise: Noise, draws: int = 400) -> Null:
    return Null.of(fit.data, fit.rows, [exact(noise)], 0, draws=draws)


class TestDeviations:
    """One parameter, derivative 1 at every one of n points: it is a mean, and its error σ/√n."""

    @pytest.mark.parametrize("noise", [WHITE, Noise(0.0, 0.03, 1.0, 0.5, 0.5)])
    def test_of_a_mean_is_the_textbook(self, noise):
        """Correlated noise leaves fewer points; what two honest computations differ by remains."""
        fit = fit_of(ONE, np.zeros((SIDE, SIDE)), noise, FREE)
        points = noise.effective_points(np.ones((SIDE, SIDE), bool))
        expected = np.hypot(0.03 / np.sqrt(points), COHERENT_UM)
        assert deviations(fit, null_of(fit, noise))[0] == pytest.approx(expected, rel=0.12)

    def test_blocks_that_scatter_more_than_the_noise_model_says_are_believed(self):
        quarters = 0.05 * np.sign(np.subtract.outer(np.arange(SIDE), np.arange(SIDE)) + 0.5)
        even, scattered = (fit_of(ONE, left, WHITE, FREE) for left in (np.zeros((SIDE, SIDE)), quarters))
        assert deviations(scattered, null_of(even, WHITE))[0] > 2 * deviations(even, null_of(even, WHITE))[0]

    def test_nothing_is_known_of_what_changes_nothing(self):
        free = choose(ParameterSet(), free=("shrinkage_min", "shrinkage_max"))
        fit = fit_of(np.concatenate([0 * ONE, ONE]), np.zeros((SIDE, SIDE)), WHITE, free)
        sd = deviations(fit, null_of(fit, WHITE))
        assert np.isinf(sd[0]) and np.isfinite(sd[1])
        np.testing.assert_array_equal(linear(free, free.start, sd)[0], [free.low[0], free.high[0]])

    @pytest.mark.slow
    def test_95_percent_intervals_hold_the_truth_in_95_percent(self):
        """Of slope and mean, in correlated noise: of 400 intervals, one in twenty misses, give or take."""
        noise, rng = Noise(0.01, 0.03, 1.0, 0.5, 0.5), np.random.default_rng(0)
        free = choose(ParameterSet(), free=("shrinkage_min", "shrinkage_max"))
        slope = np.broadcast_to(np.linspace(-1, 1, SIDE), (SIDE, SIDE))
        maps = np.stack([np.ones((SIDE, SIDE)), slope])
        empty = fit_of(maps, np.zeros((SIDE, SIDE)), noise, free)
        null, held = null_of(empty, noise), []
        for drawn in noise.simulate_many((SIDE, SIDE), rng, 200):
            fit = replace(empty, residual=empty.data[0].white(drawn))
            change = fit.estimators.T @ fit.residual
            fit = replace(fit, residual=fit.residual - fit.jacobian @ change)
            held.append(np.abs(change) < NORMAL * deviations(fit, null))
        assert 0.92 <= np.mean(held) <= 0.995


class TestNumerical:
    @pytest.mark.parametrize("share", [1.0, 0.25])
    def test_a_column_whose_rows_are_priors_sees_less_of_it(self, share):
        """A difference c·m of the shape m has c·|d|² along a column of data rows d: |d| times that of a whole one."""
        shape = np.cos(np.arange(SIDE) / 3)[None, None] * ONE
        fit = fit_of(shape, 0 * ONE[0], WHITE, FREE)
        whole = fit.jacobian / np.linalg.norm(fit.jacobian, axis=0)
        expected = COHERENT_UM / 0.03 * np.sqrt(share * len(whole))
        assert numerical(fit, np.sqrt(share) * whole)[0] == pytest.approx(expected, rel=1e-6)
        assert numerical(fit, 0 * whole)[0] == 0


class TestLinear:
    def test_is_taken_on_the_logarithm_of_what_is_positive(self):
        reach = 1.96 * 0.05
        expected = 0.8 * np.exp(-reach / 0.8), 0.8 * np.exp(reach / 0.8)
        assert linear(FREE, np.array([0.8]), np.array([0.05]))[0] == pytest.approx(expected, rel=1e-6)

    @pytest.mark.parametrize(("phase", "expected"), [(0.5, (0.5 - 1.96, 0.5 + 1.96)), (2.5, (-np.pi, np.pi))])
    def test_a_phase_beyond_its_end_goes_on_at_the_other(self, phase, expected):
        effect = library()["z-linearity"](periodic_um=0.02)
        free = choose(ParameterSet(effects=(effect,)), free=("z-linearity.phase_rad",))
        assert linear(free, np.array([phase]), np.ones(1))[0] == pytest.approx(expected, abs=1e-4)


@pytest.fixture(scope="module")
def objective() -> Objective:
    target = designs.air(size_um=24.0, pitch_um=0.5, margin_um=4.0)
    printed = predict(target, ParameterSet(paper=Paper(0.5, 1.5, 0.5, 7.0, 7.0, 0.7, 0.9)))
    noise = 0.1 * np.random.default_rng(0).normal(size=target.shape)
    recording = prepare(target, printed.with_heights(printed.heights_um + noise))
    return Objective((Whitened.of(replace(recording, nuisances=()), Uneven(replace(WHITE, white_um=0.1))),), {})


def lowest(objective: Objective, free: Free) -> Fit:
    return descend(objective, objective.differentiated(objective.at(free, free.start)), gain=1e-4)


class TestProfile:
    @pytest.mark.parametrize("names", [("shrinkage_min", "shrinkage_max"), ("shrinkage_max",)])
    def test_is_the_linear_interval_where_the_model_is_linear(self, objective, names):
        """Heights are linear in both κ."""
        fit = lowest(objective, choose(ParameterSet(), free=names))
        k = len(names) - 1
        sd = float(np.linalg.norm(fit.estimators[:, k]))
        low, high = profile(objective, fit, k, sd)
        assert (fit.vector[k] - low, high - fit.vector[k]) == pytest.approx((NORMAL * sd, NORMAL * sd), rel=0.1)

    def test_ends_where_the_cost_has_risen_by_what_is_allowed(self, objective):
        fit = lowest(objective, choose(ParameterSet(), free=("crosslink_fwhm_z_um", *KAPPAS)))
        sd = float(np.linalg.norm(fit.estimators[:, 0]))
        for end in profile(objective, fit, 0, sd):
            rise = held(objective, fit, 0, end, 1e-3) - fit.cost
            assert end in (fit.free.low[0], fit.free.high[0]) or np.sqrt(rise) == pytest.approx(NORMAL, rel=0.15)

    @pytest.mark.parametrize("ridge", [0.1, 0.5, 0.9])
    def test_is_found_along_a_ridge_that_ends(self, objective, monkeypatch, ridge):
        """√(rise in cost) is a tenth of what is allowed along the ridge, and rises steeply from its end on."""
        fit = lowest(objective, choose(ParameterSet(), free=("shrinkage_max",)))
        value, low = float(fit.vector[0]), float(fit.free.low[0])
        sd, end, asked = value - low, value - ridge * (value - low), []
        allowed = (NORMAL * sd / np.linalg.norm(fit.estimators[:, 0])) ** 2

        def cost(_objective, _fit, _k, place, _exact):
            asked.append(place)
            along, beyond = (value - place) / (value - end), (end - place) / (end - low)
            return fit.cost + allowed * (0.1 * min(along, 1) + max(9 * beyond, 0)) ** 2

        monkeypatch.setattr("dlwpredict.infer.intervals.held", cost)
        found, _ = profile(objective, fit, 0, sd)
        assert found == pytest.approx(end - 0.1 * (end - low), abs=0.02 * (end - low))
        assert len([place for place in asked if place < value]) <= 8

    @pytest.mark.slow
    def test_is_taken_where_a_straight_line_will_not_do_and_it_was_asked_for(self, objective):
        fit = lowest(objective, choose(ParameterSet(), free=("exposure_fwhm_z_um", "shrinkage_min")))
        null = Null.of(fit.data, fit.rows, [exact(replace(WHITE, white_um=0.1))], 0)
        straight = intervals(fit, null)
        assert curved(fit, straight.sd) == [0]
        assert intervals(fit, null, objective).profiled == ("exposure_fwhm_z_um",)
        assert intervals(fit, null, objective, ["shrinkage_min"]).profiled == straight.profiled == ()


class TestHeldOut:
    def test_what_a_mean_explains_is_explained_on_the_blocks_left_out(self):
        fit = fit_of(ONE, np.full((SIDE, SIDE), 0.01), WHITE, FREE)
        found = held_out.blocks(fit, 2)
        assert found.rmse_um == pytest.approx(0, abs=1e-9)
        assert len(found.points) == 4 and found.points.sum() == SIDE**2

    def test_what_lies_in_one_block_only_is_not(self):
        """A dent in a quarter, which a column of its own explains, is not foreseen from the three others."""
        dent = np.zeros((SIDE, SIDE))
        dent[: SIDE // 2, : SIDE // 2] = 1
        free = choose(ParameterSet(), free=("shrinkage_min", "shrinkage_max"))
        bent = fit_of(np.stack([ONE[0], dent]), 0.3 * dent, WHITE, free)
        assert bent.estimators.T @ bent.residual == pytest.approx([0.0, 0.3], abs=1e-9)
        assert held_out.blocks(bent, 2).rmse_um == pytest.approx(0.15, rel=1e-6)

    def test_what_a_parameter_would_explain_beyond_its_range_is_not_foreseen(self):
        fit = fit_of(ONE, np.full((SIDE, SIDE), 0.01), WHITE, FREE)
        ended = replace(fit, free=replace(fit.free, high=fit.vector))
        assert held_out.blocks(ended, 2).rmse_um == pytest.approx(0.01, rel=1e-9)

    def test_small_maps_are_not_cut_unless_they_must_be(self):
        fit = fit_of(ONE, np.zeros((SIDE, SIDE)), WHITE, FREE)
        assert held_out.blocks(fit) is None
        assert len(held_out.blocks(fit, width_um=10.0).points) == 4  # those of another fit, to be compared with
        assert held_out.cuts(fit) == [(1, 1)] and held_out.cuts(fit, 2) == [(2, 2)]

    def test_points_near_a_block_do_not_help_to_predict_it(self):
        fit = fit_of(ONE, np.zeros((SIDE, SIDE)), WHITE, FREE)
        for inside, near in held_out._block_masks(fit.data[0], (2, 2)):
            assert inside.sum() == (SIDE / 2) ** 2
            assert near.sum() == (SIDE / 2 + held_out.BUFFER_UM / 0.5) ** 2

    def test_one_recording_leaves_none_to_learn_from(self):
        assert held_out.recordings(fit_of(ONE, np.zeros((SIDE, SIDE)), WHITE, FREE)) is None


class TestNoises:
    def test_are_those_of_the_residual_beside_a_design(self):
        """A tilt ten times the noise is no noise where it is in the design."""
        noise = Noise(0.01, 0.0, 1.0, 0.5, 0.5)
        fit = fit_of(ONE, np.zeros((SIDE, SIDE)), noise, FREE)
        recording = fit.data[0].recording
        design = plane(recording.target)
        left = noise.simulate((SIDE, SIDE), np.random.default_rng(0)) + 0.3 * design[1]
        (found,) = noises([recording], [left], [design])
        assert found.source == "residual"
        assert found.model.even.sigma_um == pytest.approx(0.01, rel=0.15)

    def test_repeats_are_taken_where_there_are_any(self):
        target = HeightMap(np.full((SIDE, SIDE), 2.0), 0.5, 0.5)
        rng, bump = np.random.default_rng(0), np.sin(np.arange(SIDE) / 3) * ONE[0]
        first, second = (target.with_heights(2 + bump + 0.02 * rng.normal(size=(SIDE, SIDE))) for _ in range(2))
        recording = prepare(target, first, wall_px=0)
        (found,) = noises([recording], [first.heights_um - 2], [plane(target)], repeats=[[second]])
        assert found.source == "repeats"
        assert found.model.even.sigma_um == pytest.approx(0.02, rel=0.15)

    @pytest.mark.parametrize(("pitch_um", "grain_um"), [(0.75, 0.45), (0.3, 0.3), (0.2, 0.0)])
    def test_a_map_that_was_read_off_has_the_grain_of_the_instrument(self, pitch_um, grain_um):
        """Of pixels of 0.5 µm: 0.6 of the wider pitch; but a mean over more than four of the instrument's has none."""
        target = HeightMap(np.full((SIDE, SIDE), 2.0), 0.5, 0.5)
        left = WHITE.simulate(target.shape, np.random.default_rng(1))
        read = HeightMap(2 + left, 0.5, 0.5, instrument=Instrument("confocal", None, pitch_um))
        (found,) = noises([prepare(target, read, wall_px=0)], [left], [plane(target)])
        assert found.model.even.grain_um == pytest.approx(grain_um)

    def test_recordings_of_one_instrument_share_the_kind_of_correlation(self):
        """A map of 24 x 24 points takes Matérn's noise for Gaussian, a larger one does not; not so beside an AFM's."""
        kind = Noise(0.002, 0.02, 1.0, 0.5, 0.5, 1.5)
        draws = [kind.simulate((side, side), np.random.default_rng(7)) for side in (90, 24)]

        def smoothnesses(*instruments: Instrument) -> list[float]:
            maps = [HeightMap(2 + left, 0.5, 0.5, instrument=k) for left, k in zip(draws, instruments, strict=True)]
            recordings = [prepare(one.with_heights(np.full(one.shape, 2.0)), one, wall_px=0) for one in maps]
            found = noises(recordings, draws, [plane(one) for one in maps])
            return [noise.model.even.smoothness for noise in found]

        assert smoothnesses(Instrument("confocal"), Instrument("afm")) == [1.5, np.inf]
        assert smoothnesses(Instrument("confocal"), Instrument("confocal")) == [1.5, 1.5]

    @pytest.mark.parametrize("scar_um", [0.0, 0.3])
    def test_what_repeats_differ_by_where_they_were_laid_is_no_noise(self, scar_um):
        """A sideways shift, as of trace and retrace where the feedback lags; and a scar of the repeat."""
        target = HeightMap(np.full((SIDE, SIDE), 2.0), 0.5, 0.5)
        rng, place = np.random.default_rng(0), np.broadcast_to(np.linspace(0, 6 * np.pi, SIDE), (SIDE, SIDE))
        left, again = 0.01 * rng.normal(size=(2, SIDE, SIDE))
        again[SIDE // 2] += scar_um
        first = HeightMap(2 + np.cos(place) + left, 0.5, 0.5, instrument=Instrument("afm", 0.0))
        recording, second = prepare(target, first, wall_px=0), first.with_heights(2 + np.cos(place - 0.05) + again)
        (found,) = noises([recording], [left], [plane(target)], repeats=[[second]])
        assert found.model.even.sigma_um == pytest.approx(0.01, rel=0.15)
        assert found.model.row_um < 0.002

    def test_several_repeats_tell_more_than_one(self):
        rng = np.random.default_rng(3)
        target = HeightMap(np.full((SIDE, SIDE), 2.0), 0.5, 0.5)
        maps = [target.with_heights(2 + 0.01 * rng.normal(size=target.shape)) for _ in range(4)]
        recording, residual = prepare(target, maps[0], wall_px=0), maps[0].heights_um - 2
        (found,) = noises([recording], [residual], [plane(target)], repeats=[maps[1:]])
        assert found.model.even.sigma_um == pytest.approx(0.01, rel=0.1) and found.source == "repeats"

    def test_a_design_holds_no_more_than_half_of_what_tells_the_noise(self):
        used = np.ones((SIDE, SIDE), dtype=bool)
        assert len(compressed(np.random.default_rng(0).normal(size=(9, SIDE, SIDE)), used, 4)) == 4

    def test_a_design_is_kept_to_what_is_independent(self):
        used = np.ones((SIDE, SIDE), dtype=bool)
        ramp = np.broadcast_to(np.arange(SIDE) - 19.5, (SIDE, SIDE))
        kept = compressed(np.stack([ONE[0], ramp, 3 * ramp - 2, 0 * ramp]), used, 9)
        assert len(kept) == 2
        np.testing.assert_allclose(np.einsum("kij,lij->kl", kept, kept) / SIDE**2, np.eye(2), atol=1e-9)


@pytest.mark.parametrize("reading", ["points", "squares"])
def test_intervals_hold_how_pixels_may_be_read(reading):
    """Without noise, prints of points and of squares are fitted √3 standard deviations of the doubt off."""
    truth = ParameterSet(paper=Paper(exposure_fwhm_xy_um=0.6), readings=Readings(pixels=reading))
    target = designs.air(size_um=16, pitch_um=0.4, margin_um=2, seed=3)
    printed = target.with_heights(predict(target, truth).heights_um)
    free = choose(replace(truth, readings=Readings(pixels="either")), free=("exposure_fwhm_xy_um",))
    recording = replace(prepare(target, printed), unsaid_px=0.0)
    objective = Objective((Whitened.of(recording, Uneven(Noise(0.01, 0.0, 1.0, 0.5, 0.5))),), {})
    fitted = descend(objective, objective.differentiated(objective.at(free, free.start)))
    off, work = abs(fitted.vector[0] - 0.6), Work()
    assert off == pytest.approx(np.sqrt(3) * considered(fitted, work)[0], rel=0.15) and off > 0.02
    assert 0 < work.predictions <= 1


def test_whether_an_instrument_reads_means_or_points_is_considered():
    """A blur that was fitted to points as if they were means is off by √3 standard deviations of that doubt."""
    blurred = ParameterSet(effects=(library()["instrument-blur"](fwhm_um=1.2),))
    target = designs.cin(size_um=24, pitch_um=0.5, margin_um=2, height_um=2, period_min_um=4)
    printed = predict(target, blurred, as_measured=True)
    aligned = replace(printed, instrument=Instrument(pitch_um=0.4))
    free = choose(blurred, free=("instrument-blur.fwhm_um",))
    objective = Objective((Whitened.of(prepare(target, aligned), Uneven(Noise(0.01, 0.0, 1.0, 0.5, 0.5))),), {})
    fitted = descend(objective, objective.differentiated(objective.at(free, free.start)))
    off = 1.2 - fitted.vector[0]
    assert off == pytest.approx(np.sqrt(3) * considered(fitted, Work())[0] * (0.5 / 0.4) ** 2, rel=0.15) and off > 0.02


def test_of_a_map_that_was_not_aligned_nobody_says_whether_it_holds_means():
    """A camera's means that were fitted as points make a blur √3 standard deviations of that doubt wider."""
    blurred = ParameterSet(effects=(library()["instrument-blur"](fwhm_um=1.2),))
    target = designs.cin(size_um=24, pitch_um=0.5, margin_um=2, height_um=2, period_min_um=4)
    printed = predict(target, blurred, as_measured=True)
    seen = printed.with_heights(means_over(printed.heights_um, 1.0))
    free = choose(blurred, free=("instrument-blur.fwhm_um",))
    noise = Uneven(Noise(0.01, 0.0, 1.0, 0.5, 0.5))
    objective = Objective((Whitened.of(prepare(target, seen), noise),), {})
    fitted = descend(objective, objective.differentiated(objective.at(free, free.start)))
    off = fitted.vector[0] - 1.2
    assert off == pytest.approx(np.sqrt(3) * considered(fitted, Work())[0], rel=0.2) and off > 0.01


def test_pixels_that_are_said_are_in_no_doubt():
    fit = fit_of(ONE, ONE[0], WHITE, FREE)
    assert considered(fit, Work()) == [0.0]


def test_what_is_doubted_passes_through_the_estimators():
    """Doubts of half a derivative and of a whole one: standard deviations of 0.5 and 1 of its parameter, together."""
    fit = fit_of(ONE, ONE[0], WHITE, FREE)
    doubts = [np.concatenate([0.5 * ONE, ONE])]
    assert considered(fit, Work(), doubts) == pytest.approx([np.hypot(0.5, 1.0)])
    null = null_of(fit, WHITE)
    alone, doubted = (deviations(fit, null, doubts=some)[0] for some in (None, doubts))
    assert doubted == pytest.approx(np.hypot(alone, np.hypot(0.5, 1.0)))

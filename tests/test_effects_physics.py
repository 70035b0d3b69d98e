"""Every effect against a closed form."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from dlwpredict.effects import library
from dlwpredict.effects.dose_proximity import neighbourhood
from dlwpredict.effects.lateral_shrinkage import REACH, edge_pull_um
from dlwpredict.heightmap import HeightMap
from dlwpredict.model.levels import Levels
from dlwpredict.model.states import Dose, Focus
from dlwpredict.numerics.smoothing import FWHM_PER_SIGMA
from dlwpredict.numerics.trailing import lag
from dlwpredict.parameters import Paper, ParameterSet, Readings
from dlwpredict.process import predict, run, steps

PITCH, TOP = 0.4, 6.0
P, S_Z = 0.42, 1.5 / FWHM_PER_SIGMA
PAPER = Paper(threshold=P, shrinkage_min=1.0)


def effect(name, **values):
    return library()[name](**values)


def pad(width_um=29.6, field_um=36.0, height_um=TOP, pitch=PITCH) -> HeightMap:
    axis = (np.arange(round(field_um / pitch)) + 0.5) * pitch - field_um / 2
    on = abs(axis) < width_um / 2
    return HeightMap(height_um * np.outer(on, on), pitch, pitch)


def exposed(target, *effects, paper=PAPER) -> np.ndarray:
    """The exposed height: what is printed when nothing shrinks (κ_min = κ_max = 1)."""
    return predict(target, ParameterSet(paper, effects=effects)).heights_um


def measured(target, *effects) -> np.ndarray:
    """What the instrument makes of a surface."""
    state = target
    for one in effects:
        state = one(state)
    return state.heights_um


def top_at(dose: float) -> float:
    """Where Φ((h − z)/s)·D² = P on a flat top."""
    return TOP - S_Z * ndtri(P / dose**2)


class TestThresholdChannel:
    def test_vignetting_lowers_a_flat_top_by_the_focus_not_by_its_height(self):
        for height in (4.0, 9.0):
            target = pad(height_um=height)
            vignetted = exposed(target, effect("vignetting", strength=0.2, centre_x_um=-30.0))
            rho = (target.x_um + 30) / 50
            row = slice(8, -8)
            y = target.y_um[45] / 50
            expected = [top_at(1 - 0.2 * (r**2 + y**2)) - TOP + height for r in rho[row]]
            np.testing.assert_allclose(vignetted[45][row][5:-5], expected[5:-5], atol=3e-4)

    def test_five_per_cent_of_intensity_shift_a_top_by_the_stated_slope(self):
        target = pad()
        gain = 1e-3
        on, off = (exposed(target, effect("dose-memory", gain=g, length_um=0.5)) for g in (gain, 0.0))
        slope = S_Z * 2 * P / (np.exp(-(ndtri(P) ** 2) / 2) / np.sqrt(2 * np.pi))
        assert (on - off)[45, 60] / np.log1p(gain) == pytest.approx(slope, rel=0.01)

    def test_dose_memory_rises_exponentially_to_its_plateau(self):
        target = pad()
        profile = exposed(target, effect("dose-memory", gain=0.1, length_um=3.0))[45]
        inside = np.flatnonzero(abs(target.x_um) < 13.5)
        way = target.x_um[inside] + 14.8
        expected = [top_at(1 + 0.1 * (1 - np.exp(-w / 3.0))) for w in way]
        np.testing.assert_allclose(profile[inside], expected, atol=3e-4)
        assert profile[inside[-1]] == pytest.approx(top_at(1.1), abs=1e-4)

    def test_dose_memory_resumes_behind_a_gap_with_what_is_left(self):
        on = np.zeros((4, 90))
        on[:, 10:40] = on[:, 45:80] = 1
        before = (
            library()["dose-memory"](gain=0.5, length_um=4.0).intensity(HeightMap(on, PITCH, PITCH), 0.5)[0] / 0.5 - 2
        )
        after_gap = before[39] * np.exp(-6 * PITCH / 4) + (1 - np.exp(-0.5 * PITCH / 4)) * (
            1 + np.exp(-5.5 * PITCH / 4)
        )
        assert before[45] == pytest.approx(after_gap, rel=1e-6)  # in single precision

    def test_line_ends_count_from_both_ends_of_every_segment(self):
        on = np.zeros((60, 3))
        on[5:25, 1] = on[35:50, 1] = 2.0
        target = HeightMap(on, PITCH, PITCH)
        one = effect("line-end-pileup", gain=0.1, length_um=2.0, end_ratio=0.5)
        dose = one.intensity(target, 1.0)[:, 1]
        rows = np.arange(60)
        expected = np.ones(60)
        half = PITCH / 4
        for first, stop in ((5, 25), (35, 50)):
            inside = slice(first, stop)
            high, low = (rows[inside] - first + 0.5) * PITCH, (stop - rows[inside] - 0.5) * PITCH
            expected[inside] += 0.1 * np.sinh(half) / half * (np.exp(-low / 2) + 0.5 * np.exp(-high / 2))
        np.testing.assert_allclose(dose, expected, rtol=1e-6)  # in single precision
        np.testing.assert_array_equal(one.intensity(target, 2.5), 1)

    def test_proximity_of_a_wide_pad_is_a_difference_of_two_edges(self):
        target = pad(height_um=8.0)
        s = 4.0 / FWHM_PER_SIGMA
        for z in (0.0, 3.0, 8.0, 10.0):
            expected = ndtr((8 - z) / s) - ndtr(-z / s)
            assert neighbourhood(target, z, 4.0)[45, 45] == pytest.approx(expected, abs=2e-5)
        assert neighbourhood(target, 4.0, 4.0)[45, 8] == pytest.approx(
            (2 * ndtr(4 / s) - 1) * ndtr(0.5 * PITCH / s), abs=2e-3
        )

    def test_edge_inhibition_lowers_a_flat_top_to_its_root(self):
        s, gain = 3.0 / FWHM_PER_SIGMA, 0.2
        root = brentq(
            lambda z: ndtr((TOP - z) / S_Z) - P * (1 + gain * ndtr((z - TOP) / s)),
            TOP - 2,
            TOP + 2,
        )
        top = exposed(pad(), effect("edge-inhibition", gain=gain, fwhm_um=3.0))[45, 45]
        assert top == pytest.approx(root, abs=2e-4)

    def test_power_drift_acts_layer_by_layer(self):
        drift = 0.2

        def exposure(z):
            layer = quad(
                lambda t: (1 + drift * t / TOP) ** 2 * np.exp(-((t - z) ** 2) / (2 * S_Z**2)),
                0,
                TOP,
                points=[z],
                epsabs=1e-10,
            )[0]
            return layer / (S_Z * np.sqrt(2 * np.pi))

        root = brentq(lambda z: exposure(z) - P, TOP - 2, TOP + 2)
        assert exposed(pad(), effect("power-drift", drift=drift))[45, 45] == pytest.approx(root, abs=2e-4)

    def test_background_reaches_the_resin_wherever_the_focus_is(self):
        """Φ((h − z)/s_z)·D(z)² = P with D at the height z itself; the neighbourhood is narrow against the pad."""
        gain, s = 0.3, 3.0 / FWHM_PER_SIGMA

        def dose(z):
            return 1 + gain * (ndtr((TOP - z) / s) - ndtr(-z / s))

        root = brentq(lambda z: ndtr((TOP - z) / S_Z) * dose(z) ** 2 - P, TOP - 2, TOP + 2)
        top = exposed(pad(), effect("dose-proximity", gain=gain, fwhm_um=3.0))[45, 45]
        assert top == pytest.approx(root, abs=3e-4)


class TestConversionChannel:
    @pytest.mark.parametrize("conversion", [0.25, 1.0])
    def test_dose_raises_cross_linking_in_proportion(self, conversion):
        """δh = e·(κ_max − κ_min)·mean(c)·η·(D² − 1): it grows with height, unlike the threshold channel."""
        target = pad(field_um=40)
        paper = Paper(threshold=P, crosslink_fwhm_xy_um=3.0, crosslink_fwhm_z_um=3.0)
        readings = Readings(crosslink_reference="bulk")
        heights = [
            predict(
                target,
                ParameterSet(
                    paper,
                    readings=readings,
                    effects=(effect("dose-memory", gain=0.05, length_um=0.5, conversion=eta),),
                ),
            ).heights_um[50, 60]
            for eta in (0.0, conversion)
        ]
        top, s = top_at(1.05), 3.0 / FWHM_PER_SIGMA
        z = np.linspace(0, top, 4001)
        mean = np.trapezoid(ndtr(z / s) - ndtr((z - top) / s), z) / top
        expected = top * 0.3 * mean * conversion * (1.05**2 - 1)
        assert heights[1] - heights[0] == pytest.approx(expected, rel=0.01)

    def test_a_uniform_dose_cancels_where_cross_linking_is_taken_relative_to_its_own_maximum(self):
        target = pad()
        values = [
            predict(target, ParameterSet(effects=(effect("dose-memory", gain=0.1, length_um=0.5, conversion=eta),)))
            for eta in (0.0, 1.0)
        ]
        centre = np.s_[40:50, 40:60]
        np.testing.assert_allclose(values[0].heights_um[centre], values[1].heights_um[centre], atol=2e-3)


class TestFocus:
    def test_wings_move_a_flat_top_to_the_root_of_both_parts(self):
        weight = 0.2
        root = brentq(lambda u: (1 - weight) * ndtr(u) + weight * ndtr(u / 3) - P, -3, 3)
        top = exposed(pad(), effect("psf-wings", weight=weight))[45, 45]
        assert top == pytest.approx(TOP - S_Z * root, abs=3e-4)

    def test_astigmatism_keeps_the_area_and_turns_the_ellipse(self):
        (part,) = effect("astigmatism", log_ratio=0.2, angle_deg=35.0).reshape(Focus(1.0, 3.0, 3.0, 1.0))
        assert part.fwhm_x_um * part.fwhm_y_um == pytest.approx(9.0)
        spot = np.zeros((61, 61))
        spot[30, 30] = 1
        cloud = part.spread(spot, 0.5, 0.5)
        n = 0.5 * (np.arange(61) - 30)
        xx, yy, xy = (np.einsum("rc,r,c->", cloud, a, b) for a, b in ((n**0, n**2), (n**2, n**0), (-n, n)))
        s2, twice = (3 / FWHM_PER_SIGMA) ** 2, np.deg2rad(70)
        assert xx == pytest.approx(s2 * (np.cosh(0.4) + np.sinh(0.4) * np.cos(twice)), rel=1e-4)
        assert yy == pytest.approx(s2 * (np.cosh(0.4) - np.sinh(0.4) * np.cos(twice)), rel=1e-4)
        assert xy == pytest.approx(s2 * np.sinh(0.4) * np.sin(twice), rel=1e-4)

    @pytest.mark.parametrize("sigma", [0.4, 0.8, 3.0])
    def test_a_turned_focus_tends_to_the_round_one(self, sigma):
        plane = np.random.default_rng(0).random((30, 40))
        width = sigma * FWHM_PER_SIGMA
        straight = Focus(1.0, width, width, 1.0).spread(plane, 1.0, 1.0)
        turned = Focus(1.0, width * 1.00001, width / 1.00001, 1.0, angle_deg=45.0).spread(plane, 1.0, 1.0)
        np.testing.assert_allclose(turned, straight, atol=5e-5)

    def test_spherical_aberration_on_a_flat_top(self):
        longer = exposed(pad(), effect("spherical-aberration", broadening_per_um=0.05))[45, 45]
        u = ndtri(P)
        assert longer == pytest.approx((TOP - S_Z * u) / (1 + 0.05 * S_Z * u), abs=2e-4)
        moved = exposed(pad(), effect("spherical-aberration", focus_shift=0.02))[45, 45]
        assert moved == pytest.approx(TOP * 1.02 - S_Z * u, abs=1e-4)

    @pytest.mark.parametrize("power", [1.0, 1.5, 2.0])
    def test_spherical_aberration_grows_with_a_power_of_the_depth(self, power):
        """Where the surface lies, z = TOP − σ_z(z)·u for a longer focus, and for a weaker one the integral says it."""
        part = pad()
        longer = exposed(part, effect("spherical-aberration", broadening_per_um=0.05, depth_power=power))[45, 45]
        wider = S_Z * (1 + 0.5 * (longer / 10) ** power)
        assert longer == pytest.approx(TOP - wider * ndtri(P), abs=2e-4)
        layers = np.linspace(TOP - 8 * S_Z, TOP, 4001)

        def exposure(z):
            weaker = 1 - 0.2 * (layers / 10) ** power
            return np.trapezoid(weaker**2 * np.exp(-(((layers - z) / S_Z) ** 2) / 2), layers) / (
                S_Z * np.sqrt(2 * np.pi)
            )

        weaker = exposed(part, effect("spherical-aberration", loss_per_um=0.02, depth_power=power))[45, 45]
        assert weaker == pytest.approx(brentq(lambda z: exposure(z) - P, TOP - 2, TOP + 2), abs=6e-4)

    @pytest.mark.parametrize("direction", [1.0, -1.0])
    @pytest.mark.parametrize("length", [0.1, 0.5, 2.0])
    def test_galvo_lag_delays_a_gentle_wave_as_the_exponential_does(self, length, direction):
        """For a wave e^(iky) of small amplitude the kernel is 1/(1 + ikℓ)."""
        pitch, period = 0.2, 6.0
        y = (224.5 - np.arange(450)) * pitch
        heights = 5 + 0.05 * np.sin(2 * np.pi * y / period)
        target = HeightMap(np.repeat(heights[:, None], 30, axis=1), pitch, pitch)
        paper = Paper(threshold=0.5, shrinkage_min=1.0)
        late = exposed(target, effect("galvo-lag", lag_um=length, direction=direction), paper=paper)
        straight = exposed(target, paper=paper)
        inner = slice(195, 255)
        wave = np.exp(-2j * np.pi * y[inner] / period)
        ratio = (wave @ (late[inner, 15] - 5)) / (wave @ (straight[inner, 15] - 5))
        expected = 1 / (1 + 2j * np.pi * direction * length / period)
        assert abs(ratio - expected) < 4e-3

    @pytest.mark.parametrize("direction", [1.0, -1.0])
    def test_galvo_lag_of_the_heights_is_the_exponential_and_leaves_the_substrate_bare(self, direction):
        pitch, length = 0.1, 0.6
        heights = np.zeros((300, 12))
        heights[50:250] = 4.0
        target = HeightMap(heights, pitch, pitch)
        late = effect("galvo-lag", lag_um=length, direction=direction, height_share=1.0)
        state = late(Dose(target, (Focus(1.0, 0.4, 0.4, 1.5),), Levels(1)))
        assert state.focus[0].lag_y_um == 0
        along = state.written.heights_um[:, 5][:: -1 if direction > 0 else 1]  # in the order of writing
        gone = (np.arange(300) - 49.5) * pitch
        expected = np.where(gone > 0, 1 - np.exp(-gone / length), 0) - np.where(
            gone > 20, 1 - np.exp(-(gone - 20) / length), 0
        )
        written = along > 0
        inside = np.convolve(written, np.ones(7), "same") == 7  # away from where the part ends
        # beside the wall that was, the recursion overshoots by a hundredth
        np.testing.assert_allclose(along[inside], 4 * expected[inside], atol=0.06)
        ends = np.flatnonzero(np.diff(written.astype(int))) + 0.5 - 49.5
        np.testing.assert_allclose(ends * pitch, [length * np.log(2), 20 + length * np.log(2)], atol=pitch)

    def test_lag_shifts_by_its_mean(self):
        spot = np.zeros((40, 120))
        spot[:, 60] = 1
        n = np.arange(120) - 60
        for length in (-3.0, 0.2, 1.0, 4.0):
            late = lag(spot, length, axis=1)[0]
            assert late @ n == pytest.approx(length, rel=1e-4)
            assert late @ (n - length) ** 2 == pytest.approx(length**2, rel=1e-3)


class TestTarget:
    """What changes the heights written is the prediction of other heights."""

    @pytest.fixture
    def target(self):
        x = np.linspace(0, 2 * np.pi, 50)
        return HeightMap(np.pad(3 + np.outer(np.sin(x), np.cos(x)), 8), PITCH, PITCH)

    def written(self, target, one):
        state = run([s for s in steps(ParameterSet(effects=(one,)), Levels()) if s.stage in ("target", "dose")], target)
        return state.written.heights_um

    def test_interface_offset(self, target):
        h = target.heights_um
        np.testing.assert_array_equal(
            self.written(target, effect("interface-offset", offset_um=0.5)), np.maximum(h - 0.5, 0)
        )
        gained = self.written(target, effect("interface-offset", offset_um=-0.3))
        np.testing.assert_array_equal(gained, np.where(h > 0, h + 0.3, 0))

    def test_substrate_tilt_is_linear_and_loses_what_rises(self, target):
        wedge = self.written(target, effect("substrate-tilt", tilt_x_mrad=10.0, tilt_y_mrad=-20.0))
        change = (wedge - target.heights_um)[10:-10, 10:-10]
        np.testing.assert_allclose(np.diff(change, axis=1), -0.010 * PITCH, atol=1e-12)
        # one row down is one step towards −y, where the glass is higher
        np.testing.assert_allclose(np.diff(change, axis=0), -0.020 * PITCH, atol=1e-12)

    def test_print_field_curvature(self, target):
        one = effect("print-field-curvature", sag_um=0.4, tilt_y_mrad=3.0, centre_x_um=5.0)
        x, y = np.meshgrid(target.x_um - 5, target.y_um)
        bend = 0.4 * (x**2 + y**2) / 2500 + 3e-3 * y
        h = target.heights_um
        np.testing.assert_allclose(self.written(target, one), np.where(h > 0, h + bend, 0), atol=1e-12)

    def test_z_drift(self, target):
        h = target.heights_um
        one = effect("z-drift", scale=0.01, quadratic_per_10um=0.05)
        np.testing.assert_allclose(self.written(target, one), h * (1.01 + 0.005 * h), rtol=1e-12)

    @pytest.mark.parametrize(("seam", "period"), [(2.0, 4.0), (2.1, 4.1)])
    def test_stitching_displaces_every_second_block(self, target, seam, period):
        one = effect("stitching", step_um=0.1, seam_um=seam, period_um=period)
        change = (self.written(target, one) - target.heights_um)[30]

        def behind_up_to(x):
            return np.floor(x / (2 * period)) * period + np.minimum(x % (2 * period), period)

        ends = (behind_up_to(target.x_um + half - seam) for half in (PITCH / 2, -PITCH / 2))
        share = np.subtract(*ends) / PITCH
        assert np.any((share > 1e-9) & (share < 1 - 1e-9)) == (seam == 2.1)
        np.testing.assert_allclose(change, np.where(target.heights_um[30] > 0, 0.1 * share, 0), atol=1e-12)

    def test_stitching_shift_follows_a_smooth_relief(self, target):
        shifted = self.written(target, effect("stitching", shift_x_um=0.1, seam_um=-100.0))
        k = 2 * np.pi / 49 / PITCH
        rows, cols = np.arange(50)[:, None], np.arange(50)
        expected = 3 + np.sin(k * PITCH * rows) * np.cos(k * (cols * PITCH - 0.1))
        inside = np.s_[8 + 5 : -8 - 5, 8 + 5 : -8 - 5]
        np.testing.assert_allclose(shifted[inside], expected[5:-5, 5:-5], atol=1e-4)

    @pytest.mark.parametrize("share", [0.0, 0.3, 0.5, 0.9, 1.0])
    def test_a_pixel_that_a_seam_cuts_is_shifted_with_the_part_behind_it(self, target, share):
        here = 30
        seam = target.x_um[here] + PITCH * (0.5 - share)
        cut = self.written(target, effect("stitching", shift_x_um=0.1, seam_um=seam))
        whole = self.written(target, effect("stitching", shift_x_um=0.1, seam_um=-100.0))
        before, after, h = np.s_[:, :here], np.s_[:, here + 1 :], target.heights_um
        np.testing.assert_allclose(cut[before], h[before], atol=1e-12)
        np.testing.assert_allclose(cut[after], whole[after], atol=1e-12)
        expected = h[:, here] + share * (whole - h)[:, here]
        np.testing.assert_allclose(cut[:, here], expected, atol=1e-12)

    @pytest.mark.parametrize("width", [0.25, 1.0, 3.3])
    def test_overlap_has_its_width_at_every_pitch(self, target, width):
        dose = effect("stitching", overlap=0.2, width_um=width, seam_um=0.13).intensity(target, 1.0)
        assert ((dose - 1) * PITCH).sum(axis=1) == pytest.approx(0.2 * width)
        along_x = effect("stitching", overlap=0.2, width_um=width, angle_deg=90.0).intensity(target, 1.0)
        assert ((along_x - 1) * PITCH).sum(axis=0) == pytest.approx(0.2 * width)


class TestLineLength:
    """Segments [a, b] along y become [a − start, b + end]; rows run downwards, lines upwards."""

    def along(self, heights, pitch=0.2, **lengths):
        target = HeightMap(np.repeat(np.asarray(heights, float)[::-1, None], 4, axis=1), pitch, pitch)
        return effect("line-length-error", **lengths)(target).heights_um[::-1, 1]

    @pytest.mark.parametrize("length", [-0.37, -0.2, -0.003, 0.003, 0.1, 0.2, 0.33])
    def test_ramps_move_by_slope_times_length(self, length):
        up, flat, slope = np.arange(40) * 0.2, np.ones(20), 0.6
        hill = 2 + slope * np.concatenate([up, up[-1] * flat, up[::-1]])
        rising, top, falling = slice(8, 32), slice(45, 55), slice(68, 92)
        started, ended = self.along(hill, start_um=length) - hill, self.along(hill, end_um=length) - hill
        np.testing.assert_allclose(started[rising], slope * length, atol=1e-12)
        np.testing.assert_allclose(ended[falling], slope * length, atol=1e-12)
        for untouched in (started[top], started[falling], ended[top], ended[rising]):
            np.testing.assert_allclose(untouched, 0, atol=1e-12)

    def test_whole_pixels_are_a_grey_dilation_and_erosion(self):
        hill = np.random.default_rng(0).uniform(1, 5, 60)
        padded = np.pad(hill, 3, mode="edge")
        windows = np.stack([padded[k : k + 60] for k in range(7)])  # from y − 3 to y + 3 pixels
        longer = self.along(hill, start_um=0.2, end_um=0.4)
        np.testing.assert_allclose(longer, windows[1:5].max(axis=0), atol=1e-12)
        shorter = self.along(hill, start_um=-0.2, end_um=-0.4)
        np.testing.assert_allclose(shorter, windows[2:6].min(axis=0), atol=1e-12)
        moved = self.along(hill, start_um=0.2, end_um=-0.4)  # all lines one pixel down, then one shorter at their end
        np.testing.assert_allclose(moved, windows[4:6].min(axis=0), atol=1e-12)

    def test_heights_grow_with_both_lengths(self):
        y = np.arange(60) * 0.2
        hill = 3 + 0.5 * np.sin(y) + 0.3 * np.sin(2.7 * y) + 1.5 * (y > 7)
        bend = np.abs(np.diff(hill[y < 7], 2)).max()
        for key in ("start_um", "end_um"):
            maps = [self.along(hill, **{key: length}) for length in np.linspace(-0.5, 0.5, 51)]
            steps = np.diff(maps, axis=0)
            assert steps.min() >= -bend / 8 and (steps >= -1e-12).mean() > 0.9

    @pytest.mark.parametrize("length", [-0.13, -0.05, 0.05, 0.13, 0.3])
    def test_a_wall_on_glass_moves_by_the_length(self, length):
        """Its place is that of the volume; films thinner than a twentieth of a column stand on the next column."""
        wall = np.pad(np.full(20, 5.0), 10)
        for lengths in ({"start_um": length}, {"end_um": length}):
            moved = self.along(wall, **lengths)
            assert (moved - wall).sum() * 0.2 == pytest.approx(5 * length)
            changed = np.flatnonzero(abs(moved - wall) > 1e-5)
            assert abs(changed - (9.5 if "start_um" in lengths else 29.5)).max() <= 2
        thin = self.along(wall, end_um=0.008)
        assert thin[30] == 0 and thin[29] == pytest.approx(5 * 1.04)
        assert self.along(wall, start_um=0.008)[[9, 10]].tolist() == pytest.approx([0, 5 * 1.04])

    def test_lines_written_the_other_way_start_at_high_y(self):
        hill = 2 + np.sin(np.arange(60) / 4)
        np.testing.assert_allclose(
            self.along(hill, start_um=-0.1, end_um=0.05, direction=-1.0),
            self.along(hill[::-1], start_um=-0.1, end_um=0.05)[::-1],
        )

    def test_one_length_more_and_less_is_a_shift_of_a_wave(self):
        y = np.arange(80) * 0.2
        moved = self.along(3 + np.sin(2 * np.pi * y / 6), start_um=-0.13, end_um=0.13)
        np.testing.assert_allclose(moved[5:-5], 3 + np.sin(2 * np.pi * (y - 0.13) / 6)[5:-5], atol=1e-3)


class TestSurface:
    def test_shrinkage_follows_the_power_of_cross_linking(self):
        s = 3.0 / FWHM_PER_SIGMA
        target = pad(32.0, 44.0)
        paper = Paper(crosslink_fwhm_xy_um=3.0, crosslink_fwhm_z_um=3.0)
        one = effect("shrinkage-nonlinearity", exponent=1.7)
        printed = predict(target, ParameterSet(paper, effects=(one,))).heights_um[55, 55]
        z = np.linspace(0, TOP, 20001)
        m_cl = ndtr(z / s) - ndtr((z - TOP) / s)
        kappa = 0.7 + 0.3 * np.trapezoid((m_cl / m_cl.max()) ** 1.7, z) / TOP
        assert printed == pytest.approx(kappa * TOP, abs=3e-4)

    def test_edge_drying_decays_from_every_edge(self):
        target = pad(20.0, 24.0)
        dried = measured(target, effect("edge-drying", depth_um=0.5, length_um=2.0))
        for steps_in in (0, 3, 10):
            distance = (steps_in + 0.5) * PITCH
            expected = TOP - 0.5 * np.exp(-distance / 2.0)
            assert dried[30, 5 + steps_in] == pytest.approx(expected)
            assert dried[54 - steps_in, 30] == pytest.approx(expected)
        assert not dried[:5].any()

    def test_curl_rises_at_the_middle_of_the_edge_whatever_the_footprint(self):
        for width in (8.0, 20.0):
            bent = measured(pad(width, 24.0, pitch=0.1), effect("curl", rise_um=0.3))[120]
            assert bent[bent > 0][-1] - TOP == pytest.approx(0.3, rel=0.03)
            assert bent[120] - TOP == pytest.approx(0, abs=1e-3)

    @pytest.mark.parametrize("axis", [0, 1])
    def test_curl_follows_the_footprint_away_from_the_centre(self, axis):
        target = pad(8.0, 24.0, pitch=0.2)
        moved = target.with_heights(np.roll(target.heights_um, 25, axis))
        bend = effect("curl", rise_um=0.3)
        np.testing.assert_allclose(measured(moved, bend), np.roll(measured(target, bend), 25, axis), atol=1e-12)

    def test_lateral_shrinkage_draws_each_height_by_its_own_share(self):
        """h′(x′(x)) = h(x) on a gentle hill."""
        axis = (np.arange(200) - 99.5) * 0.2
        hill = 3 + 2 * np.exp(-((axis[:, None] - 4) ** 2 + (axis + 5) ** 2) / 60)
        target = HeightMap(np.pad(hill, 10), 0.2, 0.2)
        moved = measured(target, effect("lateral-shrinkage", strain=0.05, pin_height_um=4.0))
        for row, col in ((100, 60), (60, 130), (150, 90)):
            h = target.heights_um[row, col]
            factor = 1 - 0.05 * (1 - np.exp(-h / 4.0))
            new_row, new_col = (109.5 + (i - 109.5) * factor for i in (row, col))
            r, c = int(new_row), int(new_col)
            patch = moved[r : r + 2, c : c + 2]
            a, b = new_row - r, new_col - c
            bilinear = np.array([1 - a, a]) @ patch @ np.array([1 - b, b])
            assert bilinear == pytest.approx(h, abs=1e-3)

    def test_lateral_shrinkage_knows_nothing_of_the_rim_three_pixels_inside_it(self):
        """The print's last pixel bends down, where the focus rounded it; beside it, h′(x′(x)) = h(x)."""
        x = (np.arange(60) - 29.5) * 0.4
        profile = 10 - 0.02 * x**2
        profile[[0, -1]] -= 0.35
        strain, pin = 0.02, 5.0
        target = HeightMap(np.pad(np.repeat(profile[None], 61, axis=0), 8), 0.4, 0.4)
        moved = measured(target, effect("lateral-shrinkage", strain=strain, pin_height_um=pin))[38, 8:-8]

        def misfit(before, there):
            h = 10 - 0.02 * before**2
            return before * (1 - strain * (1 - np.exp(-h / pin))) - there

        before = [brentq(misfit, -15, 15, args=(there,)) for there in x[3:-3]]
        np.testing.assert_allclose(moved[3:-3], 10 - 0.02 * np.square(before), atol=5e-5)

    def test_lateral_shrinkage_leans_walls_and_holds_the_base(self):
        target = pad(20.0, 24.0, pitch=0.1)
        strain, pin = 0.1, 3.0
        profile = measured(target, effect("lateral-shrinkage", strain=strain, pin_height_um=pin))[120]
        x = target.x_um
        assert (profile[abs(x) < 10] > 0).all()
        assert not profile[abs(x) > 10].any()
        wall = (abs(x) > 10 * (1 - strain * (1 - np.exp(-TOP / pin))) + 0.1) & (abs(x) < 9.9)
        expected = -pin * np.log(1 - (1 - abs(x[wall]) / 10) / strain)
        np.testing.assert_allclose(profile[wall], expected, atol=1e-4)
        assert profile[120] == pytest.approx(TOP, abs=1e-6)

    @pytest.mark.parametrize("half", [3.0, 15.0, 60.0])
    def test_free_edges_are_pulled_as_those_of_an_elastic_strip(self, half):
        """What u − l²u″ = 0 with u′ = −1 at x = ±R gives: u = −l sinh(x/l) / cosh(R/l), and nothing along the strip."""
        target, reach = pad(2 * half, 2 * half + 12, pitch=0.2), REACH * TOP
        inside = abs(target.x_um) < half
        towards, along = edge_pull_um(target, TOP)[:, target.shape[0] // 2, inside]
        elastic = -reach * np.sinh(target.x_um[inside] / reach) / np.cosh(half / reach)
        np.testing.assert_allclose(towards, elastic, atol=0.01)
        np.testing.assert_allclose(along, 0, atol=0.11)

    def test_on_a_gentle_slope_resin_is_drawn_to_where_more_of_it_is(self):
        """There u = l²/2z · ∇h: below z = h the film grows thinner on one side, and its force with it."""
        x = (np.arange(800) - 399.5) * 0.4
        hill = HeightMap(np.repeat((3 + 0.2 * np.exp(-(x**2) / 7200))[None], 400, axis=0), 0.4, 0.4)
        height = hill.heights_um[200, 550]
        slope = -0.2 * x[550] / 3600 * np.exp(-(x[550] ** 2) / 7200)
        assert edge_pull_um(hill, height)[0, 200, 550] == pytest.approx(REACH**2 * height * slope / 2, rel=0.05)

    @pytest.mark.parametrize("share", [0.5, 1.0])
    def test_what_free_edges_draw_in_is_the_resin_that_was_there(self, share):
        """On a top that slopes, h′(x + s·u(x)) = h(x), to second order in s near the edges."""
        x, strain, pin = (np.arange(240) - 119.5) * 0.2, 0.3, 0.5
        profile = np.where(abs(x) < 15, TOP + 0.02 * x, 0)
        target = HeightMap(np.repeat(profile[None], 241, axis=0) * (abs(np.arange(241) - 120) < 110)[:, None], 0.2, 0.2)
        moved = measured(target, effect("lateral-shrinkage", strain=strain, pin_height_um=pin, free_edges=share))[120]
        for col in (60, 70, 90, 170):
            height = profile[col]
            pull = share * edge_pull_um(target, height)[0, 120, col] - (1 - share) * x[col]
            there = x[col] - strain * np.expm1(-height / pin) * pull
            assert np.interp(there, x, moved) == pytest.approx(height, abs=4e-3)

    def test_posts_far_apart_keep_their_places_where_edges_are_free(self):
        """Drawn to one centre, only the walls that look outwards come in, by as much as they are far from it."""
        post = np.full((20, 20), TOP)
        target = HeightMap(np.pad(np.hstack([post, np.zeros((20, 60)), post]), 5), 0.4, 0.4)
        sides = {}
        for share in (0.0, 1.0):
            moved = measured(target, effect("lateral-shrinkage", strain=0.1, free_edges=share))[15, :55]
            high = np.flatnonzero(moved > 0.99 * TOP)
            sides[share] = high[0] - 5, 24 - high[-1]
        assert sides[1.0][0] == sides[1.0][1] > 0
        assert sides[0.0][0] > 2 and sides[0.0][1] <= 0

    def test_free_edges_move_a_wall_and_leave_the_middle(self):
        """At the top of a wide part a wall has come in by strain · (1 − e^(−z/H)) · l of the layer there."""
        target, strain, pin = pad(60.0, 70.0, pitch=0.2), 0.1, 3.0
        moved = measured(target, effect("lateral-shrinkage", strain=strain, pin_height_um=pin, free_edges=1.0))[175]
        came_in = target.x_um[np.flatnonzero(moved > TOP - 0.01)[0]] + 30
        assert came_in == pytest.approx(strain * -np.expm1(-TOP / pin) * REACH * TOP, abs=0.2)
        np.testing.assert_allclose(moved[abs(target.x_um) < 20], TOP, atol=1e-6)


class TestMeasurement:
    @pytest.fixture
    def wave(self):
        x = (np.arange(200) - 99.5) * 0.1
        return HeightMap(np.repeat(4 + 0.3 * np.sin(2 * np.pi * x / 2.0)[None], 40, axis=0), 0.1, 0.1)

    def test_blur_damps_a_wave_by_its_transfer_function(self, wave):
        blurred = measured(wave, effect("instrument-blur", fwhm_um=0.8))
        damping = np.exp(-2 * (np.pi * 0.8 / FWHM_PER_SIGMA / 2.0) ** 2)
        np.testing.assert_allclose((blurred - 4)[20, 60:140], damping * (wave.heights_um - 4)[20, 60:140], atol=2e-4)

    def test_blur_of_a_curved_field_stays_one_up_to_the_rim(self):
        """Beyond the map a substrate goes on as the instrument shows it there; it does not fall back to 0."""
        bowl = 1e-3 * ((np.arange(60) - 30)[:, None] ** 2 + 2.0 * np.arange(60))
        field = HeightMap(bowl, 0.25, 0.25)
        blurred = effect("instrument-blur", fwhm_um=1.0).heights(field)
        sigma_px = 1.0 / FWHM_PER_SIGMA / 0.25
        np.testing.assert_allclose(blurred[10:-10, 10:-10] - bowl[10:-10, 10:-10], 1e-3 * sigma_px**2, atol=1e-6)
        assert np.abs(blurred - bowl).max() < 0.1  # µm, at a corner of 1 µm: by an edge that stays as high, not by 0

    def test_blur_of_a_plateau_ignores_gaps(self):
        heights = np.full((30, 30), 2.0)
        heights[10:13, 5:9] = np.nan
        blurred = measured(
            HeightMap(np.pad(heights, 20, constant_values=2.0), 0.2, 0.2), effect("instrument-blur", fwhm_um=0.9)
        )
        np.testing.assert_allclose(blurred[20:-20, 20:-20][~np.isnan(heights)], 2.0, rtol=1e-6)

    def test_batwings_overshoot_at_steps_and_spare_gentle_ground(self, wave):
        gentle = wave.with_heights(4 + 0.2 * (wave.heights_um - 4))
        assert abs(measured(gentle, effect("batwings", gain=0.5)) - gentle.heights_um)[:, 30:-30].max() < 1e-5
        step = np.where(np.arange(60) < 30, 3.0, 5.0)
        map_ = HeightMap(np.repeat(step[None], 60, axis=0), 0.2, 0.2)
        change = (measured(map_, effect("batwings", gain=0.5)) - map_.heights_um)[30]
        assert change[30] == pytest.approx(-change[29]) and change[30] > 0.2
        assert abs(change[10:25]).max() < 1e-9

    def test_slope_error_on_a_ramp(self):
        x, y = np.meshgrid(np.arange(40) * 0.2, np.arange(40)[::-1] * 0.2)
        ramp = HeightMap(1 + 0.3 * x + 0.4 * y, 0.2, 0.2)
        read = measured(ramp, effect("slope-error", bias_um=0.1, signed_x_um=0.05, signed_y_um=-0.02))
        np.testing.assert_allclose(read - ramp.heights_um, 0.1 * 0.25 + 0.05 * 0.3 - 0.02 * 0.4, atol=1e-9)
        angle = np.rad2deg(np.arctan(0.5))
        assert np.isnan(measured(ramp, effect("slope-error", max_angle_deg=angle - 1))).all()
        assert not np.isnan(measured(ramp, effect("slope-error", max_angle_deg=angle + 1))).any()

    def test_slope_error_of_a_wall_is_capped(self):
        wall = HeightMap(np.repeat(np.where(np.arange(20) < 10, 0.0, 9.0)[None], 20, axis=0), 0.2, 0.2)
        read = measured(wall, effect("slope-error", bias_um=0.1, signed_x_um=0.05))
        assert (read - wall.heights_um).max() == pytest.approx(0.1 * 3 + 0.05 * np.sqrt(3))

    def test_even_slope_error_is_lost_on_slopes_of_either_sign_along_its_axis(self):
        x, y = np.meshgrid(np.arange(40) * 0.2, np.arange(40)[::-1] * 0.2)
        for sign in (-1, 1):
            ramp = HeightMap(9 + sign * (0.3 * x + 0.4 * y), 0.2, 0.2)
            read = measured(ramp, effect("slope-error", bias_abs_x_um=0.1, bias_abs_y_um=-0.02))
            np.testing.assert_allclose(read - ramp.heights_um, -0.1 * 0.3 + 0.02 * 0.4, atol=1e-9)
        wall = HeightMap(np.repeat(np.where(np.arange(20) < 10, 0.0, 9.0)[None], 20, axis=0), 0.2, 0.2)
        read = measured(wall, effect("slope-error", bias_abs_x_um=0.1))
        assert (read - wall.heights_um).min() == pytest.approx(-0.1 * np.sqrt(3))

    def test_a_ball_raises_a_ramp_by_its_offset(self):
        x, y = np.meshgrid(np.arange(40) * 0.3, np.arange(40)[::-1] * 0.2)
        ramp = HeightMap(1 + 0.3 * x - 0.4 * y, 0.3, 0.2)
        raised = measured(ramp, effect("tip-convolution", radius_um=0.05)) - ramp.heights_um
        np.testing.assert_allclose(raised[2:-2, 2:-2], 0.05 * (np.sqrt(1.25) - 1), atol=1e-12)

    def test_a_ball_leaves_tops_and_raises_the_foot_of_a_wall(self):
        step = np.where(np.arange(30) < 15, 1.0, 3.0)
        wall = HeightMap(np.repeat(step[None], 30, axis=0), 0.2, 0.2)
        raised = (measured(wall, effect("tip-convolution", radius_um=0.02)) - wall.heights_um)[15]
        assert raised[14] == pytest.approx(0.02 * (np.hypot(1, 10) - 1), rel=1e-3)
        np.testing.assert_allclose(np.delete(raised, 14), 0, atol=1e-4)

    def test_a_cone_makes_its_own_flank_of_a_wall(self):
        """Walls from two sides and, in between directions, not steeper than 1 % beyond the cone."""
        post = np.zeros((81, 81))
        post[38:43, 38:43] = 4.0
        state = HeightMap(post, 0.1, 0.1)
        seen = measured(state, effect("tip-convolution", half_angle_deg=30.0))
        cot = np.sqrt(3)
        away = np.arange(1, 20) * 0.1
        np.testing.assert_allclose(seen[40, 43:62], 4 - cot * away, atol=1e-9)
        np.testing.assert_allclose(seen[19:38, 40], 4 - cot * away[::-1], atol=1e-9)
        far = np.hypot(*np.maximum(abs(np.indices((81, 81)) - 40) - 2, 0)) * 0.1
        np.testing.assert_allclose(seen, np.maximum(4 - cot * far, 0), atol=0.01 * 4)
        assert (seen >= post).all()

    def test_a_tip_spares_slopes_gentler_than_its_flank(self, wave):
        steepest = 0.3 * np.pi
        blunt = np.rad2deg(np.arctan(1 / steepest))
        seen = measured(wave, effect("tip-convolution", half_angle_deg=blunt - 3))
        np.testing.assert_array_equal(seen, wave.heights_um)
        assert (measured(wave, effect("tip-convolution", half_angle_deg=blunt + 5)) > wave.heights_um).any()

    def test_z_amplification_is_a_factor(self, wave):
        np.testing.assert_array_equal(measured(wave, effect("z-amplification", gain=0.03)), 1.03 * wave.heights_um)

    def test_z_linearity_counts_from_the_mean_in_units_of_half_the_range(self):
        ramp = HeightMap(np.repeat(np.linspace(0, 8, 41)[None], 5, axis=0), 1, 1)
        error = (measured(ramp, effect("z-linearity", quadratic_um=0.05)) - ramp.heights_um)[2]
        assert error[[0, 20, 40]] == pytest.approx([0.05, 0, 0.05], abs=1e-12)
        steps = HeightMap([[0.0, 0.0, 0.0], [0.0, 8.0, np.nan]], 1, 1)  # mean 1.6, half the range 4
        error = measured(steps, effect("z-linearity", quadratic_um=0.05)) - steps.heights_um
        assert error[0, 0] == pytest.approx(0.05 * 0.16) and error[1, 1] == pytest.approx(0.05 * 2.56)
        wavy = (
            measured(ramp, effect("z-linearity", periodic_um=0.05, period_um=4.0, phase_rad=0.5)) - ramp.heights_um
        )[2]
        np.testing.assert_allclose(wavy, 0.05 * np.sin(2 * np.pi * ramp.heights_um[2] / 4 + 0.5), atol=1e-12)

    def test_an_instrument_does_not_see_the_room_around_the_map(self):
        part = HeightMap(np.pad(np.full((20, 20), 4.0), 10), 0.5, 0.5)
        printed = predict(part, ParameterSet())
        process = ParameterSet(effects=(effect("z-linearity", quadratic_um=0.05),))
        expected = measured(printed, process.effects[0])
        np.testing.assert_allclose(predict(part, process, as_measured=True).heights_um, expected, atol=1e-12)

    def test_field_curvature_at_fifty_micrometres(self):
        flat = HeightMap(np.full((101, 101), 3.0), 1.0, 1.0)
        form = measured(flat, effect("field-curvature", sag_um=0.1, coma_x_um=0.04, coma_y_um=-0.02)) - 3
        # rows run downwards
        ends = [form[50, 100], form[50, 0], form[0, 50], form[100, 50], form[50, 50]]
        assert ends == pytest.approx([0.14, 0.06, 0.08, 0.12, 0.0])
        moved = measured(flat, effect("field-curvature", sag_um=0.1, centre_x_um=10.0)) - 3
        assert moved[50, 60] == pytest.approx(0) and moved[50, 10] == pytest.approx(0.1)

    def test_misregistration_shows_each_point_where_the_pose_says(self):
        """The target point p lies in the recording at shift + R·diag(scale)·p, as in align.yaml."""
        x, y = np.meshgrid((np.arange(121) - 60) * 0.25, (60 - np.arange(121)) * 0.25)
        peak = (8.0, 5.0)
        hill = HeightMap(2 * np.exp(-((x - peak[0]) ** 2 + (y - peak[1]) ** 2) / 4), 0.25, 0.25)
        pose = {"shift_x_um": 0.7, "shift_y_um": -0.4, "rotation_deg": 4.0, "scale_x": 1.05, "scale_y": 0.97}
        seen = measured(hill, effect("misregistration", **pose))
        centre = [float((seen * a).sum() / seen.sum()) for a in (x, y)]
        turn = np.deg2rad(4.0)
        px, py = 1.05 * peak[0], 0.97 * peak[1]
        expected = [0.7 + px * np.cos(turn) - py * np.sin(turn), -0.4 + px * np.sin(turn) + py * np.cos(turn)]
        assert centre == pytest.approx(expected, abs=2e-3)

    def test_shear_moves_along_x_in_proportion_to_y(self):
        x, y = np.meshgrid((np.arange(121) - 60) * 0.25, (60 - np.arange(121)) * 0.25)
        hill = HeightMap(np.exp(-(x**2 + (y - 10) ** 2) / 4), 0.25, 0.25)
        seen = measured(hill, effect("misregistration", shear_mrad=40.0))
        assert float((seen * x).sum() / seen.sum()) == pytest.approx(0.4, abs=1e-3)

    def test_a_field_that_lies_beside_its_place_stays_as_high_at_the_rim(self):
        """It rises by 1 nm per pixel: as much as it is moved, 4 pixels and 20·sin 2°; beyond the map it goes on."""
        tilted = HeightMap(np.full((40, 40), 1.0) + 1e-3 * np.arange(40), 0.25, 0.25)
        moved = measured(tilted, effect("misregistration", shift_x_um=1.0, shift_y_um=-0.6, rotation_deg=2.0))
        assert np.abs(moved - tilted.heights_um).max() < 1e-3 * (4 + 20 * np.sin(np.deg2rad(2)) + 0.1)


def test_the_drift_of_conversion_counts_from_the_highest_written_layer():
    """Exposed resin stands higher than what is written where P < ½; time does not."""
    chain = steps(ParameterSet(PAPER, effects=(effect("power-drift", drift=0.2, conversion=0.5),)), Levels())
    state = run([step for step in chain if step.stage in ("target", "dose", "exposed", "crosslink")], pad())
    assert state.exposed.surface.heights_um.max() > TOP + 0.05
    expected = 1 + 0.5 * ((1 + 0.2 * 3.0 / TOP) ** 2 - 1)
    np.testing.assert_allclose(state.source_weight(3.0), expected, rtol=1e-12)


@pytest.mark.parametrize(
    "one",
    [
        effect("astigmatism", log_ratio=0.3, angle_deg=0.0),
        effect("astigmatism", log_ratio=-0.2, angle_deg=90.0),
        effect("z-linearity", periodic_um=0.1, phase_rad=np.pi),
    ],
)
def test_at_the_end_of_a_circle_the_same_effect_is_said_otherwise(one):
    other = one.elsewhere()
    assert other != one and other.elsewhere() == one
    part = HeightMap(pad(8, 12).heights_um + np.random.default_rng(0).random((30, 30)), PITCH, PITCH)
    shown = [predict(part, ParameterSet(PAPER, effects=(e,)), as_measured=True).heights_um for e in (one, other)]
    np.testing.assert_allclose(*shown, atol=2e-5)  # `SINGLE_UM` of test_properties: single precision beside walls


def test_elsewhere_an_effect_is_what_it_is():
    for name in library():
        assert effect(name).elsewhere() == effect(name) or name == "astigmatism"

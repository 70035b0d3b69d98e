"""The noise model, its whitening and its estimate against dense algebra, closed forms and their own draws."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage, sparse

from dlwpredict.alignment.pose import Pose
from dlwpredict.alignment.resample import prepared, resample
from dlwpredict.heightmap import HeightMap, Instrument
from dlwpredict.infer.recording import prepare
from dlwpredict.noise.covariance import PURE, SMOOTHNESSES, Noise, matern
from dlwpredict.noise.estimate import estimate
from dlwpredict.noise.evened import Evened, Unevenness
from dlwpredict.noise.likelihood import model_at
from dlwpredict.noise.lines import OFFSET, Lines, _gain, on_lines
from dlwpredict.noise.unevenness import Ground, Uneven, grown
from dlwpredict.noise.whitening import Neighbourhood, Whitener
from dlwpredict.numerics.interpolation import read_means

MODEL = Noise(white_um=0.005, correlated_um=0.02, length_um=1.5, dx_um=0.4, dy_um=0.5)


@pytest.fixture(scope="module")
def used() -> np.ndarray:
    return np.random.default_rng(2).random((24, 30)) > 0.15


@pytest.fixture(scope="module")
def dense(used) -> np.ndarray:
    row, col = np.nonzero(used)
    distance = np.hypot(np.subtract.outer(row, row) * MODEL.dy_um, np.subtract.outer(col, col) * MODEL.dx_um)
    return MODEL.correlated_um**2 * matern(distance, MODEL.length_um) + MODEL.white_um**2 * np.eye(len(row))


NOISE = Noise(0.005, 0.02, 1.0, 0.4, 0.4)


@pytest.fixture(scope="module")
def holes() -> np.ndarray:
    used = np.random.default_rng(0).random((60, 70)) > 0.1
    used[20:30, 15:35] = False
    return used


class TestAlgebra:
    def test_times_is_the_dense_product(self, used, dense):
        v = np.random.default_rng(0).normal(size=used.sum())
        on_map = np.zeros(used.shape)
        on_map[used] = v
        np.testing.assert_allclose(MODEL.times(on_map)[used], dense @ v, rtol=1e-10, atol=1e-14)

    def test_effective_points_are_those_of_the_mean(self, used, dense):
        n = used.sum()
        assert MODEL.effective_points(used) == pytest.approx(n**2 * MODEL.sigma_um**2 / dense.sum())

    def test_white_noise_counts_every_pixel(self, used):
        assert Noise(0.01, 0.0, 1.0, 0.4, 0.4).effective_points(used) == pytest.approx(used.sum())


@pytest.mark.slow
def test_draws_have_the_models_covariance():
    rng = np.random.default_rng(7)
    draws = np.array([MODEL.simulate((12, 12), rng) for _ in range(4000)])
    assert draws.std() == pytest.approx(MODEL.sigma_um, rel=0.03)
    beside = np.mean(draws[:, 5, 5] * draws[:, 5, 8])
    assert beside == pytest.approx(MODEL.correlated_um**2 * matern(np.array(1.2), 1.5), rel=0.12)


def test_a_grain_smears_the_white_part_and_leaves_its_size():
    grainy = Noise(0.3, 0.5, 1.2, 0.4, 0.7, np.inf, grain_um=0.3)
    assert grainy.at(np.array(0.0)) == pytest.approx(grainy.sigma_um**2)
    correlated = 0.25 * matern(np.array(0.4), 1.2, np.inf)
    shared = (1 - PURE) * 0.09 * np.exp(-((0.4 / 0.3) ** 2) / 2)
    assert grainy.at(np.array(0.4)) == pytest.approx(correlated + shared)
    assert grainy.covariance((9, 8))[0, 1] == pytest.approx(correlated + shared)


@pytest.mark.parametrize("smoothness", [0.5, 1.5])
def test_a_grain_rounds_what_is_rough_as_a_smear_does(smoothness):
    """By the convolution of the correlation with a Gaussian of the grain, in the plane, on a fine grid."""
    x = np.arange(-300, 301) * 0.02
    rough = matern(np.hypot(x, x[:, None]), 0.8, smoothness)
    weights = np.exp(-((np.arange(-75, 76) * 0.02 / 0.25) ** 2) / 2)
    smeared = ndimage.correlate1d(ndimage.correlate1d(rough, weights / weights.sum(), 0), weights / weights.sum(), 1)
    found = Noise(0.0, 1.0, 0.8, 0.4, 0.4, smoothness, grain_um=0.25).at(np.abs(x[300:]))
    shown = smeared[300, 300:400] / smeared[300, 300]
    np.testing.assert_allclose(found[:100], shown, atol=0.045)
    assert np.abs(matern(x[300:400], 0.8, smoothness) - shown).max() > {0.5: 0.2, 1.5: 0.08}[smoothness]


def test_a_grain_far_wider_than_the_length_is_a_covariance_all_the_same():
    for smoothness in SMOOTHNESSES:
        found = Noise(0.3, 0.5, 0.01, 0.4, 0.4, smoothness, grain_um=1.0).at(np.array([0.0, 0.4]))
        assert found[0] == pytest.approx(0.34)
        assert 0 < found[1] < 0.34


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


def test_whitened_noise_is_white(holes):
    rng = np.random.default_rng(1)
    whitener = Neighbourhood.of(holes, 0.4, 0.4).whitener(NOISE)
    draws = np.stack([whitener @ NOISE.simulate(holes.shape, rng)[holes] for _ in range(40)])
    assert draws.var() == pytest.approx(1, abs=0.02)
    neighbours = np.mean(draws[:, 1:] * draws[:, :-1])
    assert abs(neighbours) < 0.02


ROWS = Lines(white_um=0.006, red_um=0.005, red_lines=2.0, hum_um=0.003, hum_lines=4.0, period_lines=3.0, tilt_um=0.01)
UNEVEN = Uneven(NOISE, jitter_um=0.03, power=1.0, rows=ROWS, columns=Lines(white_um=0.004))


@pytest.mark.slow
def test_uneven_noise_has_the_covariance_that_it_says():
    """S C S + K(rows) + τ²·x·x'·[same row] + σ_l²·[same column], by the whitener and by draws."""
    used = np.ones((9, 11), dtype=bool)
    used[3:5, 4:6] = False
    slope = np.random.default_rng(0).random(used.shape) * 2
    row, col = np.nonzero(used)
    distance = 0.4 * np.hypot(np.subtract.outer(row, row), np.subtract.outer(col, col))
    scale = 1 + 0.03 * slope[used] / NOISE.sigma_um
    covariance = scale * scale[:, None] * (0.02**2 * matern(distance, 1.0) + 0.005**2 * np.eye(len(row)))
    lag, along = np.abs(np.subtract.outer(row, row)), np.linspace(-1, 1, 11)[col]
    swing = np.exp(-lag / 4) * np.cos(2 * np.pi * lag / 3)
    covariance += 0.006**2 * (lag == 0) + 0.005**2 * np.exp(-lag / 2) + 0.003**2 * swing
    covariance += 0.01**2 * np.outer(along, along) * (lag == 0) + 0.004**2 * (col == col[:, None])
    whitener = Whitener.of(used, UNEVEN, slope)
    matrix = whitener @ np.eye(len(row))
    np.testing.assert_allclose(matrix @ covariance @ matrix.T, np.eye(len(row)), atol=0.03)
    np.testing.assert_allclose(whitener.transposed(np.eye(len(row))), matrix.T, atol=1e-9)
    rng = np.random.default_rng(1)
    draws = np.stack([UNEVEN.simulate(used.shape, rng, slope)[used] for _ in range(4000)])
    np.testing.assert_allclose(np.cov(draws.T), covariance, atol=0.1 * covariance.max())


@pytest.mark.slow
def test_uneven_noise_is_recognised_and_even_noise_is_not_called_so():
    used, rng = np.ones((80, 80), dtype=bool), np.random.default_rng(5)
    used[30:33] = False
    y, x = np.mgrid[:80, :80] / 80
    level = np.stack([np.ones(x.shape), x, y])
    slope = 2 * np.abs(np.sin(6 * x) * np.sin(5 * y))

    def found(noise: Uneven) -> Uneven:
        values = noise.simulate(used.shape, rng, slope)
        return estimate(values, used, (0.4, 0.4), level, ground=Ground(slope), seed=1).model

    even = Noise(0.004, 0.012, 1.0, 0.4, 0.4)
    assert not any(found(Uneven(even)).ways)
    jitter, rows, columns = (
        found(Uneven(even, **one)) for one in ({"jitter_um": 0.02}, {"rows": Lines(0.004)}, {"columns": Lines(0.004)})
    )
    assert (jitter.jitter_um, jitter.power) == (pytest.approx(0.02, rel=0.15), 2.0)
    assert (jitter.row_um, jitter.column_um) == (0, 0)
    assert rows.row_um == pytest.approx(0.004, rel=0.3) and rows.column_um == 0
    assert columns.column_um == pytest.approx(0.004, rel=0.3) and columns.row_um == 0
    for one in (jitter, rows, columns):
        assert one.even.sigma_um == pytest.approx(even.sigma_um, rel=0.12)


class TestLines:
    """Rows of a scanning instrument, 171 of them, on noise twice as strong as their offsets."""

    EVEN = Noise(0.01, 0.008, 0.8, 0.3, 0.3)

    def estimated(self, rows: Lines, seed: int, axes=(0, 1)):
        used, (y, x) = np.ones((171, 120), dtype=bool), np.mgrid[:171, :120] / 171
        used[40:50, 60:90] = False
        values = Uneven(self.EVEN, rows=rows).simulate(used.shape, np.random.default_rng(seed))
        level = np.stack([np.ones(x.shape), x, y])
        return estimate(values, used, (0.3, 0.3), level, ground=Ground(axes=axes), seed=1).model

    def test_the_gain_of_offsets_is_that_of_dense_algebra_and_so_are_its_derivatives(self):
        """Determinant and quadratic form of the covariance of whitened values; derivatives by central differences."""
        rng = np.random.default_rng(0)
        lines = Lines(white_um=0.4, red_um=0.5, red_lines=3.0, hum_um=0.3, hum_lines=9.0, period_lines=5.0)
        on = np.kron(np.eye(12), np.ones((4, 1))) + 0.1 * rng.normal(size=(48, 12))
        values = rng.normal(size=48)

        def dense(covariance):
            whole = np.eye(48) + on @ covariance @ on.T
            return values @ values - values @ np.linalg.solve(whole, values) - np.linalg.slogdet(whole)[1]

        gain, slopes = _gain(lines, on.T @ on, on.T @ values)
        assert gain == pytest.approx(dense(lines.covariance(12)))
        for lag in (0, 1, 5, 11):
            step = 1e-5 * (np.eye(12, k=lag) + np.eye(12, k=-lag)) / (2 if lag == 0 else 1)
            moved = [dense(lines.covariance(12) + way * step) for way in (1, -1)]
            assert slopes[lag] == pytest.approx(np.subtract(*moved) / 2e-5, rel=1e-4)

    @pytest.mark.slow
    def test_drift_hum_and_tilts_are_told_apart(self):
        found = [self.estimated(Lines(0.002, 0.005, 4.0, 0.006, 30.0, 4.5, 0.0057), seed).rows for seed in range(3)]
        assert np.median([one.period_lines for one in found]) == pytest.approx(4.5, rel=0.03)
        assert np.median([one.hum_um for one in found]) == pytest.approx(0.006, rel=0.25)
        assert np.median([one.tilt_um for one in found]) == pytest.approx(0.0057, rel=0.15)
        assert np.median([np.hypot(one.red_um, one.white_um) for one in found]) == pytest.approx(0.0054, rel=0.35)

    @pytest.mark.slow
    def test_offsets_that_are_independent_are_not_said_to_drift_swing_or_tilt(self):
        found = [self.estimated(Lines(0.004), seed) for seed in range(6)]
        assert [one.row_um for one in found] == pytest.approx([0.004] * 6, rel=0.25)
        assert sum(one.rows.red_um > 0 or one.rows.hum_um > 0 or one.rows.tilt_um > 0 for one in found) <= 1
        assert not any(one.column_um for one in found)

    @pytest.mark.slow
    def test_where_the_scan_runs_along_columns_rows_are_no_lines_of_it(self):
        assert self.estimated(Lines(0.004), 0, axes=(1,)).row_um == 0

    @pytest.mark.slow
    def test_columns_of_a_scan_along_columns_are_no_structure(self):
        columns = Uneven(self.EVEN, columns=Lines(0.006)).simulate((60, 50), np.random.default_rng(0))
        level, used = np.ones((1, 60, 50)), np.ones((60, 50), dtype=bool)
        unknown, known = (
            estimate(columns, used, (0.3, 0.3), level, ground=Ground(axes=axes), seed=1) for axes in ((0, 1), (1,))
        )
        assert unknown.columns.p_value < 1e-6 < known.columns.p_value == 1
        assert unknown.model.column_um == pytest.approx(known.model.column_um, rel=0.2)

    @pytest.mark.slow
    @pytest.mark.parametrize("fast_deg", [0.4, -25.0, 90.4, 62.0])
    def test_of_a_scan_that_is_turned_against_the_map_lean(self, fast_deg):
        """Offsets of 12 nm from line to line of the scan, read between the lines, on noise of 10 nm."""
        rng, instrument = np.random.default_rng(4), Instrument("afm", fast_deg)
        grid = HeightMap(np.ones((90, 80)), 0.4, 0.3, instrument=instrument)
        across = -np.sin(np.deg2rad(fast_deg)) * grid.x_um + np.cos(np.deg2rad(fast_deg)) * grid.y_um[:, None]
        offsets = np.interp(across, 0.35 * np.arange(-120, 121), 0.012 * rng.standard_normal(241))
        values = offsets + 0.01 * rng.standard_normal(grid.shape)
        recording = prepare(grid, grid)
        ground = Ground(axes=recording.scanned_axes, lean=recording.lean)
        noise = estimate(values, np.ones(grid.shape, bool), (0.4, 0.3), np.ones((1, *grid.shape)), ground=ground).model
        lines = noise.columns if recording.scanned_axes == (1,) else noise.rows
        assert lines.offset_um == pytest.approx(0.012, rel=0.3) and lines.lean == recording.lean
        assert noise.even.sigma_um == pytest.approx(0.01, rel=0.1)
        white = Whitener.of(np.ones(grid.shape, dtype=bool), noise) @ values.ravel()
        assert white.std() == pytest.approx(1, abs=0.06)
        again = noise.simulate(grid.shape, rng)
        assert again.std() == pytest.approx(values.std(), rel=0.12)

    def test_draws_have_the_covariance_that_they_say(self):
        drawn = ROWS.simulate(5, 3, np.random.default_rng(0), 20000)
        np.testing.assert_allclose(np.cov(drawn[:, :, 1].T), ROWS.covariance(5), atol=3e-6)
        assert np.std(drawn[:, 0, 2] - drawn[:, 0, 0]) == pytest.approx(0.02, rel=0.03)


def test_whitening_does_not_look_at_what_was_not_measured(holes):
    whitener = Neighbourhood.of(holes, 0.4, 0.4).whitener(NOISE)
    assert whitener.shape == (holes.sum(), holes.sum())


@pytest.mark.slow
def test_noise_beside_model_error_is_recovered(holes):
    """A smooth mismatch ten times the noise, which the free form can follow, does not change the estimate."""
    rng = np.random.default_rng(2)
    y, x = np.mgrid[:60, :70] * 0.4
    waves = np.stack([np.cos(np.pi * i * x / 28) * np.cos(np.pi * j * y / 24) for i in range(4) for j in range(4)])
    found = [
        estimate(NOISE.simulate(holes.shape, rng) + 0.2 * waves[5], holes, (0.4, 0.4), waves, seed=k).model
        for k in range(2)
    ]
    assert np.median([n.even.correlated_um for n in found]) == pytest.approx(0.02, rel=0.2)
    assert np.median([n.even.length_um for n in found]) == pytest.approx(1.0, rel=0.25)


@pytest.mark.slow
@pytest.mark.long
def test_spikes_have_no_say_in_the_noise(holes):
    rng = np.random.default_rng(3)
    values, level = NOISE.simulate(holes.shape, rng), np.ones((1, *holes.shape))
    clean = estimate(values, holes, (0.4, 0.4), level).model
    values[40:44, 50:54] += 1.0
    dirty = estimate(values, holes, (0.4, 0.4), level).model
    assert dirty.sigma_um == pytest.approx(clean.sigma_um, rel=0.1)
    assert dirty.even.length_um == pytest.approx(clean.even.length_um, rel=0.15)


@pytest.mark.slow
def test_kind_of_correlation_is_recognised():
    rng, used, level = np.random.default_rng(4), np.ones((90, 90), dtype=bool), np.ones((1, 90, 90))
    for kind in (1.5, np.inf):
        noise = Noise(0.004, 0.015, 1.2, 0.4, 0.4, kind)
        found = estimate(noise.simulate(used.shape, rng), used, (0.4, 0.4), level).model
        assert (found.even.smoothness, found.even.grain_um) == (kind, 0)
        assert found.even.length_um == pytest.approx(1.2, rel=0.25)


@pytest.mark.slow
def test_white_noise_that_was_read_between_its_pixels_is_known_by_its_grain():
    """Taken for white, it may make the noise beside it rougher and longer: a null was called unexplained for it."""
    rng, target, used = np.random.default_rng(8), HeightMap(np.zeros((110, 110)), 0.4, 0.4), np.ones((110, 110), bool)
    raw = Noise(0.004, 0.008, 3.0, 0.37, 0.37, np.inf).simulate((150, 150), rng)
    surface = prepared(HeightMap(raw, 0.37, 0.37), np.ones(raw.shape, bool))
    laid = resample(surface, surface.support > 0, target, Pose.rigid((0.1, 0.07), 3.0)).heights_um
    found = estimate(laid, used, (0.4, 0.4), np.ones((1, *used.shape))).model.even
    assert found.grain_um == pytest.approx(0.2)
    assert found.smoothness == np.inf
    assert found.length_um == pytest.approx(3.0, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(("coarse", "smoothness"), [(1.25, 0.5), (1.54, 0.5), (1.54, 1.5)])
def test_what_was_read_between_an_instruments_pixels_keeps_its_noise_far_away(coarse, smoothness):
    """Means over a µm, of which structure is told: their variance, of the map's over the model's.

    Where it is not said that the map was read, neighbours look smooth, the length comes out at a third of what it is,
    and such means have five times the variance that noise is thought to have.
    """
    pitch, rng = 0.26, np.random.default_rng(0)
    raw = Noise(0.0045, 0.0134, 0.8, coarse * pitch, coarse * pitch, smoothness).simulate((190, 190), rng)
    i, j = np.mgrid[-80:80, -80:80] / coarse
    turned = np.stack([0.94 * i - 0.34 * j, 0.34 * i + 0.94 * j]) + 95
    values = read_means(raw, turned, (1 / coarse, 1 / coarse))
    far = ndimage.gaussian_filter(values, 4).var()
    ratios = []
    for read_px in (coarse, 0.0):
        ground, level = Ground(read_px=read_px), np.ones((1, 160, 160))
        found = estimate(values, np.ones(values.shape, bool), (pitch, pitch), level, ground=ground)
        draws = found.model.even.simulate_many(values.shape, rng, 10)
        ratios.append(far / np.mean([ndimage.gaussian_filter(one, 4).var() for one in draws]))
    assert 1 / 1.4 < ratios[0] < 1.4
    assert ratios[1] > 1.4 * ratios[0]


@pytest.mark.slow
def test_forms_beside_noise_that_was_read_between_pixels_are_paid_for_once():
    """A hundred smooth maps take of the noise what one lattice of points shows of it, not what each of four does.

    Else noise looks smoother than it is, and means over 3 µm are thought to vary by 0.6 of what they do.
    """
    pitch, own, rng, truth = 0.36, 0.22, np.random.default_rng(9), Noise(0.003, 0.028, 0.9, 0.22, 0.22, smoothness=0.5)
    target, every = HeightMap(np.zeros((90, 90)), pitch, pitch), np.ones((170, 170), bool)
    maps = Noise(0, 1, 1.2, pitch, pitch).simulate_many(target.shape, rng, 100)
    block = np.hypot(*(pitch * np.subtract.outer(line, line) for line in np.mgrid[:8, :8].reshape(2, -1)))
    ratios = []
    for seed in range(3):
        surface = prepared(HeightMap(truth.simulate(every.shape, np.random.default_rng(seed)), own, own), every)
        laid = resample(surface, every, target, Pose.rigid((0.0, 0.0), 1.5)).heights_um
        ground = Ground(axes=(0,), read_px=own / pitch)
        found = estimate(laid, np.ones(laid.shape, bool), (pitch, pitch), maps, ground=ground, seed=1).model.even
        assert found.smoothness == 0.5
        ratios.append(found.at(block).mean() / truth.at(block).mean())
    assert 0.75 < np.mean(ratios) < 1.25


def test_lines_are_taken_as_far_as_they_are_likely_to_be_offset():
    """Of the mean of n points n/(n + σ²/τ²) where noise is white; of two ways what dense algebra says."""
    rng, used = np.random.default_rng(3), np.ones((6, 8), dtype=bool)
    members = {(axis, OFFSET): on_lines(used, axis) for axis in (0, 1)}
    values = rng.normal(size=(48, 2))
    even = Evened(values[:, 0], values, members, np.zeros(48)).also((0, OFFSET), 0.5, sparse.eye_array(48).tocsr())
    assert even.ways == {(0, OFFSET): pytest.approx(4.0)}
    rows = values.reshape(6, 8, 2)
    expected = rows - 8 / (8 + 4) * rows.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(even.beside_lines(values), expected.reshape(48, 2), atol=1e-9)
    near = np.eye(48) - np.diag(rng.uniform(0.2, 0.9, 47), -1)
    both = replace(even, ways={(0, OFFSET): 4.0, (1, OFFSET): 3.0}, near=sparse.csr_array(near))
    joint = np.hstack([members[axis, OFFSET].toarray() for axis in (0, 1)])
    weight, prior = near.T @ near, np.diag([4.0] * 6 + [3.0] * 8)
    taken = joint @ np.linalg.solve(joint.T @ weight @ joint + prior, joint.T @ weight @ values)
    np.testing.assert_allclose(both.beside_lines(values), values - taken, atol=1e-8)


def test_lines_are_resized_beside_a_better_whitener():
    """Offsets of 3 beside noise of 2: as a whitener tells them that knows it, whatever was taken before."""
    rng, used, near = np.random.default_rng(8), np.ones((40, 30), dtype=bool), 0.5 * sparse.eye_array(1200).tocsr()
    way, values = (0, OFFSET), (3 * rng.normal(size=(40, 1)) + 2 * rng.normal(size=(40, 30))).ravel()
    even = Evened(values, np.ones((1200, 1)), {way: on_lines(used, 0)}, np.zeros(1200))
    size = even.seen(near).lines(way).size
    assert size == pytest.approx(3, rel=0.25)
    assert even.also(way, 0.1, near).resized(near).ways == {way: pytest.approx(1 / size**2)}


def test_offsets_of_rows_are_told_from_noise_that_is_wider_than_many_rows():
    """By plain means they were left, and the noise came out twice as strong and nearly twice as wide.

    What is asked of the rows is their independent part: a drift of some lines is not told from noise as wide as that.
    """
    truth = Uneven(Noise(0.002, 0.028, 2.5, 0.34, 0.34, np.inf), rows=Lines(0.0045))
    used, plane, drawn = np.ones((80, 80), dtype=bool), np.ones((1, 80, 80)), []
    for seed in range(3):
        values = truth.simulate(used.shape, np.random.default_rng(seed))
        found = estimate(values, used, (0.34, 0.34), plane).model
        drawn.append((found.even.correlated_um, found.even.length_um, found.rows.white_um))
    for part, expected, share in zip(np.mean(drawn, axis=0), (0.028, 2.5, 0.0045), (0.2, 0.1, 0.15), strict=True):
        assert part == pytest.approx(expected, rel=share)


@pytest.mark.parametrize("times", [3, 10])
def test_offsets_far_stronger_than_the_noise_are_found_at_their_size(times):
    """Clipped about nothing, ten times the noise came out as four.

    Beside such rows noise looks as if it were of another kind; what is left once they are known is of its own.
    """
    rng = np.random.default_rng(7)
    offsets = 0.01 * times * rng.normal(size=(80, 1))
    values = Noise(0.003, 0.01, 1.0, 0.4, 0.4, smoothness=0.5).simulate((80, 80), rng) + offsets
    found = estimate(values, np.ones((80, 80), dtype=bool), (0.4, 0.4), np.ones((1, 80, 80))).model
    assert found.row_um == pytest.approx(offsets.std(), rel=0.05)
    assert found.even.smoothness == 0.5


@pytest.mark.parametrize("shape", [(200, 3), (3, 200)])
def test_lines_that_a_design_holds_whole_are_none(shape):
    """Of three lines, each with a column of its own in the design, nothing is left but rounding."""
    values = Noise(0.003, 0.01, 1.0, 0.4, 0.4).simulate(shape, np.random.default_rng(0))
    axis = int(np.argmin(shape))
    design = np.stack([np.moveaxis(np.broadcast_to(one[:, None], (3, 200)), 0, axis) for one in np.eye(3)])
    found = estimate(values, np.ones(shape, dtype=bool), (0.4, 0.4), design).model
    assert (found.row_um if axis == 0 else found.column_um) == 0


def test_whitening_is_undone(holes):
    """In raster order every point stands on those before it, so that the way back is a solve from the top."""
    slope = np.random.default_rng(7).random(holes.shape)
    whitener = Whitener.of(holes, Uneven(NOISE, 0.03, 1.0, Lines(0.01), Lines(0.02)), slope)
    values = np.random.default_rng(6).normal(size=(holes.sum(), 2))
    np.testing.assert_allclose(whitener.solve(whitener @ values), values, atol=1e-9)


def test_a_place_is_a_share_a_length_and_a_scale():
    """Three quarters of the variance 0.01 are correlated over 2 µm."""
    model = model_at(NOISE, np.array([np.log(3.0), np.log(2.0), np.log(0.1)]))
    assert (model.white_um, model.correlated_um, model.length_um) == pytest.approx((0.05, 0.1 * np.sqrt(0.75), 2.0))


def test_uneven_noise_is_the_root_of_its_parts():
    assert UNEVEN.sigma_um == pytest.approx(np.sqrt(0.005**2 + 0.02**2 + 7e-5 + 0.004**2))
    assert grown(0.5, 2.0) == pytest.approx(np.hypot(1, 0.5)) and grown(0.5, 1.0) == pytest.approx(1.5)


def test_half_the_time_even_noise_is_most_likely_even():
    """So a gain of 2.706, which χ² of one degree of freedom exceeds one time in ten, is exceeded one in twenty."""
    assert Unevenness(0.01, 2.7055).p_value == pytest.approx(0.05, abs=1e-4)
    assert Unevenness(0.01, 0.0).p_value == 1.0
    assert (Unevenness(0.01, 5.0).found, Unevenness(0.01, 6.0).found) == (0.0, 0.01)


def test_draws_of_one_call_have_the_models_covariance_and_are_independent():
    """Two are the real and the imaginary part of one transform, on a period little longer than the map."""
    draws = Noise(0.3, 1.0, 1.2, 0.4, 0.6).simulate_many((30, 20), np.random.default_rng(8), 3001)
    assert draws.shape == (3001, 30, 20)
    for lag, distance in (((0, 1), 0.4), ((1, 0), 0.6), ((3, 2), np.hypot(1.8, 0.8)), ((29, 19), 1e9)):
        here, there = draws[:, : 30 - lag[0], : 20 - lag[1]], draws[:, lag[0] :, lag[1] :]
        assert np.mean(here * there) == pytest.approx(matern(distance, 1.2), abs=0.05)
    assert abs(np.mean(draws[:-1:2] * draws[1::2])) < 0.02


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5])
def test_a_point_is_given_all_its_measured_neighbours_and_no_others(share):
    """B = C_nn⁻¹·c_in and v = C_ii − c_in·b, by dense algebra, whichever neighbours are missing."""
    used = np.random.default_rng(9).random((14, 15)) >= share
    near = Neighbourhood.of(used, 0.4, 0.5, near_px=2, far_px=(4, 8))
    coefficients, variances = near.rows(MODEL)
    row, col = np.nonzero(used)
    covariance = MODEL.at(np.hypot(np.subtract.outer(row, row) * 0.5, np.subtract.outer(col, col) * 0.4))
    for point in range(0, len(row), 7):
        known = near.index[point][near.present[point]]
        expected = np.linalg.solve(covariance[np.ix_(known, known)], covariance[known, point])
        np.testing.assert_allclose(coefficients[point][near.present[point]], expected, atol=1e-9)
        assert not coefficients[point][~near.present[point]].any()
        assert variances[point] == pytest.approx(covariance[point, point] - covariance[point, known] @ expected)


@pytest.mark.slow
@pytest.mark.long
def test_many_forms_beside_the_noise_are_paid_for():
    """120 waves take a sixth of what is correlated; not counted, it would come out weaker and shorter."""
    truth, rng = Noise(0.004, 0.015, 1.5, 0.4, 0.4), np.random.default_rng(10)
    used, (y, x) = np.ones((100, 100), dtype=bool), (np.mgrid[:100, :100] + 0.5) / 100
    waves = np.stack([np.cos(np.pi * i * x) * np.cos(np.pi * j * y) for i in range(11) for j in range(11)])
    found = [
        estimate(truth.simulate(used.shape, rng), used, (0.4, 0.4), waves, ((1.5,), (0.0,)), seed=k) for k in range(8)
    ]
    logs = np.log([(one.model.sigma_um / truth.sigma_um, one.model.even.length_um / 1.5) for one in found])
    assert np.abs(logs.mean(axis=0)).max() < 0.06
    claimed = np.mean([np.sqrt(one.covariance[1, 1]) for one in found])
    assert logs[:, 1].std() == pytest.approx(claimed, rel=0.6)

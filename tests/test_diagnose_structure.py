"""Structure without a name: what is found, where, and how surely; noise alone has the levels that are claimed."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import ndimage, sparse
from scipy.sparse.linalg import spsolve_triangular

from dlwpredict import designs
from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.structure.blemishes import blemish
from dlwpredict.diagnosis.structure.columns import Columns
from dlwpredict.diagnosis.structure.forms import Beside, Energy, Forms, agreement
from dlwpredict.diagnosis.structure.freeform import edge_distances, free_forms, smooth_forms, splines
from dlwpredict.diagnosis.structure.largest import p_of_largest
from dlwpredict.diagnosis.structure.places import WHERE, _box, locate
from dlwpredict.diagnosis.structure.ripple import Ripple, ripple
from dlwpredict.diagnosis.structure.spots import Bumps, Spot, mismatch, spot
from dlwpredict.diagnosis.structure.test import SINGLE, WAYS, Model
from dlwpredict.heightmap import HeightMap, Instrument
from dlwpredict.infer.free import Free
from dlwpredict.infer.null import Null
from dlwpredict.infer.objective import Fit, Nuisances
from dlwpredict.infer.recording import prepare
from dlwpredict.infer.rows import Rows
from dlwpredict.infer.whitened import Whitened
from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.evened import Unevenness
from dlwpredict.noise.unevenness import Uneven
from dlwpredict.parameters import ParameterSet

GRID = HeightMap(np.ones((60, 70)), 0.4, 0.3)
SIGMA_UM = 0.01
PADS = (4, 14, 4, 24), (4, 14, 30, 36), (20, 26, 6, 14), (20, 44, 18, 40), (32, 42, 4, 12), (50, 56, 8, 36)
"""Rows and columns of pads of different sizes, on which the edges of one side are not those of another."""


def white_item(grid=GRID, used=None):
    """Return a recording in which noise is white already, of `SIGMA_UM`."""
    used = np.ones(grid.shape, bool) if used is None else used
    recording = SimpleNamespace(used=used, target=grid, measured=grid, points=used.sum())
    whitener = SimpleNamespace(transposed=lambda values: values / SIGMA_UM, solve=lambda white: white * SIGMA_UM)
    return SimpleNamespace(recording=recording, whitener=whitener)


def fitted(residual, *items, jacobian=None):
    """Return a fit of the offset of every recording, and of one parameter that has its own derivative."""
    points = tuple(item.recording.points for item in items)
    rows = Rows(points, (0,) * len(items), 0)
    constant = Nuisances(rows, tuple(np.full((n, 1), n**-0.5) for n in points), tuple(np.zeros((0, 1)) for _ in points))
    one = Free(ParameterSet(), ("threshold",), np.zeros(1), np.ones(1))
    tangent = np.linspace(-1, 1, rows.total)[:, None] ** 3 if jacobian is None else jacobian
    bare = Fit(items, one, np.full(1, 0.5), (), rows, residual, constant, (), tangent)
    return replace(bare, residual=bare.beside(residual))


@pytest.fixture(scope="module")
def item():
    return white_item()


@pytest.fixture(scope="module")
def null():
    return Null(np.random.default_rng(5).standard_normal((4200, 100)).astype(np.float32))


@pytest.fixture(scope="module")
def noise():
    return np.random.default_rng(6).standard_normal(4200)


def with_draws(residual, item, null):
    found = fitted(residual, item)
    return found, null.beside(found)


class TestRipple:
    def test_is_found_with_period_and_direction(self, item, null, noise):
        assert ripple(*with_draws(noise, item, null)).p_value > 0.01
        along = np.deg2rad(30)
        phase = 2 * np.pi / 4 * (GRID.x_um * np.cos(along) + GRID.y_um[:, None] * np.sin(along))
        found = ripple(*with_draws(noise + 0.3 * np.cos(phase).ravel(), item, null))
        assert found.p_value < 1e-6
        assert found.period_um == pytest.approx(4.0, abs=0.4)
        assert found.angle_deg == pytest.approx(30, abs=6)
        assert found.excess == pytest.approx(0.3**2 / 2 * 4200, rel=0.35)  # what the wave has in squares

    @pytest.mark.parametrize(
        ("fast_deg", "said"), [(None, True), (0.0, False), (90.0, True), (1.0, False), (30.0, True)]
    )
    def test_waves_across_the_lines_of_a_known_scan_are_not_looked_at(self, item, null, noise, fast_deg, said):
        scanned = replace(GRID, instrument=Instrument("afm", fast_deg))
        seen = SimpleNamespace(recording=SimpleNamespace(**(vars(item.recording) | {"measured": scanned})))
        seen.whitener = item.whitener
        waves = 0.3 * np.cos(2 * np.pi / 4 * GRID.y_um[:, None]) * np.ones(GRID.shape)
        assert (ripple(*with_draws(noise + waves.ravel(), seen, null)).p_value < 1e-6) == said

    @pytest.mark.parametrize(
        ("instrument_um", "period_px", "said"), [(None, 2.5, False), (0.3, 5.0, True), (1.2, 5.0, False)]
    )
    def test_waves_shorter_than_three_pixels_of_map_and_instrument_are_not_looked_at(
        self, item, null, noise, instrument_um, period_px, said
    ):
        """Diagonal ones of 2.5 pixels are there, in a map that was turned: they come from between its pixels."""
        read = replace(GRID, instrument=Instrument(pitch_um=instrument_um))
        seen = SimpleNamespace(recording=SimpleNamespace(**(vars(item.recording) | {"measured": read})))
        seen.whitener = item.whitener
        diagonal = np.add.outer(-np.arange(GRID.shape[0]), np.arange(GRID.shape[1])) / np.sqrt(2)
        waves = 0.3 * np.cos(2 * np.pi / period_px * diagonal)
        assert (ripple(*with_draws(noise + waves.ravel(), seen, null)).p_value < 1e-6) == said

    def test_waves_are_a_place_of_the_mismatch_over_the_whole_map(self, item, null, noise):
        waves = 0.3 * np.cos(2 * np.pi / 4 * GRID.x_um) * np.ones(GRID.shape)
        found, draws = with_draws(noise + waves.ravel(), item, null)
        ramp = np.tile(GRID.x_um, GRID.shape[0])[:, None]
        bump = np.exp(-(GRID.x_um**2 + GRID.y_um[:, None] ** 2)).reshape(-1, 1)
        forms = Forms(({name: form / np.linalg.norm(form) for name, form in (("x", ramp), ("place", bump))},))
        beside, bumps, wave = Beside.of(found, forms.blocks, draws), [Bumps.of(item)], ripple(found, draws)
        (place,), _ = locate(found, forms, beside, bumps, [wave])
        assert place.where == "in waves of period 4.0 µm, at 0° to x" and place.share > 0.9
        assert place.p_value == wave.p_value < 1e-6
        assert place.x_um == pytest.approx((-14, 14)) and place.y_um == pytest.approx((-9, 9))
        assert locate(found, forms, beside, bumps, [])[0] == []


class TestSpot:
    def test_is_found_where_it_is(self, item, null, noise):
        """A bump two pixels wide; the same energy in a wave over the whole map is none.

        Noise alone has an energy of 16 somewhere in 4200 pixels; 8 standard deviations are 64, and 30 where noise takes
        2.5 of them away.
        """
        bumps = [Bumps.of(item)]
        assert spot(*with_draws(noise, item, null), bumps).p_value > 0.01
        bump = np.exp(-((GRID.x_um - 4.2) ** 2 + (GRID.y_um[:, None] + 3.0) ** 2) / (2 * 0.35**2)).ravel()
        found = spot(*with_draws(noise + 8 * bump / np.linalg.norm(bump), item, null), bumps)
        assert found.p_value < 1e-3
        assert (found.x_um, found.y_um) == pytest.approx((4.2, -3.0), abs=0.6)
        assert found.fwhm_um == pytest.approx(0.82, abs=0.1)
        wave = np.cos(2 * np.pi * GRID.x_um / 3) * np.ones((60, 1))
        assert spot(*with_draws(noise + 8 * wave.ravel() / np.linalg.norm(wave), item, null), bumps).p_value > 0.01

    def test_scores_are_standard_deviations(self, item):
        bumps, rng = Bumps.of(item), np.random.default_rng(9)
        squares = np.mean([bumps.scores(rng.standard_normal(4200)) ** 2 for _ in range(60)], axis=0)
        assert squares[:, 12:-12, 12:-12].mean(axis=(1, 2)) == pytest.approx(1, abs=0.15)

    def test_scores_are_standard_deviations_on_islands_as_well(self):
        """Where steep flanks are left out a few points stay here and there; what lies between them says nothing."""
        holes = np.random.default_rng(4).random((60, 70)) > 0.03
        grid = HeightMap(np.ones(holes.shape), 0.4, 0.4)
        islands = np.where(ndimage.binary_dilation(~holes), 1.0, np.nan)
        item = Whitened.of(
            prepare(grid, grid.with_heights(islands), wall_px=0), Uneven(Noise(0.002, 0.006, 1.0, 0.4, 0.4))
        )
        bumps, rng, used = Bumps.of(item), np.random.default_rng(9), item.recording.used
        squares = np.mean([bumps.scores(rng.standard_normal(used.sum())) ** 2 for _ in range(60)], axis=0)
        assert squares[:, used].mean(axis=1) == pytest.approx(1, abs=0.1)


class TestBlemish:
    @staticmethod
    def of(shape, item, null, noise, promised):
        """Return the blemish that noise with a bump of this shape has, and the spot."""
        fit, draws = with_draws(noise + 20 * shape.ravel() / np.linalg.norm(shape), item, null)
        bumps = Bumps.of(item)
        lone = spot(fit, draws, [bumps])
        return blemish(SimpleNamespace(fit=fit, spot=lone), bumps, promised * lone.excess), lone

    @pytest.fixture
    def particle(self):
        return np.exp(-((GRID.x_um - 4.2) ** 2 + (GRID.y_um[:, None] + 3.0) ** 2) / (2 * 0.8**2))

    def test_is_a_spot_that_explains_more_than_any_name_promises(self, item, null, noise, particle):
        found, lone = self.of(particle, item, null, noise, 0.9)
        assert (found.pair, found.x_um, found.y_um, found.excess) == (0, lone.x_um, lone.y_um, lone.excess)
        assert self.of(particle, item, null, noise, 1.1)[0] is None
        assert self.of(particle, item, null, noise, np.inf)[0] is None

    def test_has_the_points_that_it_shows_on_and_no_others(self, item, null, noise, particle):
        found, _ = self.of(particle, item, null, noise, 0.0)
        assert found.points[particle > 0.2].all() and not found.points[particle < 1e-8].any()
        recording = prepare(GRID, GRID)
        left = found.left_out_of(recording)
        assert not left.used[found.points].any()
        assert (left.used == recording.used)[~found.points].all() and recording.used[found.points].any()

    def test_a_spike_is_none_and_a_particle_beside_walls_is_one(self, item, null, noise):
        """Of a particle that shows on few points a bump as narrow as a pixel explains most, but a wide one too."""
        spike = np.zeros(GRID.shape)
        spike[40, 45] = 1.0
        found, lone = self.of(spike, item, null, noise, 0.0)
        assert lone.p_value < SINGLE and found is None
        used = np.zeros(GRID.shape, bool)
        used[::9, ::9] = used[1::9, ::9] = used[::9, 1::9] = True
        few = white_item(used=used)
        particle = np.exp(-((GRID.x_um - 4.2) ** 2 + (GRID.y_um[:, None] + 3.0) ** 2) / (2 * 0.45**2))[used]
        rng = np.random.default_rng(7)
        some = Null(rng.standard_normal((used.sum(), 200)).astype(np.float32))
        found, _ = self.of(particle, few, some, rng.standard_normal(used.sum()), 0.0)
        assert found is not None and found.points[used][particle > 0.5].all()

    def test_noise_has_none_and_what_is_wide_is_none(self, item, null, noise):
        wide = np.exp(-(GRID.x_um**2 + GRID.y_um[:, None] ** 2) / (2 * 6.0**2)) - 0.5
        found, draws = with_draws(noise, item, null)
        quiet = SimpleNamespace(fit=found, spot=spot(found, draws, [Bumps.of(item)]))
        assert blemish(quiet, Bumps.of(item), 0.0) is None
        dome, lone = self.of(wide, item, null, 0.02 * noise, 0.0)
        assert lone.p_value < SINGLE and dome is None


@pytest.mark.slow
def test_ripples_and_spots_have_the_level_they_claim():
    grid, rng = HeightMap(np.ones((24, 24)), 0.4, 0.4), np.random.default_rng(12)
    item = white_item(grid)
    found, bumps = [], [Bumps.of(item)]
    for _ in range(6):
        null = Null(rng.standard_normal((576, 100)).astype(np.float32))
        draws = null.beside(fitted(np.zeros(576), item))
        for one in rng.standard_normal((50, 576)):
            fit = fitted(one, item)
            found.append([one.p_value < 0.05 for one in (ripple(fit, draws), spot(fit, draws, bumps))])
    assert np.mean(found, axis=0) == pytest.approx([0.05, 0.05], abs=0.025)  # two standard deviations of 300 draws


def test_the_largest_score_has_the_level_it_claims():
    rng = np.random.default_rng(8)
    largest = np.array([np.max(rng.standard_normal(2000) ** 2) for _ in range(3000)])
    claimed = np.array([p_of_largest(energy, largest[:1000]) for energy in largest[1000:]])
    assert [np.mean(claimed < level) for level in (0.05, 0.01)] == pytest.approx([0.05, 0.01], abs=0.012)
    assert p_of_largest(25, largest, of=3) == pytest.approx(3 * p_of_largest(25, largest), rel=0.05)


class TestFreeForms:
    def test_edge_distances_know_their_sides(self):
        heights = np.zeros((6, 8))
        heights[2:5, 1:7] = 1.0
        sides = edge_distances(HeightMap(heights, 0.5, 0.25))
        assert sides["left"][3, 1] == pytest.approx(0.25)
        assert sides["right"][3, 1] == pytest.approx(2.75)
        assert sides["upper"][2, 3] == pytest.approx(0.125)
        assert sides["lower"][2, 3] == pytest.approx(0.625)
        assert np.isinf(sides["left"][0, 0])

    def test_every_family_has_words_and_lives_on_the_part_alone(self):
        target = designs.stairs(size_um=20, pitch_um=0.5, margin_um=3, feature_um=2)
        forms = free_forms(target, target.heights_um)
        assert set(forms) == set(WHERE)
        off = target.heights_um == 0
        assert all(not columns[:, off].any() for columns in forms.values())
        assert smooth_forms(target).shape[1:] == target.shape

    def test_splines_add_up_to_one_and_stay_level_outside(self):
        values = np.array([-3.0, 0.0, 0.2, 0.77, 1.0, 9.0])
        found = np.array(splines(values, 6, 0.0, 1.0))
        np.testing.assert_allclose(found.sum(axis=0), 1)
        np.testing.assert_allclose(found[:, [0, -1]], found[:, [1, -2]], atol=1e-6)


class TestForms:
    def test_energy_has_the_level_it_claims_and_the_power_it_should(self, item, null):
        rng = np.random.default_rng(7)
        columns = rng.standard_normal((4200, 12))
        draws = null.beside(fitted(np.zeros(4200), item))
        p_values = [
            Beside.of(fitted(one, item), [columns], draws).energy().p_value for one in rng.standard_normal((200, 4200))
        ]
        assert np.mean(np.array(p_values) < 0.1) == pytest.approx(0.1, abs=0.07)
        strong = Beside.of(fitted(0.2 * columns[:, 0], item), [columns], draws).energy()
        assert strong.excess == pytest.approx(0.04 * np.sum(columns[:, 0] ** 2), rel=0.15)
        assert strong.p_value < 1e-9

    def test_what_the_fit_may_move_is_no_structure(self, item, null, noise):
        fit = fitted(noise + 3.0, item)
        draws = null.beside(fit)
        own = Beside.of(fit, [np.column_stack([np.ones(4200), fit.jacobian])], draws).energy()
        assert (own.excess, own.p_value) == (0.0, 1.0)

    def test_structure_is_as_large_as_it_is(self, item, null, noise):
        """A wave of amplitude 2 in units of the noise of 10 nm: 14.1 nm."""
        wave = np.tile(np.cos(2 * np.pi * GRID.x_um / 5), 60)
        fit = fitted(noise + 2 * wave, item)
        noisy, draws = np.random.default_rng(1).standard_normal((4200, 200)), null.beside(fit)
        with_it = Beside.of(fit, [np.column_stack([noisy[:, :8], wave])], draws)
        assert with_it.structure_um(draws) == pytest.approx(0.0141, rel=0.03)
        assert Beside.of(fitted(noise, item), [noisy], draws).structure_um(draws) < 0.0015  # with noise 2.2 nm

    def test_short_structure_is_not_carried_on_to_long_one(self):
        """In noise that is smooth along the points only the short part of a form weighs, and is all that is there."""
        whiten = sparse.csr_array(sparse.eye(4200) - 0.99 * sparse.eye(4200, k=-1)) / SIGMA_UM
        solve = partial(spsolve_triangular, whiten, lower=True)
        item = SimpleNamespace(recording=white_item().recording, whitener=SimpleNamespace(solve=solve))
        points = np.arange(4200)
        long_um, short_um = 0.05 * np.sin(points / 600), 0.01 * np.cos(points)
        form, rest = ((whiten @ heights) for heights in (long_um + short_um, short_um))
        fit = fitted(rest, item, jacobian=np.zeros((4200, 1)))
        beside = Beside.of(fit, [form[:, None]], fit.beside(np.random.default_rng(3).standard_normal((4200, 50))))
        assert beside.structure_um(np.zeros((4200, 1))) == pytest.approx(0.0014, rel=0.05)  # by weight 36 nm

    def test_energy_along_some_columns_is_theirs_alone(self, item, null, noise):
        columns = np.random.default_rng(7).standard_normal((4200, 6))
        fit = fitted(noise + columns[:, 4], item)
        beside = Beside.of(fit, [columns], null.beside(fit))
        some = beside.energy(np.array([0, 1, 2])), beside.energy(np.array([3, 4]))
        alone = Beside.of(fit, [columns[:, 3:5]], null.beside(fit)).energy()
        assert some[0].p_value > 1e-3 and some[1].excess == pytest.approx(alone.excess)

    def test_recordings_that_want_other_parameters_do_not_agree(self, item, null):
        ramp = np.tile(np.linspace(-1, 1, 70), 60)
        both = Null(np.vstack([null.draws, null.draws[::-1]]))
        rng = np.random.default_rng(3)

        def p_value(second):
            residual = np.concatenate([0.2 * ramp, second * ramp]) + rng.standard_normal(8400)
            fit = fitted(residual, item, item, jacobian=np.tile(ramp, 2)[:, None])
            return agreement(fit, both.beside(fit)).p_value

        assert p_value(0.2) > 0.01 and p_value(-0.2) < 1e-6

    def test_what_is_held_at_an_end_of_its_range_is_no_disagreement(self, item, null):
        """Both recordings push one parameter, the only one, beyond its end."""
        ramp = np.tile(np.linspace(-1, 1, 70), 120)
        fit = fitted(0.5 * ramp, item, item, jacobian=ramp[:, None])
        ended = replace(fit, free=replace(fit.free, high=fit.vector))
        assert (fit.unbound, ended.unbound) == ([0], [])
        found = agreement(ended, Null(np.vstack([null.draws, null.draws[::-1]])).beside(ended))
        assert (found.excess, found.p_value) == (0, 1)

    def test_blocks_of_one_recording_that_want_other_parameters_do_not_agree(self, null, noise):
        wide, small = (white_item(HeightMap(np.ones((60, 70)), pitch, pitch)) for pitch in (0.8, 0.4))
        ramp = np.tile(np.linspace(-1, 1, 70), 60)

        def p_value(right):
            residual = np.where(ramp < 0, 0.4, right) * ramp + noise
            fit = fitted(residual, wide, jacobian=ramp[:, None])
            return agreement(fit, null.beside(fit)).p_value

        assert p_value(0.4) > 0.01 and p_value(-0.4) < 1e-6
        assert agreement(fitted(ramp, small), null.draws) is None


class TestPlaces:
    def test_a_bump_is_located(self):
        holes = np.random.default_rng(0).random((60, 70)) > 0.1
        holes[20:30, 15:35] = False
        noise, grid = Noise(0.005, 0.02, 1.0, 0.4, 0.4), HeightMap(np.ones(holes.shape), 0.4, 0.4)
        recording = prepare(grid, grid.with_heights(np.where(holes, 1.0, np.nan)), wall_px=0)
        item, used = Whitened.of(recording, Uneven(noise)), recording.used
        rows, cols = np.mgrid[: used.shape[0], : used.shape[1]]
        bump = 0.12 * np.exp(-((rows - 45) ** 2 + (cols - 50) ** 2) / (2 * 2.5**2))
        values, bumps = noise.simulate(used.shape, np.random.default_rng(8)), Bumps.of(item)
        quiet, loud = (mismatch(bumps.scores(item.white(v)), used) for v in (values, values + bump))
        assert (quiet > 0.95).mean() < 0.01
        score = bumps.scores(item.white(values + bump))
        row, col = np.unravel_index(np.argmax(np.abs(score).max(axis=0)), used.shape)
        assert np.hypot(row - 45, col - 50) < 3
        assert loud[row, col] > 0.99 and not loud[~used].any()
        x_um, y_um, middle = _box(item, score, loud, local=True)
        assert x_um[0] < middle[0] < x_um[1] and y_um[0] < middle[1] < y_um[1]
        assert middle == pytest.approx((grid.x_um[50], grid.y_um[45]), abs=1.0)
        assert x_um[1] - x_um[0] < 10

    @pytest.mark.parametrize("side", ["left", "right", "lower", "upper"])
    def test_a_mismatch_along_edges_is_named_by_their_side(self, side):
        heights = np.zeros((60, 60))
        for top, bottom, first, last in PADS:
            heights[top:bottom, first:last] = 2.0
        target = HeightMap(heights, 0.4, 0.4)
        item = white_item(target)
        item.white = lambda maps: np.moveaxis(np.asarray(maps), 0, -1).reshape(target.heights_um.size, -1)
        distance = edge_distances(target)[side]
        residual = np.where(target.heights_um > 0, 2 * np.exp(-np.where(np.isfinite(distance), distance, 0)), 0).ravel()
        rng = np.random.default_rng(0)
        fit = replace(
            fitted(residual + rng.standard_normal(residual.size), item),
            traces=(SimpleNamespace(heights_um=target.heights_um),),
        )
        draws = Null(rng.standard_normal((residual.size, 60)).astype(np.float32)).beside(fit)
        forms = Forms.of(fit)
        places, _ = locate(fit, forms, Beside.of(fit, forms.blocks, draws), [Bumps.of(item)], [])
        assert places[0].where == WHERE[f"{side} edges"] and places[0].share > 0.7

    def test_a_spot_that_no_form_follows_is_one(self, item, null, noise):
        ramp = np.tile(GRID.x_um, GRID.shape[0])[:, None]
        bump = np.exp(-((GRID.x_um - 4.2) ** 2 + (GRID.y_um[:, None] + 3.0) ** 2) / (2 * 0.35**2)).ravel()
        found, draws = with_draws(noise + 12 * bump / np.linalg.norm(bump), item, null)
        forms, bumps = Forms(({"x": ramp, "place": ramp**2},)), [Bumps.of(item)]
        lone = spot(found, draws, bumps)
        (place,), _ = locate(found, forms, Beside.of(found, forms.blocks, draws), bumps, [lone])
        assert place.where.startswith("around x = 4.") and "y = -" in place.where
        assert (place.pair, place.p_value) == (0, lone.p_value) and place.x_um[0] < 4.2 < place.x_um[1]


class TestColumns:
    def test_count_where_no_repeat_has_told_them_from_the_print(self):
        sure, none = Unevenness(0.004, 12.0), Unevenness(0.0, 0.0)
        found = Columns.of([SimpleNamespace(source="residual", columns=one) for one in (none, sure)])
        assert (found.pair, found.size_um, found.excess) == (1, 0.004, 12.0)
        assert found.p_value == pytest.approx(1 - (1 - sure.p_value) ** 2)
        assert Columns.of([SimpleNamespace(source="repeats", columns=sure)]).p_value == 1.0


class TestModel:
    @staticmethod
    def of(p_values, excess=10.0):
        forms, wave, lone, columns = p_values
        patterns = Ripple(0, 4.0, 0.0, excess, wave), Spot(0, 0.0, 0.0, 1.0, excess, lone), Columns(0, 0.0, 0.0, 1.0)
        return Model(None, None, None, Energy(excess, forms), *patterns[:2],
                     replace(patterns[2], p_value=columns, excess=excess), None, None)  # fmt: skip

    @pytest.mark.parametrize("way", range(WAYS))
    def test_noise_is_called_structure_in_no_way_more_often_than_the_level(self, way):
        p_values = np.ones(WAYS)
        for share, called in ((0.99, True), (1.01, False)):
            p_values[way] = share * policy.LEVEL_STRUCTURE / WAYS
            assert self.of(p_values).unexplained == called
        assert self.of(np.ones(WAYS)).p_value == 1

    def test_patterns_are_left_over_only_where_they_stand_out(self):
        assert self.of((0.5, 0.5, 0.5, 0.5)).left == 10
        assert self.of((0.5, SINGLE / 2, 0.5, SINGLE / 2)).left == 30
        assert self.of((0.5, 0.5, 0.5, 0.5), excess=-3.0).left == 0

    def test_a_blemish_stays_structure_without_a_name(self):
        gone = Spot(1, 3.0, 2.0, 1.0, 400.0, 1e-20)
        model = replace(self.of((0.5, 0.5, 0.5, 0.5)), left_out=(gone,))
        assert model.left == 410 and model.unexplained and model.patterns[1] is gone
        assert model.residual[1] is model.spot

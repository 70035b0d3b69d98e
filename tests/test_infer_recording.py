"""Recordings as a fit sees them: points that count, pixels that are worked on, predictions that are not repeated."""

from dataclasses import replace

import numpy as np
import pytest

from dlwpredict import designs
from dlwpredict.effects import library
from dlwpredict.errors import InputError, ResultError
from dlwpredict.heightmap import HeightMap, Instrument
from dlwpredict.infer.free import with_values
from dlwpredict.infer.pixels import working_factor
from dlwpredict.infer.priors import CERTIFIED, LATERAL, LEVELLING, NUISANCES
from dlwpredict.infer.recording import check_points, coarser, doubted, prepare, trusted, without_outliers
from dlwpredict.infer.trace import trace
from dlwpredict.metrology.walls import near_walls
from dlwpredict.model.levels import Levels
from dlwpredict.pairing import Pair
from dlwpredict.parameters import Paper, ParameterSet
from dlwpredict.process import predict

TRUTH = ParameterSet(paper=Paper(0.55, 1.7, 0.42, 6.0, 8.0, 0.74, 0.96))
COMMON = {"pitch_um": 0.5, "margin_um": 4.0}


@pytest.fixture(scope="module")
def air() -> HeightMap:
    return designs.air(size_um=24.0, **COMMON)


@pytest.fixture(scope="module")
def printed(air) -> HeightMap:
    return predict(air, TRUTH)


@pytest.fixture(scope="module")
def block() -> HeightMap:
    heights = np.zeros((60, 60))
    heights[10:50, 10:50] = 5.0
    return HeightMap(heights, 0.4, 0.4)


@pytest.mark.parametrize(("recorded_um", "reach_px"), [(None, 3), (0.25, 3), (0.51, 3), (0.6, 4), (1.0, 6)])
def test_a_wall_reaches_three_pixels_of_the_wider_kind(air, printed, recorded_um, reach_px):
    seen = replace(printed, instrument=Instrument(pitch_um=recorded_um))
    np.testing.assert_array_equal(prepare(air, seen).used, ~near_walls(air, reach_px))


class TestWallsOfTheRecording:
    """A part that has shrunk shows its walls beside those of the target; slopes across them are no slopes."""

    def test_a_wall_counts_where_it_was_printed(self, block):
        shrunk = replace(block, heights_um=np.roll(block.heights_um, 2, axis=1))
        used = prepare(block, shrunk).used
        np.testing.assert_array_equal(np.flatnonzero(~used[30]), [*range(7, 15), *range(47, 55)])

    def test_within_a_pixel_it_is_the_same_wall(self, block):
        shrunk = replace(block, heights_um=np.roll(block.heights_um, 1, axis=1))
        np.testing.assert_array_equal(prepare(block, shrunk).used, ~near_walls(block))

    def test_without_displacement_nothing_changes(self, air, printed):
        noisy = replace(printed, heights_um=printed.heights_um + np.random.default_rng(1).normal(0, 0.05, air.shape))
        np.testing.assert_array_equal(prepare(air, noisy).used, ~near_walls(air))

    def test_the_rim_of_a_recording_above_or_below_0_is_no_wall(self):
        heights = np.zeros((60, 60))
        heights[5:55, 5:55] = 5.0
        part = HeightMap(heights, 0.4, 0.4)
        np.testing.assert_array_equal(prepare(part, replace(part, heights_um=heights - 7.0)).used, ~near_walls(part))

    def test_a_particle_a_lone_point_and_a_scar_are_no_walls(self, block):
        heights = block.heights_um.copy()
        heights[28:33, 28:33] += 2.0
        heights[20, 15], heights[40, 20:40] = 9.0, 6.0
        np.testing.assert_array_equal(prepare(block, replace(block, heights_um=heights)).used, ~near_walls(block))

    def test_a_hole_in_the_recording_is_no_wall(self, block):
        heights = block.heights_um.copy()
        heights[:, 8:12] = np.nan
        used = prepare(block, replace(block, heights_um=heights)).used
        np.testing.assert_array_equal(used, ~near_walls(block) & np.isfinite(heights))


class TestTrace:
    def test_is_the_prediction(self, air, printed):
        np.testing.assert_array_equal(trace(air, TRUTH, Levels(1)).heights_um, printed.heights_um)

    @pytest.mark.parametrize(
        ("name", "value", "work"),
        [("shrinkage_min", 0.6, 0.0), ("crosslink_fwhm_z_um", 6.0, 0.3), ("threshold", 0.5, 1.0)],
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
        heights[20:30, 20:29] = printed.heights_um[20:30, 20:29]
        with pytest.raises(ResultError, match=r"90 measured points on the part .* at least 100"):
            check_points([prepare(air, air.with_heights(heights), wall_px=0)])

    def test_coarse_pixels_keep_the_mean_height(self, air, printed):
        pair = coarser(prepare(air, printed, wall_px=0), 2)
        assert pair.target.dx_um == 1.0
        assert pair.target.heights_um.mean() == pytest.approx(air.heights_um.mean())
        assert pair.measured.heights_um.mean() == pytest.approx(printed.heights_um.mean())

    def test_a_wide_pixel_counts_where_most_of_it_did(self):
        heights = np.full((40, 40), 2.0)
        heights[0, 0] = heights[2, 2:4] = heights[4, 4] = heights[5, 4:6] = np.nan
        target = HeightMap(np.full((40, 40), 2.0), 0.5, 0.25)
        used = coarser(prepare(target, target.with_heights(heights), wall_px=0), 2).used
        assert used[0, 0] and not used[1, 1] and not used[2, 2] and used[3:, 3:].all()

    def test_levelling_is_free_where_heights_are_relative_or_nothing_is_trusted(self, air, printed):
        relative = prepare(air, replace(printed, height_reference="relative"))
        assert relative.nuisances == (*LEVELLING, *LATERAL)
        assert trusted(printed) == LATERAL
        assert doubted(prepare(air, printed)).nuisances == (*LEVELLING, *LATERAL)

    @pytest.mark.parametrize(("scale", "left"), [(1.0, CERTIFIED), (0.9985, CERTIFIED), (0.99, 0.01)])
    def test_what_an_alignment_has_taken_out_is_open_beyond_its_certificate(self, air, printed, scale, left):
        """On wider pixels as well; of everything else nothing more is open."""
        own = doubted(prepare(air, replace(printed, instrument=Instrument(scale=scale))))
        for one in (own, coarser(own, 2)):
            open_now = dict(zip(one.nuisances, one.left_open, strict=True))
            assert (one.stretched > 0) is (scale < 0.998)
            assert (open_now["scale_x"], open_now["scale_y"]) == pytest.approx((left, left))
            others = set(open_now) - {"scale_x", "scale_y"}
            assert {name: open_now[name] for name in others} == {name: NUISANCES[name] for name in others}

    def test_lone_points_that_stand_out_do_not_count(self, air, printed):
        recording = prepare(air, printed)
        row, col = np.argwhere(recording.used)[1000]
        residual = 0.01 * np.random.default_rng(0).normal(size=air.shape)
        residual[row, col] = 1.0
        kept = without_outliers(recording, residual, air.heights_um)
        assert recording.used[row, col] and not kept.used[row, col]
        assert kept.points > 0.99 * recording.points


class TestRepeats:
    def test_walls_that_count_in_the_recording_count_in_its_repeat(self, block):
        fine = replace(block, dx_um=0.1, dy_um=0.1)
        pair = Pair.of(fine, fine, ParameterSet(), wall_px=0)
        assert pair.factor == 3 and np.isfinite(pair.repeated(fine).repeats[0].heights_um).all()

    def test_one_of_another_place_is_refused(self, block):
        left, right = (block.with_heights(np.where(half, block.heights_um, np.nan)) for half in self.halves(block))
        pair = Pair.of(block, left, ParameterSet(), working_pitch_um=0)
        with pytest.raises(ResultError, match="again: --repeat: none of its points counts"):
            pair.repeated(right, name="again")

    @staticmethod
    def halves(part):
        left = np.broadcast_to(part.x_um < 0, part.shape)
        return left, ~left


def test_an_instrument_that_leaves_gaps_is_predicted_without(air):
    gaps = ParameterSet(effects=(library()["slope-error"](max_angle_deg=20.0),))
    assert np.isnan(predict(air, gaps, as_measured=True).heights_um).any()
    assert np.isfinite(trace(air, gaps, Levels()).heights_um).all()


class TestPixels:
    def test_working_pixels_are_as_wide_as_the_focus_allows(self):
        part = HeightMap(np.ones((9, 9)), 0.05, 0.05)
        narrow, wide = (ParameterSet(paper=Paper(exposure_fwhm_xy_um=width)) for width in (0.2, 0.4))
        assert working_factor(part, wide) == pytest.approx(2 * working_factor(part, narrow), abs=1)
        assert working_factor(HeightMap(np.ones((9, 9)), 0.5, 0.5), wide) == 1

    @pytest.mark.parametrize(("pitch_um", "sides_px"), [(0.1, (3, 4, 5, 5)), (0.25, (1, 2, 2, 2)), (0.4, (1, 1, 1, 1))])
    def test_of_large_maps_they_are_wider_than_of_small_ones(self, pitch_um, sides_px):
        """As wide as leaves 200² of them, but no wider than loses half of what is known of the focus."""
        parts = [HeightMap(np.ones((n, n)), pitch_um, pitch_um) for n in (200, 800, 1000, 3000)]
        assert tuple(working_factor(part, ParameterSet()) for part in parts) == sides_px
        assert {working_factor(part, ParameterSet(), large_px=np.inf) for part in parts} == {sides_px[0]}

    @pytest.mark.parametrize("wall_px", [None, 1])
    def test_none_counts_that_holds_a_wall(self, wall_px):
        """Of eight pixels each, walls anywhere in them, and walls that are asked not to be left out."""
        edge = np.arange(120)
        steps = np.where((edge > 17) & (edge < 61), 4.0, np.where(edge < 90, 2.0, 6.0))
        part = HeightMap(np.tile(steps, (64, 1)), 0.1, 0.1)
        settings = {} if wall_px is None else {"wall_px": wall_px}
        pair = Pair.of(part, part, ParameterSet(), working_pitch_um=0.8, **settings)
        own = pair.recording.target.heights_um[pair.recording.used]
        assert pair.factor == 8 and len(own) and set(own.round(9)) == {2.0, 4.0, 6.0}
        kept = Pair.of(part, part, ParameterSet(), working_pitch_um=0.8, wall_px=0)
        assert kept.recording.used.all()

    def test_between_many_walls_they_are_narrower(self):
        """Lines seven pixels wide leave one between their walls: no wider pixel would count."""
        lines = np.where(np.arange(160) // 7 % 2, 3.0, 2.0)
        part = HeightMap(np.tile(lines, (160, 1)), 0.1, 0.1)
        pair = Pair.of(part, part, ParameterSet())
        assert working_factor(part, ParameterSet()) == 3 and pair.factor == 1 and pair.recording.points
        none = Pair.of(part, part, ParameterSet(), working_pitch_um=0.4)
        with pytest.raises(ResultError, match="recording: heights: no measured point away from walls is left"):
            check_points([none.recording])

    @pytest.mark.parametrize("slope", [0.3, -0.6])
    def test_holes_on_a_slope_bias_none(self, slope):
        """The mean of some points of a slope is not that of all; what the recording differs by is."""
        heights = 8 + slope * 0.1 * np.add.outer(np.zeros(60), np.arange(60))
        part = HeightMap(heights, 0.1, 0.1)
        holes = np.random.default_rng(0).random(part.shape) < 0.2
        seen = part.with_heights(np.where(holes, np.nan, heights + 0.05))
        worked = coarser(prepare(part, seen, wall_px=0), 3)
        np.testing.assert_allclose((worked.measured.heights_um - worked.target.heights_um)[worked.used], 0.05)

    def test_the_user_may_ask_for_a_pitch(self):
        part = HeightMap(np.ones((9, 9)), 0.1, 0.1)
        assert working_factor(part, ParameterSet(), 0.4) == 4
        assert working_factor(part, ParameterSet(), 0.01) == 1

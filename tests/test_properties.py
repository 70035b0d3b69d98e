"""What holds for every target and every process, without saying what the heights are.

`TOGETHER`: cross-linking is computed on pixels taken together from the map's first one on, and its largest value is
sought on that grid. Where a turned or moved map is cut into other groups, up to this share of what cross-linking adds
to the height may change (0.62 % was the most met). `LEVELS_UM`: what the levels in z leave, µm. `TILES_UM`:
what tiles on disk leave; in 40 draws once 0.2 nm, where test_tiles.py holds them to 0.1. Exposure is computed in single
precision: `ROUNDED` of the full dose, and `SINGLE_UM` of height where it falls steeply.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.special import ndtri

from dlwpredict.files.heightmaps import write_height_map
from dlwpredict.heightmap import HeightMap
from dlwpredict.model.levels import Levels
from dlwpredict.numerics.smoothing import FWHM_PER_SIGMA
from dlwpredict.parameters import Paper, ParameterSet
from dlwpredict.process import predict, room_px
from dlwpredict.tiling.large import Large, canvas_of
from dlwpredict.tiling.reach import coarse_px
from tests.strategies import MONOTONE, between, processes, targets

TOGETHER, LEVELS_UM, TILES_UM, EXACT_UM = 1e-2, 1e-3, 5e-4, 1e-9
ROUNDED, SINGLE_UM = 1e-6, 2e-5
ONE, WHOLE = Levels(threads=1), Levels(threads=1, whole_pixels=True)

properties = settings(max_examples=40, deadline=None, derandomize=True)
few = settings(properties, max_examples=15)


def printed(target: HeightMap, process: ParameterSet, numerics: Levels = ONE) -> np.ndarray:
    return predict(target, process, numerics=numerics).heights_um


def taken_together(target: HeightMap, process: ParameterSet) -> tuple[int, int]:
    return coarse_px(process, target.dx_um, target.dy_um)


def together_um(heights_um: np.ndarray, process: ParameterSet) -> float:
    """Return `TOGETHER` of what cross-linking may add to these printed heights, µm."""
    paper = process.paper
    return TOGETHER * (1 - paper.shrinkage_min / paper.shrinkage_max) * heights_um.max()


def assert_same(
    found: np.ndarray, expected: np.ndarray, target: HeightMap, process: ParameterSet, tolerance_um: float = 0.0
) -> None:
    """Compare prints of one target up to rounding: exposure rounded by `ROUNDED` acts as a threshold moved by as much.

    Where exposure hardly falls with z, beside a wall or in a thin line, that moves the print by nanometres and more.
    """
    threshold = process.paper.threshold
    moved = (replace(process.paper, threshold=np.clip(threshold + d, 0.05, 0.95)) for d in (-ROUNDED, ROUNDED))
    low, high = (printed(target, replace(process, paper=paper)) for paper in moved)
    excess = np.abs(found - expected) - np.abs(high - low) - tolerance_um - SINGLE_UM
    assert excess.max() <= 0, f"{np.abs(found - expected).max():.3g} µm, {excess.max():.3g} too much"


def assert_turned(found: np.ndarray, expected: np.ndarray, target: HeightMap, process: ParameterSet) -> None:
    """Compare a print with that of the target turned or mirrored, up to rounding where the groups stay the same."""
    padded = [n + 2 * r for n, r in zip(target.shape, room_px(target, process), strict=True)]
    whole = all(n % m == 0 for n, m in zip(padded, taken_together(target, process), strict=True))
    assert_same(found, expected, target, process, 0.0 if whole else together_um(expected, process))


class TestSymmetry:
    @pytest.mark.slow
    @properties
    @given(targets(), processes(), st.integers(1, 3))
    def test_a_turned_target_prints_turned(self, target, process, turns):
        pitches = (target.dx_um, target.dy_um) if turns == 2 else (target.dy_um, target.dx_um)
        turned = HeightMap(np.rot90(target.heights_um, turns), *pitches)
        found = np.rot90(printed(turned, process), -turns)
        assert_turned(found, printed(target, process), target, process)

    @pytest.mark.slow
    @properties
    @given(targets(), processes(), st.sampled_from([0, 1]))
    def test_a_mirrored_target_prints_mirrored(self, target, process, axis):
        mirrored = target.with_heights(np.flip(target.heights_um, axis))
        assert_turned(np.flip(printed(mirrored, process), axis), printed(target, process), target, process)

    @pytest.mark.slow
    @properties
    @given(targets(), processes(), st.tuples(*[st.integers(0, 7)] * 4))
    def test_neither_place_nor_room_matters(self, target, process, room):
        """Moving a part is the same as adding empty glass on one side more than on the other."""
        top, bottom, left, right = room
        moved = target.with_heights(np.pad(target.heights_um, ((top, bottom), (left, right))))
        rows, cols = target.shape
        found, expected = printed(moved, process)[top : top + rows, left : left + cols], printed(target, process)
        alone = max(taken_together(target, process)) == 1 and process.readings.crosslink_reference == "bulk"
        assert_same(found, expected, target, process, 0.1 * LEVELS_UM if alone else together_um(expected, process))

    @pytest.mark.slow
    @properties
    @given(targets(), processes(), st.sampled_from([0.5, 2.0]))
    def test_all_lengths_scaled_scale_the_print(self, target, process, factor):
        lengths = {name: factor * value for name, value in vars(process.paper).items() if name.endswith("_um")}
        try:
            scaled = replace(process, paper=replace(process.paper, **lengths))
        except ValueError:
            assume(False)
        part = HeightMap(factor * target.heights_um, factor * target.dx_um, factor * target.dy_um)
        np.testing.assert_allclose(printed(part, scaled), factor * printed(target, process), rtol=0, atol=EXACT_UM)


class TestOrder:
    """With `MONOTONE` readings: exposure grows with the solid, ∫ m_cl dz over a column grows with the exposed solid.

    At the pixels' centres: where an edge runs through a pixel, its share hangs on how steep exposure is there, too.

    Divided by the structure's own maximum, heights elsewhere fall when one place grows: see the last test.
    """

    @properties
    @given(targets(), processes(readings=MONOTONE), st.integers(0, 2**32 - 1), between(0.0, 1.0))
    def test_a_higher_target_never_prints_lower(self, target, process, seed, share):
        rng = np.random.default_rng(seed)
        more = rng.uniform(0, 2, target.shape) * (rng.random(target.shape) < share)
        higher = target.with_heights(target.heights_um + more)
        assert (printed(higher, process, WHOLE) - printed(target, process, WHOLE)).min() >= -LEVELS_UM

    @properties
    @given(targets(), processes(readings=MONOTONE), between(0.05, 0.95))
    def test_a_higher_threshold_never_prints_higher(self, target, process, threshold):
        low, high = sorted([threshold, process.paper.threshold])
        first, second = (replace(process, paper=replace(process.paper, threshold=value)) for value in (low, high))
        assert (printed(target, second) - printed(target, first)).max() <= LEVELS_UM

    @pytest.mark.slow
    @properties
    @given(targets(), processes())
    def test_heights_are_linear_in_both_kappas(self, target, process):
        low, high = process.paper.shrinkage_min, process.paper.shrinkage_max
        one, half = (
            printed(target, replace(process, paper=replace(process.paper, shrinkage_min=a, shrinkage_max=b)))
            for a, b in ((1.0, 1.0), (0.5, 1.0))
        )
        weight = 2 * half - one  # mean cross-linking times exposed height
        np.testing.assert_allclose(printed(target, process), low * one + (high - low) * weight, rtol=0, atol=EXACT_UM)

    def test_a_tower_far_away_lowers_a_part_that_is_divided_by_its_own_maximum(self):
        part = np.zeros((30, 90))
        part[10:20, 5:15] = 2.0
        tower = part.copy()
        tower[5:25, 60:80] = 8.0
        alone, beside = (printed(HeightMap(h, 0.4, 0.4), ParameterSet()) for h in (part, tower))
        assert (beside - alone)[10:20, 5:15].max() < -0.01


class TestComputing:
    """How it is computed does not show."""

    @few
    @given(targets(), processes(), st.integers(2, 8))
    def test_threads(self, target, process, threads):
        many = predict(target, process, numerics=Levels(threads)).heights_um
        np.testing.assert_array_equal(many, printed(target, process))

    @pytest.mark.slow
    @few
    @given(targets(), processes(), st.integers(9, 40))
    def test_tiles_inside_the_levels(self, target, process, side_px):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("dlwpredict.model.exposed_surface.TILE_PX", side_px)
            found = printed(target, process)
        assert_same(found, printed(target, process), target, process, 2 * LEVELS_UM)

    @pytest.mark.slow
    @few
    @given(targets(), processes(), st.integers(12, 60))
    def test_tiles_on_disk(self, tmp_path_factory, target, process, side_px):
        process = replace(process, readings=replace(process.readings, threshold_reference="full_dose"))
        folder = tmp_path_factory.mktemp("tiles")
        exact = target.with_heights(np.float32(target.heights_um))
        write_height_map(folder / "t.tif", exact)
        canvas, _ = canvas_of(folder / "t.tif", exact.heights_um, exact.dx_um, exact.dy_um, process)
        found = np.zeros(exact.shape)
        Large(canvas, process, side_px, threads=1).predict(folder / "work", found)
        assert_same(found, printed(exact, process), exact, process, TILES_UM)

    @pytest.mark.slow
    @properties
    @given(targets(), processes())
    def test_single_precision_heights(self, target, process):
        """A float32 file rounds heights by 3e-8 of themselves; nothing may grow out of that."""
        single = target.with_heights(target.heights_um.astype(np.float32))
        assert_same(printed(single, process), printed(target, process), target, process)


class TestEdgesOfTheLegal:
    @properties
    @given(between(0.3, 8.0), between(0.1, 0.6), st.sampled_from([0, 1]), processes())
    def test_a_line_one_pixel_wide(self, height_um, pitch_um, axis, process):
        """It is a blurred line: never wider than the focus reaches, never higher than a wide block, and straight."""
        line = np.zeros((9, 60))
        line[4] = height_um
        line = line if axis == 0 else line.T
        heights = np.moveaxis(printed(HeightMap(line, pitch_um, pitch_um), process), axis, 0)
        written = np.flatnonzero(heights[:, 30] > 0)
        if written.size:
            reach_px = 5 * process.paper.exposure_fwhm_xy_um / FWHM_PER_SIGMA / pitch_um + 1
            assert np.abs(written - 4).max() <= reach_px
        np.testing.assert_allclose(heights, heights[::-1], rtol=0, atol=together_um(heights, process) + LEVELS_UM)
        assert heights.min() >= 0 and heights.max() <= bound_um(height_um, process)

    @properties
    @given(targets(highest_um=3.0, most_px=6), processes(extreme=True), between(-1.7, 1.0))
    def test_legal_extremes_give_bounded_heights(self, target, process, log_pitch):
        """The focus from a tenth of a pixel to ten times the part, cross-linking from there to far more."""
        pitch_um = process.paper.exposure_fwhm_xy_um * 10**log_pitch
        wide = HeightMap(target.heights_um, pitch_um, pitch_um)
        heights = printed(wide, process)
        assert np.isfinite(heights).all()
        assert heights.min() >= 0 and heights.max() <= bound_um(target.heights_um.max(), process)

    def test_thinner_than_the_focus_resolves_is_not_printed(self):
        line = np.zeros((9, 60))
        line[4] = 5.0
        paper = Paper(exposure_fwhm_xy_um=3.0, threshold=0.9)
        assert printed(HeightMap(line, 0.1, 0.1), ParameterSet(paper=paper)).max() == 0


def bound_um(highest_um: float, process: ParameterSet) -> float:
    """Return κ_max times the exposed height of a wide block at full dose, or of a block exposed wherever there is dose.

    With the threshold a fraction of the structure's own largest exposure the part lies no more than 5 axial standard
    deviations above what was written.
    """
    paper = process.paper
    sigma = paper.exposure_fwhm_z_um / FWHM_PER_SIGMA
    own = process.readings.threshold_reference == "structure_maximum"
    above = 5 * sigma if own else max(-ndtri(paper.threshold), 0) * sigma
    return paper.shrinkage_max * (highest_um + above) * (1 + 1e-3) + LEVELS_UM

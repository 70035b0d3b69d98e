"""Scars: lines of a scan that stand out of a residual are left out and counted, and nothing else is."""

from dataclasses import replace

import numpy as np
import pytest

from dlwpredict import designs
from dlwpredict.alignment.scars import suspected_scars
from dlwpredict.effects import library
from dlwpredict.heightmap import HeightMap, Instrument
from dlwpredict.infer.recording import prepare, without_outliers
from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.lines import Lines
from dlwpredict.noise.unevenness import Uneven
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import predict

SHAPE = 60, 80
FLAT, ALL = np.zeros(SHAPE), np.ones(SHAPE, dtype=bool)
EVEN = Noise(0.005, 0.008, 1.0, 0.3, 0.3)
ROWS = Uneven(EVEN, rows=Lines(white_um=0.005, red_um=0.005, red_lines=4.0, tilt_um=0.006))


def residual(seed: int = 0) -> np.ndarray:
    return ROWS.simulate(SHAPE, np.random.default_rng(seed))


def lines_of(marked: np.ndarray) -> list[int]:
    return marked.any(axis=1).nonzero()[0].tolist()


def test_a_scar_is_marked_where_it_lies():
    """Of 0.12 µm, where means of rows scatter by 7 nm: a whole line, a third of one, two beside each other."""
    heights = residual()
    heights[12] += 0.12
    heights[30, 40:66] -= 0.12
    heights[45:47, 20:] += 0.12
    marked = suspected_scars(heights, ALL, FLAT, 0)
    assert lines_of(marked) == [12, 30, 45, 46]
    assert marked[12].all() and marked[30, 40:66].mean() > 0.8 and marked[45:47, 20:].mean() > 0.9
    assert marked[30, :20].sum() == 0


def test_lines_may_be_columns_and_have_holes():
    heights, used = residual(), np.random.default_rng(1).random(SHAPE) > 0.05
    heights[12] += 0.12
    marked = suspected_scars(heights.T, used.T, FLAT.T, 1)
    assert lines_of(marked.T) == [12]
    assert not marked[~used.T].any()
    assert not suspected_scars(heights, used, FLAT, 1).any()  # across the lines it is one point of each


def test_what_reading_between_lines_gives_the_neighbours_is_marked_as_well():
    heights = residual()
    heights[20:23] += 0.3 * np.array([0.4, 1.0, 0.4])[:, None]
    assert lines_of(suspected_scars(heights, ALL, FLAT, 0)) == [20, 21, 22]


def test_uneven_rows_are_no_scars():
    assert sum(suspected_scars(residual(seed), ALL, FLAT, 0).any() for seed in range(40)) <= 1


@pytest.mark.parametrize("blur", [1.02, 1.2])
@pytest.mark.parametrize("kind", ["stairs", "grating"])
def test_an_edge_of_the_print_along_a_row_is_no_scar(kind, blur):
    """What a focus of a wrong width leaves there: lines of misfit, along rows and along columns."""
    target = getattr(designs, kind)(size_um=24.0, pitch_um=0.4, margin_um=4.0)
    process = ParameterSet()
    wide = replace(process, paper=replace(process.paper, exposure_fwhm_xy_um=blur * process.paper.exposure_fwhm_xy_um))
    printed, expected = predict(target, wide), predict(target, process)
    used = prepare(target, printed).used
    noise = 0.003 * np.random.default_rng(0).standard_normal(target.shape)
    left = np.where(used, printed.heights_um - expected.heights_um + noise, 0.0)
    assert np.abs(left[used]).max() > 0.009
    for axis in (0, 1):
        assert not suspected_scars(left, used, expected.heights_um, axis).any()


def test_a_line_of_misfit_that_the_prints_own_edge_may_leave_is_no_scar():
    """A step of 0.4 µm over two rows, one of which came out 0.12 µm too high: a shift by less than a row does it."""
    heights, surface = residual(), FLAT.copy()
    heights[30] += 0.12
    surface[30], surface[31:] = 0.05, 0.4
    assert lines_of(suspected_scars(heights, ALL, FLAT, 0)) == [30]
    assert not suspected_scars(heights, ALL, surface, 0).any()


def test_a_step_or_a_ridge_of_the_misfit_is_no_scar():
    heights = residual()
    heights[:20] += 0.2
    heights[35:40] += 0.2
    assert not suspected_scars(heights, ALL, FLAT, 0).any()


def test_misfit_that_dies_away_from_what_does_not_count_is_no_scar():
    heights, used = residual(), ALL.copy()
    used[20:26] = False
    heights[26:29] += 0.3 * np.array([1.0, 0.3, 0.1])[:, None]
    assert not suspected_scars(np.where(used, heights, 0.0), used, FLAT, 0).any()


@pytest.mark.parametrize(
    ("name", "switch", "size"),
    [("stitching", "overlap", 0.03), ("stitching", "step_um", 0.1), ("line-length-error", "end_um", -0.1)],
)
def test_what_an_effect_leaves_is_no_scar(name, switch, size):
    target = designs.stairs(size_um=24.0, pitch_um=0.4, margin_um=4.0)
    printed = predict(target, ParameterSet(effects=(library()[name](**{switch: size}),)))
    expected, used = predict(target, ParameterSet()), prepare(target, printed).used
    left = printed.heights_um - expected.heights_um + 0.003 * np.random.default_rng(0).standard_normal(target.shape)
    for axis in (0, 1):
        assert not suspected_scars(np.where(used, left, 0.0), used, expected.heights_um, axis).any()


class TestRecordings:
    TARGET = HeightMap(np.full(SHAPE, 2.0), 0.3, 0.3)

    def without(self, instrument: Instrument, heights: np.ndarray):
        measured = HeightMap(heights + 2.0, 0.3, 0.3, instrument=instrument)
        return without_outliers(prepare(self.TARGET, measured, wall_px=0), heights, self.TARGET.heights_um)

    def test_scars_are_left_out_and_counted_along_the_fast_axis(self):
        heights = residual()
        heights[[12, 40]] += 0.12
        kept = self.without(Instrument("afm", 177.0), heights)
        assert kept.scars == 2
        assert not kept.used[[12, 40]].any() and kept.used.sum() == kept.used.size - 2 * SHAPE[1]
        assert self.without(Instrument("afm", -92.0), heights).scars == 0

    def test_what_is_not_known_to_be_scanned_has_none(self):
        heights = residual()
        heights[12] += 0.12
        kept = self.without(Instrument("confocal"), heights)
        assert kept.scars == 0 and kept.used.all()

"""Inverting known prints: the identity, a scale, the chain itself."""

import numpy as np
import pytest

from dlwpredict.correction.limits import Limits
from dlwpredict.correction.precompensate import precompensate
from dlwpredict.errors import InputError, ResultError
from dlwpredict.heightmap import HeightMap
from dlwpredict.numerics.smoothing import blur
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import predict


@pytest.fixture(scope="module")
def relief() -> HeightMap:
    waves = blur(np.random.default_rng(3).normal(size=(70, 80)), 4, 4)
    return HeightMap(np.pad(6 + waves / waves.std(), 12), 0.4, 0.4)


def scaled(factor):
    return lambda written: written.with_heights(factor * written.heights_um)


def test_identity_returns_the_target(relief):
    found = precompensate(relief, scaled(1.0))
    np.testing.assert_array_equal(found.corrected.heights_um, relief.heights_um)
    assert found.predictions == 1


@pytest.mark.parametrize("factor", [0.8, 0.4, 1.3])
def test_scale_is_inverted(relief, factor):
    found = precompensate(relief, scaled(factor))
    np.testing.assert_allclose(found.corrected.heights_um, relief.heights_um / factor, rtol=5e-3)


@pytest.mark.parametrize("memory", [0, 5])
def test_chain_is_inverted_within_ten_predictions(relief, memory):
    process = ParameterSet()
    found = precompensate(relief, lambda written: predict(written, process), memory=memory)
    figures = found.as_dict()
    assert found.predictions <= 10
    assert figures["reachable"]["largest_to_initial"] < 0.01
    assert figures["reachable"]["fraction"] > 0.98
    print_of_it = predict(found.corrected, process).heights_um
    np.testing.assert_allclose(print_of_it, found.predicted.heights_um, atol=1e-6)


def test_the_search_knows_when_it_has_come_to_rest(relief):
    """A print that answers, but for every second column: their error stays, however many predictions are spent."""

    def deaf(written):
        heights = 0.8 * written.heights_um
        heights[:, ::2] = np.minimum(heights[:, ::2], 4.0)
        return written.with_heights(heights)

    assert precompensate(relief, deaf, most_predictions=2).still_falling
    assert not precompensate(relief, deaf, most_predictions=12, tolerance=1e-9).still_falling


def test_rounding_is_told_from_what_the_search_leaves(relief):
    found = precompensate(relief, scaled(0.8), limits=Limits(slicing_um=0.5))
    assert found.largest_unrounded_um < 0.02
    assert found.as_dict()["reachable"]["largest_um"] == pytest.approx(0.2, abs=0.02)  # half a slice, 0.8 times


def test_swinging_print_is_damped(relief):
    """A print that overshoots by a factor of three drives the plain loop apart."""
    found = precompensate(relief, scaled(3.0), memory=0)
    assert found.damped > 0
    assert found.as_dict()["rmse_um"]["after"] < 0.05 * found.as_dict()["rmse_um"]["before"]


def test_print_that_answers_the_wrong_way_is_refused(relief):
    def contrary(written):
        return written.with_heights(np.where(written.heights_um > 0, 20 - 1.2 * written.heights_um, 0))

    with pytest.raises(ResultError, match="no step lowers"):
        precompensate(relief, contrary)


def test_place_that_never_answers_is_reported(relief):
    def partly_dead(written):
        heights = 0.8 * written.heights_um
        heights[30:40, 30:40] = 4.0
        return written.with_heights(heights)

    found = precompensate(relief, partly_dead)
    expected = np.zeros(relief.shape, dtype=bool)
    expected[30:40, 30:40] = abs(relief.heights_um[30:40, 30:40] - 4) > 0.01 * found.history[0]["largest_um"]
    np.testing.assert_array_equal(~found.reachable, expected)
    assert found.as_dict()["reachable"]["largest_to_initial"] < 0.01


def test_footprint_slices_and_maximum_are_kept(relief):
    limits = Limits(maximum_um=float(relief.heights_um.max()) + 0.3, slicing_um=0.2)
    found = precompensate(relief, scaled(0.9), limits=limits)
    written = found.corrected.heights_um
    np.testing.assert_array_equal(written > 0, relief.heights_um > 0)
    np.testing.assert_allclose(written / 0.2, np.round(written / 0.2), atol=1e-9)
    assert written.max() <= limits.maximum_um
    assert not found.reachable[relief.heights_um > 0.95 * relief.heights_um.max()].any()


def test_target_above_the_maximum_is_refused(relief):
    with pytest.raises(InputError, match="maximum"):
        precompensate(relief, scaled(1.0), limits=Limits(maximum_um=1.0))


class TestLimits:
    footprint = np.array([[True, True, False, True]])

    def test_heights_are_whole_slices_at_least_one_and_none_above_the_maximum(self):
        written = np.array([[0.05, 0.31, 0.0, 0.55]])
        sliced = Limits(maximum_um=0.55, slicing_um=0.2).sliced(written, self.footprint)
        np.testing.assert_allclose(sliced, [[0.2, 0.4, 0.0, 0.4]])

    def test_a_slice_higher_than_anything_that_may_be_written_is_refused(self):
        """No whole number of them would be left, and nothing would be written."""
        with pytest.raises(InputError, match=r"--slicing-um.*0\.6.*0\.0001 to 0\.55"):
            Limits(maximum_um=0.55, slicing_um=0.6)

    @pytest.mark.parametrize("slicing_um", [-0.1, 5e-324, np.inf, np.nan])
    def test_a_slice_of_nearly_nothing_or_of_no_size_is_refused(self, slicing_um):
        with pytest.raises(InputError, match="--slicing-um"):
            Limits(slicing_um=slicing_um)

    def test_something_stays_wherever_the_target_has_something(self):
        target = HeightMap(np.where(self.footprint, 1.5, 0.0).repeat(2, axis=0), 1.0, 1.0)
        clipped = Limits(maximum_um=2.0).within(np.array([[-1.0, 1.0, 1.0, 9.0]] * 2), target)
        np.testing.assert_allclose(clipped, [[0.03, 1.0, 0.0, 2.0]] * 2)


def test_a_design_in_steps_is_reached_within_half_a_step(relief):
    """A print that smooths its steps away has what the design means; a wall of many steps stays out of reach."""
    steps = relief.with_heights(np.round(relief.heights_um / 0.5) * 0.5)

    def smooths(written):
        return written.with_heights(blur(written.heights_um, 1.5, 1.5))

    found = precompensate(steps, smooths, most_predictions=4)
    away = np.abs(found.error_um) <= 0.25
    assert found.reachable[away].all()
    assert not found.reachable[~away].all()

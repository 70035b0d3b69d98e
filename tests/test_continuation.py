"""A map continued across pixels that are not trusted."""

import numpy as np
import pytest

from dlwpredict.numerics.continuation import Continuation


def left_out(rows, *places):
    mask = np.zeros((rows, 12), dtype=bool)
    for place in places:
        mask[place] = True
    return mask


@pytest.mark.parametrize("power", [0, 1, 2])
def test_a_parabola_goes_on_as_it_is(power):
    surface = (np.arange(12.0) - 3.3) ** power + np.linspace(0, 1, 9)[:, None]
    mask = left_out(9, np.s_[:, 9:])
    np.testing.assert_allclose(Continuation.across(mask)(np.where(mask, 1e6, surface)), surface, atol=1e-9)


def test_where_two_are_trusted_a_line_and_where_one_is_its_value():
    values = np.array([[0.0, 1.0, 4.0, 9.0, 0.0, 0.0, 0.0, 0.0, 7.0, 0.0, 0.0, 0.0]])
    mask = left_out(1, np.s_[:, :2], np.s_[:, 4:8], np.s_[:, 9:])
    filled = Continuation.across(mask)(values)[0]
    assert filled[1] == 4 - 5  # the line through 9 and 4
    assert filled[0] == 4  # two steps back from 2 is beyond what is trusted
    assert filled[9] == 7  # nor is what lies one step back here


def test_what_lies_two_steps_back_does_not_count_without_what_lies_one_step_back():
    values = np.array([[5.0, 9.0, 2.0, 9.0] + [0.0] * 8])
    mask = left_out(1, np.s_[:, 1], np.s_[:, 3:])
    assert Continuation.across(mask)(values)[0, 3] == 2


def test_stacks_of_maps_are_continued_one_by_one_and_trusted_pixels_stay():
    maps, mask = np.random.default_rng(2).normal(size=(3, 9, 12)), left_out(9, np.s_[3:6, 4:9])
    continued = Continuation.across(mask)
    np.testing.assert_array_equal(continued(maps), [continued(one) for one in maps])
    np.testing.assert_array_equal(continued(maps)[:, ~mask], maps[:, ~mask])


def test_nothing_left_out_changes_nothing():
    surface = np.random.default_rng(3).normal(size=(9, 12))
    np.testing.assert_array_equal(Continuation.across(left_out(9))(surface), surface)

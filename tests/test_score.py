"""Scores: closed forms, identities, and what is left out."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dlwpredict import plots
from dlwpredict.designs import air, f
from dlwpredict.errors import InputError, ResultError
from dlwpredict.heightmap import HeightMap
from dlwpredict.metrology.score import abbott_curve, corr2, response, roughness, score
from dlwpredict.plots import panels


def maps(reference, test, **options):
    return HeightMap(reference, 0.5, 0.5), HeightMap(test, 0.5, 0.5, **options)


def rough(shape=(20, 30), seed=0):
    return np.random.default_rng(seed).normal(size=shape)


# --- deviations and correlation -------------------------------------------------------------------


@given(st.floats(-5, 5), st.floats(-2, 2), st.integers(0, 20))
def test_rmse_squared_is_offset_free_squared_plus_mean_squared(offset, gain, seed):
    reference = rough(seed=seed)
    result = score(*maps(reference, gain * reference + offset + 0.1 * rough(seed=seed + 1)))
    total = result.rmse_offset_free_um**2 + result.mean_difference_um**2
    assert result.rmse_um**2 == pytest.approx(total, rel=1e-12)


def test_an_offset_is_all_of_the_rmse_and_nothing_of_the_offset_free():
    result = score(*maps(rough(), rough() + 1.5))
    assert (result.rmse_um, result.mean_difference_um) == (pytest.approx(1.5), pytest.approx(1.5))
    assert result.rmse_offset_free_um == pytest.approx(0, abs=1e-12)
    assert result.cc == pytest.approx(1)


def test_the_mean_difference_is_test_minus_reference():
    assert score(*maps(rough(), rough() - 0.25)).mean_difference_um == pytest.approx(-0.25)


@given(st.floats(0.01, 100), st.floats(-100, 100))
def test_cc_is_blind_to_gain_and_offset(gain, offset):
    a, b = rough(seed=1), rough(seed=2)
    assert corr2(a, gain * b + offset) == pytest.approx(corr2(a, b), abs=1e-9)
    assert corr2(a, -gain * b) == pytest.approx(-corr2(a, b), abs=1e-9)


def test_cc_is_the_coefficient_of_pearson():
    a, b = rough(seed=1), rough(seed=1) + rough(seed=2)
    assert corr2(a, b) == pytest.approx(np.corrcoef(a.ravel(), b.ravel())[0, 1], abs=1e-13)


@pytest.mark.parametrize("which", [0, 1])
def test_cc_of_a_constant_map_is_undefined(which):
    pair = [rough(), rough()]
    pair[which] = np.full((20, 30), 0.1)
    assert score(*maps(*pair)).cc is None


# --- roughness ------------------------------------------------------------------------------------


def test_roughness_of_a_sinus_and_of_two_levels():
    phase = 2 * np.pi * (np.arange(1000) + 0.5) / 1000
    assert roughness(3 + np.sin(phase)) == pytest.approx((2 / np.pi, 1 / np.sqrt(2), 2), rel=1e-5)
    assert roughness(np.array([1.0, 1.0, 4.0, 4.0])) == (1.5, 1.5, 3.0)


def test_roughness_is_that_of_the_test_surface():
    assert score(*maps(rough(), 3 * rough())).sq_um == pytest.approx(3 * np.std(rough()))


def test_the_roughness_structure_scores_as_designed():
    target = air(pitch_um=0.5)
    result = score(target, target, part_only=True)
    assert (result.sa_um, result.sq_um) == (pytest.approx(0.615, abs=1e-6), pytest.approx(0.7101, abs=1e-4))
    assert (result.alpha_z, result.rmse_um, result.cc) == (pytest.approx(1), 0, pytest.approx(1))


# --- response of the height axis ------------------------------------------------------------------


@given(st.floats(0.1, 3), st.floats(-10, 10))
def test_a_gain_is_alpha_and_leaves_no_linearity_deviation(gain, offset):
    reference = rough()
    result = score(*maps(reference, gain * reference + offset))
    assert (result.alpha_z, result.alpha_z_full) == (pytest.approx(gain), pytest.approx(gain))
    assert max(result.l_z_um, result.l_z_full_um) == pytest.approx(0, abs=1e-9)


def test_alpha_and_l_are_blind_to_lateral_order():
    reference = rough()
    shuffled = np.random.default_rng(5).permutation(reference.ravel()).reshape(reference.shape)
    result = score(*maps(reference, 0.7 * shuffled))
    assert (result.alpha_z, result.l_z_um) == (pytest.approx(0.7), pytest.approx(0, abs=1e-9))
    assert abs(result.cc) < 0.2


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (0.05, 0.95), (0.2, 0.6)])
def test_a_quadratic_response_has_its_closed_form(low, high):
    """Uniform x on [a, b], y = x + c·x²: α = 1 + c(a + b), l = c·(b − a)²/6, reached at both ends."""
    reach, c = 2.46, 0.05
    x = reach * (np.arange(200_000) + 0.5) / 200_000
    a, b = reach * (1 - high), reach * (1 - low)
    alpha, linearity = response(x, x + c * x**2, low, high)
    assert alpha == pytest.approx(1 + c * (a + b), rel=1e-6)
    assert linearity == pytest.approx(c * (b - a) ** 2 / 6, rel=1e-4)


def test_outliers_move_the_full_range_but_not_the_default_one():
    reference = rough((100, 100))
    spiked = 0.9 * reference
    spiked.flat[:100] = 50.0
    result = score(*maps(reference, spiked))
    assert result.alpha_z == pytest.approx(0.9, abs=0.02)
    assert result.l_z_full_um > 20 > 1 > result.l_z_um


def test_abbott_curve_falls_from_the_highest_to_the_lowest():
    heights = np.array([[3.0, 0.0], [1.0, 2.0]])
    assert abbott_curve(heights, np.array([0.0, 0.125, 0.375, 0.5, 0.875, 1.0])) == pytest.approx([3, 3, 2, 1.5, 0, 0])


def test_alpha_of_a_constant_reference_is_undefined():
    result = score(*maps(np.ones((20, 30)), rough()))
    assert (result.alpha_z, result.l_z_um, result.alpha_z_full, result.l_z_full_um) == (None,) * 4


# --- what enters ----------------------------------------------------------------------------------


def test_points_not_measured_in_either_map_are_left_out():
    reference, test = rough(), rough() + 1
    reference[0, :], test[:, 0] = np.nan, np.nan
    result = score(*maps(reference, test))
    assert (result.points, result.valid_fraction) == (19 * 29, pytest.approx(19 * 29 / 600))
    assert result.rmse_um == pytest.approx(1)


def test_filled_points_are_left_out_unless_asked_for():
    test, filled = rough(), np.zeros((20, 30), dtype=bool)
    test[:2], filled[:2] = test[:2] + 100, True
    without = score(*maps(rough(), test, filled=filled))
    assert (without.rmse_um, without.filled_points, without.filled_points_entered) == (0, 60, 0)
    among = score(*maps(rough(), test, filled=filled), include_filled=True)
    assert (among.filled_points_entered, among.points) == (60, 600)
    assert among.rmse_um == pytest.approx(100 * np.sqrt(0.1))


def test_part_only_leaves_the_substrate_out():
    target = f(pitch_um=0.5)
    whole, part = score(target, target), score(target, target, part_only=True)
    assert part.points == np.sum(target.heights_um > 0)
    assert part.substrate_fraction == 0
    assert whole.substrate_fraction == pytest.approx(1 - part.points / whole.points)
    assert (whole.region, part.region) == ("map", "part")


def test_a_relative_height_is_told():
    assert score(*maps(rough(), rough(), height_reference="relative")).height_reference == "relative"


def test_nothing_in_common_is_no_result():
    holes = np.full((20, 30), np.nan)
    with pytest.raises(ResultError, match="no point"):
        score(*maps(rough(), holes))
    with pytest.raises(ResultError, match="no point"):
        score(*maps(-np.ones((20, 30)), rough()), part_only=True)


@pytest.mark.parametrize("bad", [(0.5, 0.5), (0.9, 0.1), (-0.1, 0.9), (0.1, 1.1), (np.nan, 0.9)])
def test_a_material_ratio_range_outside_0_to_1_is_refused(bad):
    with pytest.raises(InputError, match="material_ratio_range"):
        score(*maps(rough(), rough()), material_ratio_range=bad)


def test_other_grids_are_refused():
    with pytest.raises(InputError, match="grid"):
        score(HeightMap(rough(), 0.5, 0.5), HeightMap(rough(), 0.5, 0.6))


# --- pictures -------------------------------------------------------------------------------------


def test_the_picture_stands_as_the_contract_says():
    """Row 0 on top, x to the right, each pixel where `x_um`, `y_um` say, oblong pixels in proportion."""
    target = f(pitch_um=0.5, pitch_y_um=0.25)
    (image,) = plots.comparison(target, target).axes[0].images
    left, right, bottom, top = image.get_extent()
    assert (left, right) == pytest.approx((target.x_um[0] - 0.25, target.x_um[-1] + 0.25))
    assert (bottom, top) == pytest.approx((target.y_um[-1] - 0.125, target.y_um[0] + 0.125))
    assert image.origin == "upper"
    assert np.array_equal(image.get_array().filled(np.nan), target.heights_um)
    assert image.axes.get_aspect() == 1


def test_profiles_run_upwards_in_x_and_y():
    target = f(pitch_um=0.5, margin_um=0)
    along_x, heights_x = panels.profile(target, "x")
    along_y, heights_y = panels.profile(target, "y")
    assert np.all(np.diff(along_x) > 0)
    assert np.all(np.diff(along_y) > 0)
    assert heights_x[along_x < 0].sum() > heights_x[along_x > 0].sum()
    assert heights_y[along_y > 0].sum() > heights_y[along_y < 0].sum()


def test_colours_of_a_difference_are_symmetric_and_robust():
    difference = HeightMap(np.full((50, 50), -0.1), 1, 1)
    spiked = difference.heights_um.copy()
    spiked[0, 0] = 9
    assert panels.difference_limit(spiked) == pytest.approx(0.1)
    assert panels.difference_limit(np.zeros((3, 3))) > 0


def test_colours_of_heights_show_the_relief_on_a_block_and_the_whole_of_a_low_part():
    low, high = panels.height_limits(air(pitch_um=0.5))
    assert (low, high) == (pytest.approx(9, abs=0.05), pytest.approx(11.46, abs=0.05))
    assert panels.height_limits(f(pitch_um=0.5)) == (0, 5)
    low, high = panels.height_limits(HeightMap(rough(), 1, 1))
    assert low < -1.5 < 1.5 < high
    assert panels.height_limits(HeightMap(np.full((3, 3), np.nan), 1, 1)) == (0, 1)


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["png", "pdf", "svg"])
def test_the_same_picture_has_the_same_bytes(tmp_path, ending):
    target = f(pitch_um=0.5)
    for name in ("first", "second"):
        plots.save(tmp_path / f"{name}.{ending}", plots.comparison(target, target), dpi=50)
    first, second = ((tmp_path / f"{name}.{ending}").read_bytes() for name in ("first", "second"))
    assert first == second


def test_linearity_is_the_largest_distance_on_either_side():
    """Of y = 2x − x² from its regression over 0 to 1: −(x² − x + 1/6), which is −1/6 at both ends and +1/12 between."""
    x = (np.arange(20001) + 0.5) / 20001
    alpha, linearity = response(x, 2 * x - x**2, 0.0, 1.0)
    assert alpha == pytest.approx(1, abs=1e-6)
    assert linearity == pytest.approx(1 / 6, abs=1e-3)

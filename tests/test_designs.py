"""Designs: what each kind promises, and which way round it stands."""

import inspect

import numpy as np
import pytest

from dlwpredict.designs import (
    KINDS,
    air,
    blaze,
    cin,
    f,
    fresnel,
    grating,
    lens,
    lens_array,
    options_of,
    pads,
    posts,
    stairs,
)
from dlwpredict.designs.lenses import sphere
from dlwpredict.errors import InputError
from dlwpredict.metrology.score import roughness

EVERY_KIND = pytest.mark.parametrize("kind", KINDS)


def part_of(height_map, margin_um=10.0):
    rows, cols = (round(margin_um / pitch) for pitch in (height_map.dy_um, height_map.dx_um))
    return height_map.heights_um[rows : height_map.shape[0] - rows, cols : height_map.shape[1] - cols]


@EVERY_KIND
def test_margin_is_bare_and_heights_are_not_negative(kind):
    target = KINDS[kind](pitch_um=0.4, margin_um=4.0)
    margin = np.ones(target.shape, dtype=bool)
    margin[10:-10, 10:-10] = False
    assert np.all(target.heights_um[margin] == 0)
    assert target.heights_um.min() >= 0
    assert target.heights_um.max() > 1


@EVERY_KIND
def test_on_a_block_the_whole_footprint_is_part_of_the_part(kind):
    target = KINDS[kind](pitch_um=0.4, base_um=2.0)
    assert part_of(target).min() > 0


@EVERY_KIND
def test_the_same_call_gives_the_same_heights(kind):
    assert np.array_equal(KINDS[kind](pitch_um=0.4).heights_um, KINDS[kind](pitch_um=0.4).heights_um)


@EVERY_KIND
def test_every_option_is_declared_with_meaning_and_a_default_within_its_range(kind):
    signature = inspect.signature(KINDS[kind])
    for name, declaration in options_of(KINDS[kind]).items():
        assert declaration.meaning
        default = signature.parameters[name].default
        assert default is None or declaration.low <= default <= declaration.high


@EVERY_KIND
def test_every_number_out_of_range_is_refused_by_name(kind):
    for name, declaration in options_of(KINDS[kind]).items():
        with pytest.raises(InputError, match=f"{name}: found") as caught:
            KINDS[kind](**{name: declaration.low - 1})
        assert "allowed" in str(caught.value)


@EVERY_KIND
def test_pixels_may_be_oblong(kind):
    target = KINDS[kind](pitch_um=0.5, pitch_y_um=0.25)
    assert (target.dx_um, target.dy_um) == (0.5, 0.25)
    assert target.size_um[0] == pytest.approx(target.size_um[1], abs=0.5)


def test_size_and_margin_are_rounded_to_whole_pixels():
    assert f(size_um=10.1, pitch_um=0.5, margin_um=1.2).size_um == (12.0, 12.0)


def test_a_footprint_below_two_pixels_or_a_map_beyond_memory_is_refused():
    with pytest.raises(InputError, match=r"size_um: .*2 x 2"):
        f(size_um=0.5, pitch_um=0.5)
    with pytest.raises(InputError, match=r"pitch_um: .*at most"):
        f(size_um=1000, pitch_um=0.01)


# --- calibration structures -----------------------------------------------------------------------


def test_cin_is_ten_plus_minus_one_and_fourfold_symmetric():
    heights = part_of(cin())
    assert heights.min() == pytest.approx(9, abs=1e-3)
    assert heights.max() == pytest.approx(11, abs=0.03)
    for turned in (heights[::-1], heights[:, ::-1], heights.T):
        assert np.allclose(turned, heights, atol=1e-12)


def test_cin_period_grows_linearly_from_the_centre():
    """Between neighbouring crests lies ∫ dr/λ = 1, so crest radii obey λ_next = λ·e^(dλ/dr)."""
    target = cin(pitch_um=0.02, size_um=30.0, margin_um=0, period_min_um=2.0, period_max_um=5.0)
    row = target.heights_um[target.shape[0] // 2]
    inner = row[target.x_um > 0]
    crests = target.x_um[target.x_um > 0][1:-1][(inner[1:-1] > inner[:-2]) & (inner[1:-1] >= inner[2:])]
    growth = 3.0 / 15
    k = np.arange(1, crests.size + 1)
    assert crests.size == 4
    assert crests == pytest.approx(2.0 / growth * np.expm1(growth * k), abs=0.02)


def test_cin_of_one_period_is_the_limit_of_a_weak_chirp():
    plain = cin(period_min_um=4, period_max_um=4).heights_um
    assert np.allclose(plain, cin(period_min_um=4, period_max_um=4 + 1e-7).heights_um, atol=1e-5)


def test_cin_refuses_falling_periods_and_periods_below_two_pixels():
    with pytest.raises(InputError, match="period_max_um: found 2, at least period_min_um = 3"):
        cin(period_max_um=2)
    with pytest.raises(InputError, match=r"period_min_um: .*two pixels"):
        cin(pitch_um=2)


def test_air_has_the_roughness_of_a_uniform_distribution():
    sa, sq, sz = roughness(part_of(air(pitch_um=0.4)))
    assert sa == pytest.approx(2.46 / 4, abs=1e-6)
    assert sq == pytest.approx(2.46 / np.sqrt(12), abs=1e-6)
    assert sz == pytest.approx(2.46, rel=1e-4)


def test_air_abbott_curve_is_a_straight_line():
    ordered = np.sort(part_of(air(pitch_um=0.5)), axis=None)
    line = 9 + 2.46 * (np.arange(ordered.size) + 0.5) / ordered.size
    np.testing.assert_allclose(ordered, line, rtol=0, atol=1e-12)


def test_air_autocorrelation_falls_to_1_over_e_at_the_correlation_length():
    """Rank mapping lowers ρ to (6/π)·asin(ρ/2): 1/e becomes 0.354."""
    heights = part_of(air(size_um=400, pitch_um=1.0, correlation_um=6.0, seed=1))
    heights = heights - heights.mean()
    rho = [np.mean(heights[:, :-6] * heights[:, 6:]), np.mean(heights[:-6] * heights[6:])] / heights.var()
    assert rho == pytest.approx(6 / np.pi * np.arcsin(np.exp(-1) / 2), abs=0.05)


def test_air_of_one_seed_is_one_surface_at_any_pitch():
    fine, coarse = part_of(air(pitch_um=0.2)), part_of(air(pitch_um=0.6, size_um=100.2))
    same = part_of(air(pitch_um=0.2, size_um=100.2))
    assert np.corrcoef(same[1::3, 1::3].ravel(), coarse.ravel())[0, 1] > 0.99999
    assert abs(np.corrcoef(fine.ravel(), part_of(air(seed=1)).ravel())[0, 1]) < 0.3


def test_air_is_similar_to_none_of_its_turns_and_mirrors():
    """About 100 independent patches, 50 of them in a mirror pair: chance gives 0.14, so 0.5 is out of its reach."""
    heights = part_of(air(pitch_um=0.5))
    images = [np.rot90(flip, turn) for flip in (heights, heights.T) for turn in range(4)][1:]
    assert max(abs(np.corrcoef(heights.ravel(), image.ravel())[0, 1]) for image in images) < 0.5


# --- optics ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("parabolic", [False, True])
def test_lens_peak_lies_in_the_centre_and_reaches_the_sag(parabolic):
    target = lens(height_um=4.0, parabolic=parabolic)
    row, col = np.unravel_index(np.argmax(target.heights_um), target.shape)
    assert abs(target.x_um[col]) <= target.dx_um / 2 + 1e-9
    assert abs(target.y_um[row]) <= target.dy_um / 2 + 1e-9
    assert target.heights_um.max() == pytest.approx(2 + 4, abs=1e-3)


def test_lens_of_a_radius_is_that_sphere():
    target = lens(radius_um=100.0, base_um=3.0, margin_um=0)
    x, z = target.x_um[100:150], target.heights_um[125, 100:150]
    y = target.y_um[125]
    sag = 100 - np.sqrt(100**2 - 25**2)
    assert x**2 + y**2 + (z - 3 - sag + 100) ** 2 == pytest.approx(np.full(50, 1e4), rel=1e-9)


def test_weak_sphere_and_paraboloid_of_one_radius_agree():
    sphere_like, parabola = lens(radius_um=5000), lens(radius_um=5000, parabolic=True)
    assert np.allclose(sphere_like.heights_um, parabola.heights_um, atol=1e-6)


def test_cap_without_sag_is_flat():
    assert np.all(sphere(np.linspace(0, 3, 4), 2.0, 0.0) == 0)


def test_lens_refuses_two_shapes_at_once_and_more_than_a_half_sphere():
    with pytest.raises(InputError, match="radius_um: given beside height_um"):
        lens(height_um=2, radius_um=100)
    with pytest.raises(InputError, match="height_um: found 26, at most"):
        lens(height_um=26)
    with pytest.raises(InputError, match="radius_um: found 20, at least"):
        lens(radius_um=20)


def test_lens_array_repeats_one_lens():
    cells = part_of(lens_array(count=3, size_um=60)).reshape(3, 100, 3, 100).transpose(0, 2, 1, 3)
    assert np.allclose(cells, cells[0, 0], atol=1e-9)
    assert np.allclose(cells[0, 0], cells[0, 0][::-1, ::-1], atol=1e-9)


def test_fresnel_rings_fall_at_the_square_roots():
    target = fresnel(pitch_um=0.05, size_um=40, margin_um=0, zones=4, base_um=0)
    right = target.x_um > 0
    row, x = target.heights_um[400][right], target.x_um[right]
    rises = x[1:][np.diff(row) > 1.0]
    assert rises == pytest.approx(20 * np.sqrt(np.array([1, 2, 3]) / 4), abs=0.1)


def test_fresnel_differs_from_its_paraboloid_by_whole_heights():
    aperture, zones, height = 30.0, 5, 2.0
    rings = fresnel(zones=zones, height_um=height, base_um=0)
    full = lens(size_um=60, radius_um=aperture**2 / (2 * zones * height), parabolic=True, base_um=0)
    steps = (full.heights_um - rings.heights_um) / height
    assert np.allclose(steps, np.round(steps), atol=1e-9)


# --- gratings -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("period", "duty"), [(5.0, 0.5), (4.0, 0.25), (1.2, 0.5)])
def test_binary_grating_keeps_period_and_duty_to_a_pixel(period, duty):
    row = part_of(grating(size_um=60, period_um=period, duty=duty))[0]
    assert set(np.unique(row)) == {3.0, 4.0}
    rises, falls = np.flatnonzero(np.diff(row) > 0), np.flatnonzero(np.diff(row) < 0)
    assert set(np.diff(rises)) == {round(period / 0.2)}
    widths = (falls[falls > rises[0]] - rises[: np.sum(falls > rises[0])]) * 0.2
    assert widths == pytest.approx(np.full(widths.size, period * duty), abs=0.11)


def test_gratings_vary_along_x_and_turn_counter_clockwise():
    along_x = part_of(grating(sinus=True, margin_um=0), 0)
    assert np.ptp(along_x, axis=0).max() < 1e-12 < np.ptp(along_x, axis=1).min()
    assert np.allclose(part_of(grating(sinus=True, angle_deg=90)), np.rot90(part_of(grating(sinus=True))), atol=1e-9)
    assert np.allclose(part_of(blaze(angle_deg=90)), np.rot90(part_of(blaze())), atol=1e-9)


def test_the_first_tooth_of_a_blaze_starts_at_the_left_edge():
    """Also where the footprint is no whole number of periods: 50 µm of 4 µm, the first pixel half a pixel in."""
    row = part_of(blaze(period_um=4.0, height_um=1.0, pitch_um=0.2))[0]
    assert row[0] - 3.0 == pytest.approx(0.1 / 4)
    assert row[19] - 3.0 == pytest.approx(3.9 / 4) and row[20] - 3.0 == pytest.approx(0.1 / 4)


def test_blaze_rises_with_x_and_falls_at_once():
    row = part_of(blaze(period_um=5.0, height_um=1.0))[0]
    steps = np.diff(row)
    assert np.sum(steps < 0) == 9
    assert steps[steps > 0] == pytest.approx(np.full(240, 0.2 / 5), abs=1e-9)


# --- steps ----------------------------------------------------------------------------------------


def test_stairs_rise_with_x_on_the_four_plateaus():
    row = part_of(stairs())[0]
    assert row[[0, 99, 100, 199, 200, 299, 300, 399]].tolist() == [4, 4, 7, 7, 10, 10, 13, 13]


def test_stairs_carry_mesas_above_and_wells_below():
    above, below = np.split(part_of(stairs()), 2)
    plateaus = np.repeat([4.0, 7.0, 10.0, 13.0], 100)
    assert set(np.unique(above - plateaus)) == {0.0, 1.5}
    assert set(np.unique(below - plateaus)) == {0.0, -1.5}
    widths = np.sum(above - plateaus > 0, axis=1)[[25, 75, 125, 175]] * 0.2 / 4
    assert widths == pytest.approx([2, 4, 6, 8])


def test_stairs_without_features_are_bare():
    assert set(np.unique(part_of(stairs(feature_um=0)))) == {4.0, 7.0, 10.0, 13.0}


def test_posts_widen_with_x_and_grow_with_y():
    heights = part_of(posts(square=True))
    tops = heights[[37, 112, 187, 262]][:, [37, 112, 187, 262]]
    assert tops.tolist() == [[10.0] * 4, [7.5] * 4, [5.0] * 4, [2.5] * 4]
    widths = [np.sum(heights[37, 75 * i : 75 * i + 75] > 0) * 0.2 for i in range(4)]
    assert widths == pytest.approx([2, 4, 6, 8], abs=0.2)


def test_round_posts_have_the_area_of_a_circle():
    heights = part_of(posts(pitch_um=0.05, count=1, size_um=10, width_min_um=6, width_max_um=6))
    assert np.sum(heights > 0) * 0.05**2 == pytest.approx(np.pi * 9, rel=2e-3)


def test_pads_alternate_between_two_heights():
    heights = part_of(pads())
    centres = heights[50::100, 50::100]
    assert centres[0].tolist() == [10, 4, 10, 4, 10]
    assert centres[1].tolist() == [4, 10, 4, 10, 4]
    assert np.sum(heights > 0) * 0.2**2 == pytest.approx(25 * 100)


@pytest.mark.parametrize(
    ("make", "options", "key"),
    [
        (stairs, {"feature_um": 11}, "feature_um"),
        (stairs, {"feature_height_um": 5}, "feature_height_um"),
        (posts, {"width_max_um": 16}, "width_max_um"),
        (posts, {"width_max_um": 1}, "width_max_um"),
        (pads, {"width_um": 21}, "width_um"),
        (lens_array, {"gap_um": 20}, "gap_um"),
        (fresnel, {"zones": 200}, "zones"),
        (grating, {"duty": 0.02}, "duty"),
        (blaze, {"period_um": 0.3}, "period_um"),
        (air, {"correlation_um": 0.3}, "correlation_um"),
    ],
)
def test_shapes_that_do_not_fit_are_refused_by_option(make, options, key):
    with pytest.raises(InputError, match=key):
        make(**options)


# --- orientation ----------------------------------------------------------------------------------


def test_f_reads_as_an_f():
    drawn = part_of(f(size_um=10, pitch_um=1.0)) > 0
    picture = ["".join(".#"[int(cell)] for cell in row) for row in drawn]
    assert picture == [
        "..######..",
        "..######..",
        "..##......",
        "..##......",
        "..#####...",
        "..#####...",
        "..##......",
        "..##......",
        "..##......",
        "..##......",
    ]


@pytest.mark.parametrize("make", [f, stairs, posts])
def test_no_turn_and_no_mirror_leaves_it_alike(make):
    heights = part_of(make())
    images = [np.rot90(flip, turn) for flip in (heights, heights.T) for turn in range(4)][1:]
    assert min(np.mean(image != heights) for image in images) > 0.02

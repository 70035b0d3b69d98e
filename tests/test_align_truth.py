"""Whole alignments against known poses, and what must be refused."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from dlwpredict import designs
from dlwpredict.alignment import align
from dlwpredict.alignment.pose import Pose
from dlwpredict.alignment.surface import Surface, grid_um
from dlwpredict.errors import InputError, ResultError
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import Paper, ParameterSet
from dlwpredict.process import predict
from tests.bench.recorder import Truth, record
from tests.press import microscope

SMALL = {"size_um": 30.0, "pitch_um": 0.3, "margin_um": 6.0}
EASY = Truth(pitch_um=(0.3, 0.3), field_um=(50.0, 50.0))


def letter() -> HeightMap:
    return designs.f(**SMALL)


def recorded(target: HeightMap, **truth) -> HeightMap:
    return record(target, replace(EASY, **truth), np.random.default_rng(1))


@pytest.mark.slow
@pytest.mark.parametrize(
    "turn", [*(pytest.param(turn, marks=pytest.mark.long) for turn in (0.0, 90.0, -90.0)), 180.0, 33.0]
)
def test_pose_is_found_with_the_signs_of_the_contract(turn):
    found = align(recorded(letter(), rotation_deg=turn, shift_um=(5.0, -3.0)), letter())
    np.testing.assert_allclose(found.pose.shift_um, (5.0, -3.0), atol=0.05 * 0.3)
    assert (found.pose.rotation_deg - turn + 180) % 360 - 180 == pytest.approx(0, abs=0.02)
    assert found.symmetry == "none"
    assert found.cc > 0.95


@pytest.mark.slow
def test_pixels_of_a_quarter_turn_read_in_place():
    """No arithmetic of ours: the picture is turned by numpy and must come back as drawn."""
    target = letter()
    found = align(target.with_heights(np.rot90(target.heights_um)), target)
    assert found.pose.rotation_deg == pytest.approx(90.0, abs=1e-3)
    np.testing.assert_allclose(found.aligned.heights_um, target.heights_um, atol=0.02)


@pytest.mark.slow
def test_tilt_offset_gaps_and_spikes_do_not_move_it():
    truth = {"rotation_deg": 120.0, "shift_um": (4.0, 6.0), "tilt_mrad": (10.0, -7.0), "offset_um": 2.0}
    found = align(recorded(letter(), missing=0.3, spikes=0.003, **truth), letter())
    np.testing.assert_allclose(found.pose.shift_um, (4.0, 6.0), atol=0.05 * 0.3)
    np.testing.assert_allclose(found.tilt_mrad, (10.0, -7.0), atol=0.2)
    assert found.offset_um == pytest.approx(2.0, abs=0.01)
    assert found.aligned.height_reference == "substrate"
    assert found.missing_fraction == pytest.approx(0.3, abs=0.01)
    assert 0.2 < found.aligned.filled.mean() < 0.4
    assert found.rejected_spikes > 50
    bare = letter().heights_um == 0
    assert abs(np.nanmedian(found.aligned.heights_um[bare])) < 0.005


@pytest.mark.slow
@pytest.mark.parametrize("pitch", [(0.09, 0.09), (0.9, 0.9), (0.3, 0.2)])
def test_other_pitches(pitch):
    found = align(recorded(letter(), pitch_um=pitch, rotation_deg=-70.0, shift_um=(-3.0, 2.0)), letter())
    np.testing.assert_allclose(found.pose.shift_um, (-3.0, 2.0), atol=0.05 * 0.3)
    assert found.aligned.same_grid(letter())


@pytest.mark.slow
def test_scale_is_noticed_and_a_rigid_pose_is_left_rigid():
    air = designs.air(size_um=40.0, pitch_um=0.3, margin_um=0.0, base_um=0.5, correlation_um=3.0, seed=2)
    inner = air.with_heights(air.heights_um[15:-15, 15:-15])
    stretched = align(recorded(air, scale=(0.98, 1.003), field_um=(42.0, 42.0)), inner)
    np.testing.assert_allclose(stretched.pose.scale, (0.98, 1.003), atol=5e-4)
    assert stretched.distortion == "affine"
    assert stretched.aligned.height_reference == "relative"
    plain = align(recorded(air, field_um=(42.0, 42.0)), inner)
    assert plain.distortion == "rigid"
    assert plain.pose.scale == pytest.approx((1.0, 1.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scale", "distortion", "left"),
    [((0.985, 0.99), "auto", 0.99), ((0.985, 0.99), "affine", 1.0), ((0.98, 1.003), "auto", 1.0)],
)
def test_what_is_narrower_along_both_axes_may_be_the_print_s(scale, distortion, left):
    """Unless its user says that it is the instrument's; a print does not grow."""
    air = designs.air(size_um=40.0, pitch_um=0.3, margin_um=0.0, base_um=0.5, correlation_um=3.0, seed=2)
    inner = air.with_heights(air.heights_um[15:-15, 15:-15])
    found = align(recorded(air, scale=scale, field_um=(42.0, 42.0)), inner, distortion=distortion)
    assert found.aligned.instrument.scale == pytest.approx(left, abs=5e-4)
    assert found.as_dict()["instrument_scale"] == found.aligned.instrument.scale


def moved(cubic_um) -> tuple[HeightMap, HeightMap, Pose]:
    """Record a rough surface by an instrument whose axes err by a cubic; return the recording, the target, the pose."""
    air = designs.air(size_um=46.0, pitch_um=0.2, margin_um=0.0, base_um=0.5, correlation_um=1.5, seed=2)
    truth = replace(Pose.rigid((0.3, -0.2), 0.6, reach_um=(20.0, 20.0)), cubic_um=cubic_um)
    place = truth.to_target(*grid_um((42.0, 42.0), 0.2))
    heights, _ = Surface(air.heights_um, np.ones(air.shape), 0.2, 0.2).at(*place)
    noise = 0.005 * np.random.default_rng(3).standard_normal(heights.shape)
    return HeightMap(heights + noise, 0.2, 0.2), air.with_heights(air.heights_um[15:-15, 15:-15]), truth


@pytest.mark.slow
@pytest.mark.parametrize("cubic_um", [(0.15, 0.0), (0.0, 0.0)])
def test_an_axis_that_does_not_move_evenly_is_noticed(cubic_um):
    """In eight recordings of real prints the fast axis errs by 60 to 90 nm, to either side: 0.15 µm at the rim."""
    seen, target, truth = moved(cubic_um)
    found = align(seen, target)
    assert found.distortion == ("cubic" if any(cubic_um) else "rigid")
    assert found.as_dict()["cubic_um"] == pytest.approx(cubic_um, abs=0.01)
    assert max(found.uncertainty["cubic_um"]) < 0.01
    x, y = grid_um((40.0, 40.0), 1.0)
    there = np.subtract(found.pose.to_recording(x, y), truth.to_recording(x, y))
    assert np.abs(there).max() < 0.01


@pytest.mark.slow
@pytest.mark.long
def test_the_virtual_microscope_moves_unevenly_too():
    """By a wave over its field, 0.15 µm of it: a cubic and a scale leave less than 0.04 µm of the way."""
    air = designs.air(size_um=40.0, pitch_um=0.25, margin_um=5.0, base_um=2.0, correlation_um=2.0, seed=4)
    lies = microscope.Pose(shift_um=(1.0, -0.5), rotation_deg=2.0, uneven_um=(0.15, 0.0))
    scope = microscope.Microscope(field_um=(60.0, 60.0), pose=lies, noise=microscope.Noise(0.01, 0.5, row_um=0.005))
    seen = microscope.measure(air.heights_um, 0.25, 0.25, scope, seed=3)
    found = align(HeightMap(seen.heights, seen.dx_um, seen.dy_um), air)
    assert found.distortion == "cubic"
    x, y = found.pose.to_recording(*grid_um((40.0, 40.0), 1.0))
    there = x + 0.15 * np.sin(2 * np.pi * x / 60), y  # where the instrument is when it believes to be at x, y
    true = Pose.rigid((1.0, -0.5), 2.0).to_recording(*grid_um((40.0, 40.0), 1.0))
    assert np.abs(np.subtract(there, true)).max() < 0.04


@pytest.mark.slow
def test_what_moves_alike_along_both_axes_may_be_the_print():
    """It holds on to its substrate, and shrinks."""
    seen, target, _ = moved((0.15, 0.15))
    found = align(seen, target)
    assert (found.distortion, found.pose.cubic_um) == ("rigid", (0.0, 0.0))
    assert align(seen, target, distortion="cubic").pose.cubic_um == pytest.approx((0.15, 0.15), abs=0.01)


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("threshold", [0.2, 0.45])
def test_a_lens_that_is_printed_wider_is_no_scale_of_the_microscope(threshold):
    """Walls that the focus has moved pass for a scale, p = 1e-15 and a pixel at the rim; on a relief they do not."""
    process = ParameterSet(paper=Paper(threshold=threshold, exposure_fwhm_xy_um=0.7))
    lens = designs.lens(size_um=24.0, pitch_um=0.4, margin_um=5.0, base_um=3.0, height_um=3.0)
    found = align(recorded(predict(lens, process), field_um=(42.0, 42.0)), lens)
    assert (found.distortion, found.pose.scale) == ("rigid", pytest.approx((1.0, 1.0)))
    assert found.distortion_test["affine"]["untold"]
    air = designs.air(size_um=40.0, pitch_um=0.4, margin_um=5.0, base_um=3.0, correlation_um=4.0, seed=2)
    for scale, distortion in ((1.0, "rigid"), (1.015, "affine")):
        found = align(recorded(predict(air, process), scale=(scale, scale), field_um=(54.0, 54.0)), air)
        np.testing.assert_allclose(found.pose.scale, scale, atol=1e-3)
        assert (found.distortion, found.distortion_test["affine"]["untold"]) == (distortion, False)


@pytest.mark.slow
def test_of_a_lens_only_what_differs_along_its_axes_is_a_scale_of_the_microscope():
    """It is wider by 0.9 %, all of it along x: the difference is told; the mean is left in, and open."""
    process = ParameterSet(paper=Paper(threshold=0.2, exposure_fwhm_xy_um=0.7))
    lens = designs.lens(size_um=24.0, pitch_um=0.4, margin_um=5.0, base_um=3.0, height_um=3.0)
    seen = recorded(predict(lens, process), scale=(1.018, 1.0), field_um=(42.0, 42.0))
    found = align(seen, lens)
    along_x, along_y = found.pose.scale
    assert (along_x - along_y, (along_x + along_y) / 2) == pytest.approx((0.018, 1.0), abs=1.5e-3)
    assert found.distortion_test["affine"]["untold"]
    errors = np.subtract(found.pose.scale, (1.018, 1.0)) / found.uncertainty["scale"]
    assert np.all(np.abs(errors) < 2)
    forced = align(seen, lens, distortion="affine")  # whose mean is wrong by more than it says
    along_x, along_y = forced.pose.scale
    assert along_x - along_y == pytest.approx(0.018, abs=1.5e-3)
    assert (along_x + along_y) / 2 < 1.009 - 3 * max(forced.uncertainty["scale"])


@pytest.mark.slow
def test_mirror_image_is_refused_or_turned_back():
    mirrored = recorded(letter(), mirrored=True, rotation_deg=20.0)
    with pytest.raises(ResultError, match="mirrored"):
        align(mirrored, letter())
    found = align(mirrored, letter(), allow_mirror=True)
    assert found.pose.mirrored
    assert found.pose.rotation_deg == pytest.approx(20.0, abs=0.02)
    assert found.cc > 0.95


@pytest.mark.slow
def test_symmetric_target_takes_the_smallest_rotation_and_says_so():
    lenses = designs.lens_array(height_um=2.0, **SMALL)
    found = align(recorded(lenses, rotation_deg=100.0), lenses)
    assert found.pose.rotation_deg == pytest.approx(10.0, abs=0.05)
    assert found.symmetry == "4-fold"


@pytest.mark.slow
def test_a_known_part_of_a_few_wide_steps_is_laid():
    """Stairs may be refused at a correlation of 0.99: what they share with a part are six points' worth of waves."""
    stairs = designs.stairs(
        size_um=24.8, pitch_um=0.34, margin_um=4.0, base_um=3.1, height_um=5.0, feature_um=2.87, feature_height_um=0.69
    )
    process = ParameterSet(paper=Paper(crosslink_fwhm_xy_um=7.6, exposure_fwhm_xy_um=0.6, exposure_fwhm_z_um=1.5))
    seen = recorded(predict(stairs, process), field_um=(38.8, 38.8), rotation_deg=3.5, shift_um=(1.2, -0.1))
    found = align(seen, stairs, known_part=True)
    assert found.pose.rotation_deg == pytest.approx(3.5, abs=0.05)
    np.testing.assert_allclose(found.pose.shift_um, (1.2, -0.1), atol=0.02)


@pytest.mark.slow
def test_round_part_keeps_rotation_zero_with_an_open_uncertainty():
    x, y = np.meshgrid(np.arange(-60, 61), np.arange(-60, 61))
    ring = HeightMap(2.0 + np.cos(np.hypot(x, y) ** 2 / 250), 0.3, 0.3)
    disc = ring.with_heights(np.where(np.hypot(x, y) < 50, ring.heights_um, 0.0))
    found = align(recorded(disc, rotation_deg=50.0, shift_um=(2.0, 1.0), field_um=(50.0, 50.0)), disc)
    np.testing.assert_allclose(found.pose.shift_um, (2.0, 1.0), atol=0.05 * 0.3)
    assert found.pose.rotation_deg == 0
    assert found.uncertainty["rotation_deg"] > 90
    assert found.symmetry == "round"


@pytest.mark.slow
@pytest.mark.long
def test_a_smooth_round_part_needs_to_be_known():
    """A lens of 500 µm radius in a view of a sphere that shows no edge: any hump would do as well."""
    target = designs.lens(size_um=60.0, margin_um=0.0, pitch_um=0.6, radius_um=500.0)
    x, y = np.meshgrid(0.6 * (np.arange(160) - 79.5), 0.6 * (np.arange(120) - 59.5))
    noise = np.random.default_rng(0).normal(0, 0.01, x.shape)
    seen = HeightMap(3 - (x**2 + y**2) / 1000 + noise, 0.6, 0.6)
    with pytest.raises(ResultError, match=r"round and smooth.*--known-part"):
        align(seen, target)
    found = align(seen, target, known_part=True)
    assert found.symmetry == "round" and found.pose.rotation_deg == 0
    assert found.quality["match_log_odds"] < np.log(100)
    lens = target.heights_um > 2.05
    off = (found.aligned.heights_um - target.heights_um)[
        lens
    ]  # a shift of a sphere is a tilt: the surface is what counts
    assert np.std(off) < 0.03
    with pytest.raises(ResultError, match=r"pixel pitch.*--known-part"):
        align(designs.air(seed=1, **SMALL), designs.air(seed=2, **SMALL))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("recording", "target"),
    [
        (designs.air(seed=1, **SMALL), designs.air(seed=2, **SMALL)),  # one outline, another relief
        (designs.stairs(feature_um=3.0, **SMALL), designs.f(**SMALL)),
        (HeightMap(np.random.default_rng(0).normal(0, 0.01, (150, 150)), 0.3, 0.3), designs.f(**SMALL)),
        (HeightMap(np.add.outer(np.arange(150.0), np.arange(150.0)), 0.3, 0.3), designs.f(**SMALL)),
    ],
    ids=["other roughness", "other part", "noise", "tilted flat"],
)
def test_unrelated_and_featureless_maps_are_refused(recording, target):
    with pytest.raises(ResultError, match=r"match|featureless"):
        align(recording, target)


def test_recording_smaller_than_the_part_is_refused():
    part = recorded(letter(), field_um=(20.0, 20.0))
    with pytest.raises(ResultError, match="smaller than the part"):
        align(part, letter())


@pytest.mark.slow
@pytest.mark.slow
@pytest.mark.parametrize("kind", ["f", "cin"])
@pytest.mark.parametrize("noise_um", [0.0, 0.01])
def test_what_cross_linking_does_to_a_small_part_is_no_scale_of_the_microscope(kind, noise_um):
    """Its reach, 3 µm, is a quarter of the part: shrinkage towards the middle must be among what a print may be."""
    waves = {"period_min_um": 3.0, "period_max_um": 6.0, "base_um": 3.0, "height_um": 1.0} if kind == "cin" else {}
    target = designs.KINDS[kind](size_um=14.0, pitch_um=0.4, margin_um=3.0, **waves)
    printed = predict(target, ParameterSet())
    noise = np.random.default_rng(2).normal(0, noise_um, target.shape)
    found = align(printed.with_heights(printed.heights_um + noise), target)
    assert found.distortion == "rigid"
    np.testing.assert_allclose(found.pose.shift_um, 0, atol=0.02)


def test_keep_missing_leaves_gaps_and_filling_stays_in_the_hull():
    recording = recorded(letter(), missing=0.1)
    kept = align(recording, letter(), keep_missing=True)
    assert kept.aligned.filled is None
    assert 0.03 < kept.aligned.missing_fraction < 0.15
    filled = align(recording, letter())
    assert filled.aligned.missing_fraction == 0
    np.testing.assert_array_equal(filled.aligned.filled, np.isnan(kept.aligned.heights_um))


@pytest.mark.slow
def test_report_reads_back_with_floats_and_an_uncertainty_for_each_figure():
    figures = align(recorded(letter()), letter()).as_dict()
    assert yaml.safe_load(yaml.safe_dump(figures, sort_keys=False)) == figures
    for name in ("shift_um", "rotation_deg", "scale", "tilt_mrad", "offset_um", "cc"):
        assert np.shape(figures[name]) == np.shape(figures["uncertainty"][name])
    assert list(figures)[:10] == [
        "shift_um", "rotation_deg", "scale", "tilt_mrad", "offset_um", "cc", "mirrored", "missing_fraction",
        "filled_points", "height_reference",
    ]  # fmt: skip


def test_unknown_distortion_is_refused():
    with pytest.raises(InputError, match="rigid"):
        align(letter(), letter(), distortion="swirl")

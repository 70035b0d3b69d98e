"""The steps of the alignment, each against a truth that can be derived."""

from dataclasses import replace

import numpy as np
import pytest

from dlwpredict import designs
from dlwpredict.alignment import align
from dlwpredict.alignment.distortion import own_share
from dlwpredict.alignment.evidence import explained_evidence
from dlwpredict.alignment.fill import fill, inside_hull
from dlwpredict.alignment.level import find_plane, substrate
from dlwpredict.alignment.plane import plane_columns, robust_fit
from dlwpredict.alignment.pose import Pose, rotation_matrix
from dlwpredict.alignment.refine import Level, refine
from dlwpredict.alignment.resample import prepared, resample
from dlwpredict.alignment.spikes import suspected_spikes
from dlwpredict.alignment.surface import Surface, grid_um
from dlwpredict.alignment.uncertainty import block_covariance
from dlwpredict.effects.line_length_error import LineLengthError
from dlwpredict.effects.slope_error import SlopeError
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import predict


def test_pose_and_its_inverse_agree_also_with_shear_bow_and_cubic():
    bow, cubic = ((0.2, 0.1, -0.1), (0.0, 0.3, 0.2)), (0.3, -0.2)
    pose = Pose((3.0, -2.0), ((0.9, -0.3), (0.35, 1.1)), bow, cubic, (20.0, 15.0))
    x, y = np.meshgrid(np.linspace(-20, 20, 7), np.linspace(-15, 15, 5))
    np.testing.assert_allclose(pose.to_target(*pose.to_recording(x, y)), (x, y), atol=1e-8)


def test_a_pose_is_told_by_the_figures_it_was_made_of():
    """R(rotation)·[[1, shear], [0, 1]]·diag(scale)."""
    matrix = rotation_matrix(30.0) @ [[1, 0.02], [0, 1]] @ np.diag([0.9, 1.2])
    pose = Pose((1.0, 2.0), tuple(map(tuple, matrix)))
    assert pose.rotation_deg == pytest.approx(30)
    assert pose.scale == pytest.approx((0.9, 1.2))
    assert pose.shear == pytest.approx(0.02)


@pytest.mark.parametrize("turn", [0.0, 90.0])
def test_a_cubic_is_along_the_axes_of_the_recording_and_holds_no_scale(turn):
    """Half the width that the turned target has there is its unit: a line of best fit to it is level."""
    pose = replace(Pose.rigid((0.0, 0.0), turn, reach_um=(20.0, 10.0)), cubic_um=(0.2, 0.0))
    x, y = (values.ravel() for values in np.meshgrid(np.linspace(-20, 20, 401), np.linspace(-10, 10, 401)))
    right, up = np.subtract(pose.to_recording(x, y), Pose.rigid((0.0, 0.0), turn).to_recording(x, y))
    along = x if turn == 0 else -y
    np.testing.assert_allclose(up, 0.0, atol=1e-12)
    np.testing.assert_allclose(right[[np.argmax(along), np.argmin(along)]], (0.2, -0.2))
    assert np.polyfit(along, right, 1) == pytest.approx(0, abs=0.2 / 401)


def test_pose_derivatives_match_differences():
    pose = Pose.rigid((1.0, 2.0), 30.0, reach_um=(10.0, 10.0))
    x, y = np.array([3.0, -7.0]), np.array([5.0, 1.0])
    for model, count in (("shift", 2), ("rigid", 3), ("affine", 6), ("bow", 12), ("cubic", 14)):
        jacobian = pose.jacobian(x, y, model)
        for k, step in enumerate(1e-6 * np.eye(count)):
            moved = np.subtract(pose.moved(step).to_recording(x, y), pose.to_recording(x, y)) / 1e-6
            np.testing.assert_allclose(jacobian[k], moved, atol=1e-4)


def test_a_bow_is_judged_by_itself_beside_a_scale():
    """A lens 5 % wider is a wider lens, a bent one is not a lens: what the first may be says nothing of the second."""
    lens = designs.lens(size_um=24.0, pitch_um=0.4, margin_um=5.0, base_um=3.0, height_um=3.0)
    target = Surface(lens.heights_um, np.ones(lens.shape), 0.4, 0.4)
    shares = {}
    for scale in (1.0, 1.05):
        bent = Pose((0.0, 0.0), ((scale, 0.0), (0.0, scale)), ((0.1, 0.0, 0.0), (0.0, 0.0, 0.0)), reach_um=(17.0, 17.0))
        heights, support = target.at(*bent.to_target(*grid_um((42.0, 42.0), 0.4)))
        seen = Surface(np.where(support > 0.5, heights, 0.0), np.ones(heights.shape), 0.4, 0.4)
        shares[scale] = own_share(refine(Level.of(seen, target, 0.4), bent, "bow"), "bow")
    assert shares[1.05] > 0.5 * shares[1.0] > 0.1


def test_a_relief_that_is_read_to_the_side_of_its_walls_is_not_bent():
    """An instrument that reads slopes as heights shows a relief to the side, and walls where they are."""
    part = designs.air(size_um=60.0, pitch_um=0.3, margin_um=4.0, seed=3)
    aside = ParameterSet(effects=(SlopeError(signed_x_um=0.2),))
    noise = 0.005 * np.random.default_rng(0).standard_normal(part.shape)
    recording = part.with_heights(predict(part, aside, as_measured=True).heights_um + noise)
    assert np.abs(align(recording, part, distortion="bow").pose.bow_um).max() > 0.3
    found = align(recording, part)
    assert found.distortion == "rigid"
    assert not np.any(found.pose.bow_um)
    assert found.distortion_test["bow"]["relief_p_value"] < 1e-3


def test_fill_keeps_a_tilted_plane_and_never_leaves_the_hull():
    row, col = np.indices((40, 50), dtype=float)
    measured = np.hypot(row - 20, col - 25) < 18
    measured[15:25, 20:30] = False
    filled = fill(0.3 * col - 0.2 * row, measured)
    np.testing.assert_allclose(filled[inside_hull(measured)], (0.3 * col - 0.2 * row)[inside_hull(measured)], atol=1e-4)
    assert np.isnan(filled[~inside_hull(measured)]).all()
    assert np.isnan(filled[0, 0])


def test_spikes_are_suspected_edges_are_not():
    heights = np.random.default_rng(0).normal(0, 0.01, (60, 60))
    heights[:, 30:] += 5
    heights[10, 10] += 1
    heights[40, 45] -= 1
    found = np.argwhere(suspected_spikes(heights, np.ones(heights.shape, bool))).tolist()
    assert found == [[10, 10], [40, 45]]


def test_a_finer_recording_is_averaged():
    target = HeightMap(np.zeros((10, 10)), 1.0, 1.0)
    fine = np.tile([0.0, 0.0, 1.0, 1.0], (40, 10))
    surface = prepared(HeightMap(fine, 0.25, 0.25), np.ones((40, 40), bool))
    laid = resample(surface, np.ones((40, 40), bool), target, Pose.rigid((0, 0), 0.0))
    np.testing.assert_allclose(laid.heights_um, 0.5, atol=1e-9)


def recorded(surface, pitch_um, size_um=24.0, fine=8):
    """Return a recording of z = surface(x, y) whose pixels are means, and its surface ready to be read."""
    count = round(size_um / pitch_um)
    line = (np.arange(count * fine) - (count * fine - 1) / 2) * pitch_um / fine
    heights = surface(line, -line[:, None]).reshape(count, fine, count, fine).mean(axis=(1, 3))
    return prepared(HeightMap(heights, pitch_um, pitch_um), np.ones((count, count), bool))


@pytest.mark.parametrize(
    "pitch_um",
    [*(pytest.param(pitch, marks=pytest.mark.slow) for pitch in (0.15, 0.2)), 0.24, 0.3, 0.375, 0.4, 0.5, 0.6],
)
def test_a_pixel_read_from_means_is_the_mean_over_the_targets_own(pitch_um):
    """Of a parabola: z(0) + a·p²/12 + b·p²/12 at every place, whatever the recording's pitch."""
    target, turned = HeightMap(np.zeros((20, 20)), 0.4, 0.4), Pose.rigid((0.13, -0.21), 7.0)
    surface = recorded(lambda x, y: 0.3 * x**2 - 0.1 * y**2 + 0.2 * x * y, pitch_um, fine=40)
    laid = resample(surface, surface.support > 0, target, turned)
    x, y = turned.to_recording(*np.meshgrid(target.x_um, target.y_um))
    expected = 0.3 * x**2 - 0.1 * y**2 + 0.2 * x * y + (0.3 - 0.1) * 0.4**2 / 12
    np.testing.assert_allclose(laid.heights_um[8:12, 8:12], expected[8:12, 8:12], atol=2e-5)


@pytest.mark.parametrize("angle_deg", [0.0, 90.0])
def test_a_pixel_that_is_no_square_lies_as_the_part_does(angle_deg):
    target, turned = HeightMap(np.zeros((20, 20)), 0.5, 0.3), Pose.rigid((0.0, 0.0), angle_deg)
    surface = recorded(lambda x, y: x**2 + 0 * y, 0.3, fine=40)
    laid = resample(surface, surface.support > 0, target, turned)
    x, _ = turned.to_recording(*np.meshgrid(target.x_um, target.y_um))
    expected = x**2 + (0.5 if angle_deg == 0.0 else 0.3) ** 2 / 12
    np.testing.assert_allclose(laid.heights_um[8:12, 8:12], expected[8:12, 8:12], atol=5e-5)


@pytest.mark.parametrize("pitch_um", [0.2, 0.3, 0.4])
def test_a_wall_leaves_no_trace_three_pixels_away(pitch_um):
    """A spline rang there by ten nanometres and more."""
    target, turned = HeightMap(np.zeros((30, 30)), 0.4, 0.4), Pose.rigid((0.1, 0.05), 3.0)
    surface = recorded(lambda x, y: 5.0 * ((np.abs(x) < 3) & (np.abs(y) < 3)), pitch_um)
    laid = resample(surface, surface.support > 0, target, turned).heights_um
    x, y = turned.to_recording(*np.meshgrid(target.x_um, target.y_um))
    outside = np.maximum(np.abs(x), np.abs(y)) - 3
    np.testing.assert_allclose(laid[outside < -1.2], 5.0, atol=1e-12)
    np.testing.assert_allclose(laid[outside > 1.2], 0.0, atol=1e-12)


@pytest.mark.parametrize(("lost", "kept"), [(1, True), (3, False)])
def test_a_pixel_needs_half_of_it_inside_what_was_measured(lost, kept):
    """Of the first target pixel's four columns some lie outside the hull."""
    hull = np.ones((40, 40), bool)
    hull[:, :lost] = False
    surface = prepared(HeightMap(np.ones((40, 40)), 0.25, 0.25), hull)
    laid = resample(surface, hull, HeightMap(np.zeros((10, 10)), 1.0, 1.0), Pose.rigid((0, 0), 0.0))
    assert np.isfinite(laid.heights_um[:, 0]).all() == kept
    assert np.isfinite(laid.heights_um[:, 1:]).all()


def test_points_outside_the_recording_stay_empty():
    target = HeightMap(np.zeros((20, 20)), 1.0, 1.0)
    surface = prepared(HeightMap(np.ones((10, 10)), 1.0, 1.0), np.ones((10, 10), bool))
    laid = resample(surface, np.ones((10, 10), bool), target, Pose.rigid((0, 0), 0.0))
    assert laid.missing_fraction == pytest.approx(0.75)


def test_levelling_on_the_substrate_leaves_the_dome_of_a_print():
    target = designs.pads(size_um=40.0, width_um=4.0, pitch_um=0.5, margin_um=6.0)
    x, y = np.meshgrid(target.x_um, target.y_um)
    dome = np.where(target.heights_um > 0, 0.002 * (x + 5) ** 2 + 0.1 * x, 0.0)
    tilted = target.with_heights(target.heights_um + dome + 0.7 + 0.01 * x - 0.02 * y)
    plane = find_plane(tilted, target, 1.5)
    assert plane.reference == "substrate"
    np.testing.assert_allclose(plane.coefficients, [0.7, 0.01, -0.02], atol=1e-6)


def test_without_substrate_the_plane_is_relative_and_spares_a_slope_of_the_target():
    x, y = np.meshgrid(np.arange(60.0), np.arange(50.0))
    target = HeightMap(5 + 0.1 * x + np.sin(y / 5), 1.0, 1.0)
    assert not substrate(target, 1.5).any()
    recorded = target.with_heights(0.8 * target.heights_um + 0.02 * (y - 24.5))
    plane = find_plane(recorded, target, 1.5)
    assert plane.reference == "relative"
    assert plane.gain == pytest.approx(0.8, abs=1e-6)
    np.testing.assert_allclose(plane.coefficients[1:], [0.0, -0.02], atol=1e-8)


def test_block_errors_hold_when_neighbours_err_together():
    rng = np.random.default_rng(0)
    blocks = np.repeat(np.arange(64), 25)
    columns = np.ones((1600, 1))
    found, claimed = [], []
    for _ in range(200):
        values = np.repeat(rng.standard_normal(64), 25)
        mean = values.mean()
        found.append(mean)
        claimed.append(block_covariance(columns, np.ones(1600), values - mean, blocks)[0][0, 0])
    assert np.sqrt(np.mean(claimed)) == pytest.approx(np.std(found), rel=0.15)
    assert np.std(found) == pytest.approx(1 / 8, rel=0.15)


@pytest.mark.parametrize(("share", "size_um"), [(0.2, 0.2), (0.4, 5.0)])
def test_a_plane_is_found_beside_many_outliers_on_one_side(share, size_um):
    """Few near ones that a wide cut would let in, and many far ones that would spoil a least-squares start."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-10, 10, (2, 4000))
    values = 7.0 + 0.01 * x - 0.02 * y + 0.01 * rng.normal(size=4000)
    values += np.where(rng.random(4000) < share, size_um, 0.0)
    found, _ = robust_fit(plane_columns(x, y), values)
    np.testing.assert_allclose(found, [7.0, 0.01, -0.02], atol=2e-3)


def test_substrate_is_bare_ground_a_margin_away_in_um():
    heights = np.zeros((21, 21))
    heights[10, 10] = 1.0
    bare = substrate(HeightMap(heights, 0.5, 0.25), 1.5)
    assert np.flatnonzero(~bare[10]).tolist() == [8, 9, 10, 11, 12]  # less than 3 pixels of 0.5 µm
    assert np.flatnonzero(~bare[:, 10]).tolist() == list(range(5, 16))  # less than 6 pixels of 0.25 µm


@pytest.mark.slow
def test_offset_and_tilt_are_told_at_the_recordings_centre():
    """The plane 2 µm + 20 mrad·x over a recording in which the part lies 4 µm aside and turned."""
    target = designs.f(size_um=20.0, pitch_um=0.5, margin_um=4.0)
    wide = np.pad(target.heights_um, ((8, 8), (16, 0)))  # the part's centre lies at x = +4 µm
    grid = HeightMap(np.rot90(wide), 0.5, 0.5)  # and after the turn at y = +4 µm
    x, y = np.meshgrid(grid.x_um, grid.y_um)
    found = align(grid.with_heights(grid.heights_um + 2.0 + 0.02 * x - 0.01 * y), target, distortion="rigid")
    np.testing.assert_allclose(found.pose.shift_um, (0.0, 4.0), atol=0.01)
    np.testing.assert_allclose(found.tilt_mrad, (20.0, -10.0), atol=0.05)
    assert found.offset_um == pytest.approx(2.0, abs=2e-3)


def refined(recording, target):
    surfaces = (prepared(one, np.ones(target.shape, bool)) for one in (recording, target))
    return refine(Level.of(*surfaces, target.dx_um), Pose.rigid((0.0, 0.0), 0.3), "rigid")


def test_a_part_is_told_from_its_mirror_image_though_its_lines_are_too_long():
    """Such walls leave a misfit in the finest waves, of which smoothing leaves nothing else."""
    part = designs.stairs(size_um=24.8, pitch_um=0.34, margin_um=4.0, base_um=3.1, height_um=5.0, feature_height_um=0.7)
    printed = predict(part, ParameterSet(effects=(LineLengthError(end_um=0.5),)))
    right, wrong = refined(printed, part), refined(printed.with_heights(printed.heights_um[::-1]), part)
    assert explained_evidence(right) > explained_evidence(wrong) + 50


def test_what_a_robust_fit_leaves_out_counts_where_poses_are_compared():
    """A pose that misses a feature has its points weighted down; the mirrored one of a part with steps won by that."""
    part = designs.stairs(size_um=20.0, pitch_um=0.4, margin_um=4.0)
    surface = prepared(part, np.ones(part.shape, bool))
    fit = refine(Level.of(surface, surface, 0.4), Pose.rigid((0.3, 0.1), 1.0), "rigid", turns=1)
    deaf = replace(fit, weights=fit.weights * np.where(np.abs(fit.residual) > np.std(fit.residual), 0.01, 1.0))
    assert explained_evidence(deaf) == pytest.approx(explained_evidence(fit))
    lost = replace(fit, weights=np.where(np.arange(len(fit.weights)) % 2, fit.weights, 0.0))
    assert explained_evidence(lost) != pytest.approx(explained_evidence(fit), rel=0.05), (
        "what was not measured has no say"
    )

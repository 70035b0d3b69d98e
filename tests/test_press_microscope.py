"""The microscope: poses mean what align.yaml says, pixels are areas, noise has the statistics asked for."""

import numpy as np
import pytest

from tests.press import Microscope, Pose, measure, microscope_from
from tests.press.grid import plane_grid
from tests.press.microscope import Dropouts, Noise, Spikes
from tests.press.noise import correlated


def bump(x0, y0, shape=(101, 121), pitch=0.4, width=1.5):
    """A smooth bump at (x0, y0) um from the centre, y up."""
    grid = plane_grid(shape, pitch, pitch)
    rising = np.exp(-((grid.x[None, :] - x0) ** 2 + (grid.y[:, None] - y0) ** 2) / (2 * width**2))
    return rising[::-1]


def place(heights, dx, dy):
    """Centre of mass in um from the centre, y up."""
    grid = plane_grid(heights.shape, dx, dy)
    weight = heights[::-1] / heights.sum()
    return (weight * grid.x[None, :]).sum(), (weight * grid.y[:, None]).sum()


def test_recording_is_the_part_itself_when_nothing_is_set():
    part = bump(3, -5)
    assert np.array_equal(measure(part, 0.4, 0.4).heights, part)


@pytest.mark.parametrize("angle", [0.0, 12.0, 90.0, -170.0])
@pytest.mark.parametrize("pitch", [(0.4, 0.4), (0.61, 0.83), (0.25, 0.3)])
def test_feature_lies_where_the_truth_says(angle, pitch):
    pose = Pose(shift_um=(1.3, -2.1), rotation_deg=angle, scale=(1.01, 0.98))
    seen = measure(bump(6, 4), 0.4, 0.4, Microscope(pitch_um=pitch, field_um=(60, 60), pose=pose))
    turn = np.radians(seen.truth["rotation_deg"])
    along, across = 6 * seen.truth["scale"][0], 4 * seen.truth["scale"][1]
    expected = (
        seen.truth["shift_um"][0] + along * np.cos(turn) - across * np.sin(turn),
        seen.truth["shift_um"][1] + along * np.sin(turn) + across * np.cos(turn),
    )
    assert place(seen.heights, *pitch) == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("x", [-21.0, -9.0, 12.0])
def test_an_axis_that_does_not_move_evenly_sees_a_feature_early_where_it_runs_ahead(x):
    """It is at x where it believes to be x - a sin(2 pi x / 60), to first order, and as it says along y."""
    pose = Pose(uneven_um=(0.3, 0.0))
    seen = measure(bump(x, 4, shape=(131, 151)), 0.4, 0.4, Microscope(field_um=(60, 60), pose=pose))
    assert place(seen.heights, 0.4, 0.4) == pytest.approx((x - 0.3 * np.sin(2 * np.pi * x / 60), 4), abs=0.02)
    assert seen.truth["uneven_um"] == [0.3, 0.0]


def test_mirrored_file_turned_back_has_the_true_pose():
    pose = Pose(shift_um=(2.0, 1.0), rotation_deg=20)
    plain = measure(bump(6, 4), 0.4, 0.4, Microscope(pose=pose))
    mirrored = measure(bump(6, 4), 0.4, 0.4, Microscope(pose=Pose((2.0, 1.0), 20, mirrored=True)))
    assert np.array_equal(mirrored.heights[:, ::-1], plain.heights)
    assert mirrored.truth["mirrored"]


def test_tilt_and_offset_are_a_plane_of_the_recording():
    pose = Pose(tilt_mrad=(2.0, -3.0), offset_um=0.5)
    seen = measure(np.zeros((41, 51)), 0.4, 0.4, Microscope(pose=pose)).heights
    assert seen[20, 25] == pytest.approx(0.5)
    assert seen[20, 50] - seen[20, 25] == pytest.approx(2e-3 * 10)
    assert seen[0, 25] - seen[20, 25] == pytest.approx(-3e-3 * 8)


def test_coarse_pixels_are_means_over_their_area():
    rng = np.random.default_rng(1)
    part = np.kron(rng.normal(size=(10, 10)), np.ones((4, 4))) * 1e-3
    seen = measure(part, 0.1, 0.1, Microscope(pitch_um=(0.4, 0.4))).heights
    assert np.allclose(seen, part[::4, ::4], atol=6e-4)
    assert seen.mean() == pytest.approx(part.mean(), abs=2e-5)


def test_interpolation_does_not_ring_at_cliffs_and_is_exact_on_waves():
    cliff = np.zeros((60, 60))
    cliff[20:40, 20:40] = 10.0
    seen = measure(cliff, 0.4, 0.4, Microscope(pose=Pose(rotation_deg=7, shift_um=(0.13, 0.07)))).heights
    assert seen.min() >= -1e-9 and seen.max() <= 10 + 1e-9
    grid = plane_grid((80, 80), 0.4, 0.4)
    wave = 10 + np.sin(2 * np.pi * grid.x / 3)[None, :] + 0 * grid.y[:, None]
    moved = measure(wave, 0.4, 0.4, Microscope(pose=Pose(shift_um=(0.15, 0.0)))).heights
    expected = 10 + np.sin(2 * np.pi * (grid.x - 0.15) / 3)
    assert np.abs(moved - expected)[20:-20, 20:-20].max() < 0.005


@pytest.mark.parametrize("kind", ["gaussian", "matern32", "exponential"])
def test_noise_has_the_deviation_and_the_correlation_asked_for(kind):
    grid = plane_grid((400, 400), 0.5, 0.5)
    field = correlated(np.random.default_rng(2), (400, 400), grid, 1.5, kind)
    neighbour = (field[:, 3:] * field[:, :-3]).mean()
    law = {"gaussian": np.exp(-1 / 4), "matern32": (1 + np.sqrt(3)) * np.exp(-np.sqrt(3)), "exponential": np.exp(-1)}
    assert field.std() == pytest.approx(1, abs=0.05)
    assert neighbour == pytest.approx(law[kind], abs=0.05)


def test_steep_places_and_blotches_are_not_measured():
    part = np.zeros((100, 100))
    part[30:70, 30:70] = 8.0
    seen = measure(part, 0.4, 0.4, Microscope(dropouts=Dropouts(max_angle_deg=60, fraction=0.05)))
    lost = np.isnan(seen.heights)
    assert lost[50, 29:31].all() and lost[50, 69:71].all()
    assert 0.05 < lost.mean() < 0.09
    assert seen.truth["missing_fraction"] == pytest.approx(lost.mean())


def test_spikes_rows_and_seeds():
    flat = np.zeros((80, 90))
    scope = Microscope(noise=Noise(sigma_um=0.02, correlation_um=1, row_um=0.01), spikes=Spikes(0.01, 2.0), seed=4)
    one, same, other = (measure(flat, 0.4, 0.4, scope, seed=seed).heights for seed in (4, None, 5))
    assert np.array_equal(one, same) and not np.array_equal(one, other)
    assert 20 < (np.abs(one) > 0.3).sum() < 130


def test_microscope_file_sections_and_refusals():
    scope = microscope_from(
        {"format": "microscope/1", "pitch_um": 0.3, "pixels": [90, 80], "pose": {"rotation_deg": "1e1"}, "seed": 2}
    )
    assert scope.pitch_um == (0.3, 0.3) and scope.pose.rotation_deg == 10
    assert measure(bump(0, 0), 0.4, 0.4, scope).heights.shape == (80, 90)
    with pytest.raises(ValueError, match=r"pose\.turn"):
        microscope_from({"pose": {"turn": 1}})
    with pytest.raises(ValueError, match=r"microscope\.zoom"):
        microscope_from({"zoom": 1})

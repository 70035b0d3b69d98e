"""The chain against closed forms, and the two numerics against each other."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from dlwpredict.designs import stairs
from dlwpredict.effects import library
from dlwpredict.errors import InputError
from dlwpredict.heightmap import HeightMap
from dlwpredict.metrology.walls import near_walls
from dlwpredict.model.exposed_surface import _cubic_root
from dlwpredict.model.layers import Columns, Layers
from dlwpredict.model.levels import Levels
from dlwpredict.model.states import SQUARE_PX, Crosslinked, Dose, Exposed, Focus
from dlwpredict.model.steps import PixelMean
from dlwpredict.model.voxels import Voxels
from dlwpredict.numerics.smoothing import FWHM_PER_SIGMA, blur, blur_turned, gaussian_taps
from dlwpredict.parameters import Paper, ParameterSet, Readings, Writing
from dlwpredict.process import predict, room_px

PITCH = 0.2


def block(height_um=6.0, half_um=8.0, field_um=24.0, pitch=PITCH) -> HeightMap:
    axis = np.arange(round(field_um / pitch)) * pitch - field_um / 2 + pitch / 2
    inside = abs(axis) < half_um
    return HeightMap(height_um * np.outer(inside, inside), pitch, pitch)


def uneven(seed=0, pitch=PITCH) -> HeightMap:
    rng = np.random.default_rng(seed)
    relief = blur(rng.normal(size=(90, 80)), 5, 5)
    heights = np.pad(5 + relief / relief.std(), 15)
    return HeightMap(heights, pitch, pitch)


def with_paper(**values) -> ParameterSet:
    return ParameterSet(paper=Paper(**values))


class TestSmoothing:
    def test_half_plane_becomes_erf_edge(self):
        plane = np.zeros((3, 201))
        plane[:, :100] = 1
        edge = blur(plane, 0, 8.0)[1, 50:]
        np.testing.assert_allclose(
            edge, ndtr((99.5 - np.arange(50, 201)) / 8.0), atol=1.7e-4
        )  # midpoint rule: max|φ'|/(24 σ²)

    def test_blurs_add_in_quadrature(self):
        spot = np.zeros((81, 81))
        spot[40, 40] = 1
        np.testing.assert_allclose(blur(blur(spot, 3, 3), 4, 4), blur(spot, 5, 5), atol=1e-7)

    @pytest.mark.parametrize("sigma", [0.05, 0.2, 0.5, 0.99, 1.01, 2.0, 30.0])
    def test_taps_keep_sum_and_variance(self, sigma):
        taps = gaussian_taps(sigma)
        n = np.arange(len(taps)) - len(taps) // 2
        assert taps.sum() == pytest.approx(1, abs=1e-12)
        assert taps @ n**2 == pytest.approx(sigma**2, rel=2e-5)
        assert (taps >= 0).all()

    def test_a_width_is_the_whole_one_at_half_the_height(self):
        spot = np.zeros((61, 61))
        spot[30, 30] = 1
        cloud = Focus(1.0, 10.0, 16.0, 1.0).spread(spot, 1.0, 1.0)
        assert cloud[30, 35] / cloud[30, 30] == pytest.approx(0.5, rel=1e-6)
        assert cloud[38, 30] / cloud[30, 30] == pytest.approx(0.5, rel=1e-6)

    @pytest.mark.parametrize("angle_deg", [0.0, 90.0])
    def test_a_square_pixel_has_the_exposure_of_the_parts_that_it_is_made_of(self, angle_deg):
        """Written as one pixel or as five by five fifths of it, the exposure at its centre is the same."""
        heights = np.pad(np.random.default_rng(2).uniform(1, 3, (24, 30)), 5)
        parts, focus = np.kron(heights, np.ones((5, 5))), Focus(1.0, 0.5, 0.7, 1.5, angle_deg=angle_deg)
        exact = focus.spread(parts, 0.08, 0.06)[2::5, 2::5]
        square, point = (replace(focus, square_px=s).spread(heights, 0.4, 0.3) for s in (SQUARE_PX, 0.0))
        assert np.std(square - exact) < 0.2 * np.std(point - exact)

    def test_a_pixel_shows_the_mean_over_it(self):
        """Of a wave, exactly sinc(kp/2); a wall stays where it is, give or take a sixth of a pixel's width."""
        x = 0.3 * np.arange(80)
        wave, wall = np.cos(1.1 * x), np.where(x > 12, 30.0, 0.0)
        shown = [PixelMean()(HeightMap(np.tile(line, (6, 1)), 0.3, 0.7)).heights_um[3] for line in (wave, wall)]
        np.testing.assert_allclose(shown[0][2:-2], np.sinc(1.1 * 0.3 / 2 / np.pi) * wave[2:-2], atol=2e-4)
        assert np.abs(shown[1] - wall).max() == pytest.approx(4 * 0.3 / 24)

    def test_turned_gaussian_agrees_with_axis_parallel_one(self):
        plane = np.random.default_rng(1).normal(size=(40, 50))
        np.testing.assert_allclose(blur_turned(plane, np.diag([4.0, 9.0])), blur(plane, 3, 2), atol=1e-12)
        np.testing.assert_allclose(blur_turned(plane, np.diag([0.09, 0.36])), blur(plane, 0.6, 0.3), atol=1e-12)

    def test_turned_gaussian_turns_counter_clockwise_seen_from_above(self):
        spot = np.zeros((61, 61))
        spot[30, 30] = 1
        cloud = Focus(1.0, 9.0, 3.0, 1.0, angle_deg=30.0).spread(spot, 1.0, 1.0)
        x = np.arange(61) - 30
        y = 30 - np.arange(61)
        xy = np.einsum("rc,r,c->", cloud, y, x)
        expected = 0.5 * (81 - 9) / FWHM_PER_SIGMA**2 * np.sin(np.deg2rad(60))
        assert xy == pytest.approx(expected, rel=1e-3)

    @pytest.mark.parametrize("angle_deg", [1.0, 20.0, 45.0, 73.0, 110.0])
    @pytest.mark.parametrize("wide, narrow", [(0.86, 0.39), (0.3, 0.1), (0.2, 0.05), (4.0, 0.5)])
    def test_a_turned_gaussian_narrower_than_a_pixel_keeps_its_shape(self, angle_deg, wide, narrow):
        turn = np.deg2rad(angle_deg)
        axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        covariance = axes @ np.diag([wide**2, narrow**2]) @ axes.T
        spot = np.zeros((101, 101))
        spot[50, 50] = 1
        cloud = blur_turned(spot, covariance)
        offsets = np.arange(101) - 50
        along = [np.sum(cloud * offsets**2), -offsets @ cloud @ offsets, offsets**2 @ cloud.sum(axis=1)]
        assert along == pytest.approx(covariance.ravel()[[0, 1, 3]], rel=1e-4, abs=1e-6)
        assert cloud.sum() == pytest.approx(1) and cloud.min() > -1e-12


class TestChain:
    def test_interior_of_a_large_block_is_exposed_to_its_closed_form(self):
        p = 0.3
        part = block(height_um=8.0)
        dose = Dose(part, (Focus(1.0, 0.5, 0.5, 1.5),), Levels())
        exposed = Levels().exposed(dose, p, "full_dose").surface.heights_um
        assert exposed[60, 60] == pytest.approx(8.0 - 1.5 / FWHM_PER_SIGMA * ndtri(p), abs=2e-5)

    def test_a_plate_whose_exposure_ends_below_the_glass_is_not_printed(self):
        """Exposure would end at h − s_z·Φ⁻¹(P) = −0.1 µm, and nothing polymerises inside the glass."""
        height = 1.5 / FWHM_PER_SIGMA * ndtri(0.9) - 0.1
        assert predict(block(height_um=height), with_paper(threshold=0.9)).heights_um.max() == 0

    def test_equal_kappas_scale_the_exposed_height(self):
        part = block(height_um=5.0)
        printed = predict(part, with_paper(shrinkage_min=0.8, shrinkage_max=0.8)).heights_um
        assert printed[60, 60] == pytest.approx(0.8 * 5.0, abs=2e-5)

    def test_threshold_one_half_leaves_a_straight_edge_in_place(self):
        part = block()
        printed = predict(part, ParameterSet()).heights_um
        corner = round(0.6 / PITCH)
        rows = np.flatnonzero((part.heights_um > 0).any(axis=1))[corner:-corner]
        np.testing.assert_array_equal(printed[rows] > printed.max() / 2, part.heights_um[rows] > 0)

    def test_flat_block_rises_towards_its_centre(self):
        printed = predict(block(), ParameterSet()).heights_um
        assert printed[60, 60] > printed[60, 30] + 0.1

    def test_column_mean_of_a_wide_block_is_its_closed_form(self):
        """Far from the walls m_cl depends on z alone; its mean and its largest value are integrals of Φ."""
        top, s = 6.0, 3.0 / FWHM_PER_SIGMA
        part = block(height_um=top, half_um=16, field_um=44, pitch=0.4)
        paper = {"crosslink_fwhm_xy_um": 3.0, "crosslink_fwhm_z_um": 3.0}
        printed = predict(part, with_paper(**paper)).heights_um
        z = np.linspace(0, top, 20001)
        m_cl = ndtr(z / s) - ndtr((z - top) / s)
        kappa = 0.7 + 0.3 * np.trapezoid(m_cl, z) / top / m_cl.max()
        assert printed[55, 55] == pytest.approx(kappa * top, abs=1e-4)

    @pytest.mark.parametrize("turns", [1, 2, 3])
    def test_quarter_turn_equivariance(self, turns):
        part = uneven()
        turned = HeightMap(np.rot90(part.heights_um, turns), PITCH, PITCH)
        expected = np.rot90(predict(part, ParameterSet()).heights_um, turns)
        np.testing.assert_allclose(predict(turned, ParameterSet()).heights_um, expected, atol=2e-4)

    def test_mirror_equivariance(self):
        part = uneven()
        mirrored = part.with_heights(part.heights_um[:, ::-1])
        expected = predict(part, ParameterSet()).heights_um[:, ::-1]
        np.testing.assert_allclose(predict(mirrored, ParameterSet()).heights_um, expected, atol=2e-4)

    def test_same_widths_in_um_on_another_pitch(self):
        coarse, fine = block(pitch=0.4), block(pitch=0.1)
        a = predict(coarse, ParameterSet()).heights_um
        b = predict(fine, ParameterSet()).heights_um
        centre = (b[118, 118] + b[119, 119] + b[120, 120] + b[121, 121]) / 4
        assert a[29:31, 29:31].mean() == pytest.approx(centre, abs=1e-3)

    def test_part_at_the_border_is_surrounded_by_empty_resin(self):
        part = block(half_um=6, field_um=12)
        roomy = block(half_um=6, field_um=24)
        inner = predict(roomy, ParameterSet()).heights_um[30:90, 30:90]
        np.testing.assert_allclose(predict(part, ParameterSet()).heights_um, inner, atol=1e-4)

    @pytest.mark.parametrize(("height_um", "sliced_um"), [(5.2, 5.0), (5.3, 5.5)])
    def test_slicing_rounds_to_whole_slices(self, height_um, sliced_um):
        sliced = ParameterSet(paper=Paper(shrinkage_min=1, shrinkage_max=1), writing=Writing(slicing_um=0.5))
        assert predict(block(height_um=height_um), sliced).heights_um[60, 60] == pytest.approx(sliced_um, abs=1e-4)

    def test_structure_maximum_exposes_what_full_dose_does_not(self):
        thin = block(half_um=0.3)
        paper = Paper(threshold=0.9)
        full = predict(thin, ParameterSet(paper=paper, readings=Readings("full_dose"))).heights_um
        own = predict(thin, ParameterSet(paper=paper, readings=Readings("structure_maximum"))).heights_um
        assert full.max() == 0 < own.max()

    def test_bulk_reference_shrinks_a_small_part_more(self):
        small = block(half_um=2)
        own = predict(small, ParameterSet()).heights_um.max()
        bulk = predict(small, ParameterSet(readings=Readings(crosslink_reference="bulk"))).heights_um.max()
        assert bulk < own - 0.5


PROCESSES = [
    Paper(),
    Paper(0.4, 2.0, 0.42, 5.0, 6.0, 0.72, 0.95),
    Paper(0.7, 1.2, 0.58, 4.0, 8.0, 0.65, 0.9),
]


class TestNumericsAgree:
    @pytest.mark.slow
    @pytest.mark.parametrize("paper", PROCESSES)
    def test_voxels_converge_to_levels_linearly(self, paper):
        part = uneven()
        fast = predict(part, ParameterSet(paper=paper), numerics=Levels(whole_pixels=True)).heights_um
        errors = []
        for slice_um in (0.08, 0.04, 0.02):
            voxel = predict(part, ParameterSet(paper=paper), numerics=Voxels(slice_um)).heights_um
            errors.append(np.sqrt(np.mean((voxel - fast)[fast > 0] ** 2)))
        quantisation = 0.02 / np.sqrt(12)
        assert errors[2] < 1.15 * quantisation
        assert errors[1] / errors[2] == pytest.approx(2, rel=0.15)
        assert errors[0] / errors[1] == pytest.approx(2, rel=0.15)

    def test_voxels_do_not_depend_on_the_memory_allowed(self):
        part = uneven()
        whole = predict(part, ParameterSet(), numerics=Voxels(0.2))
        blocks = predict(part, ParameterSet(), numerics=Voxels(0.2, memory_mb=1))
        np.testing.assert_allclose(blocks.heights_um, whole.heights_um, atol=2e-5)

    def test_a_voxel_is_asked_for_its_dose_at_its_centre(self):
        np.testing.assert_allclose(Voxels(0.2).centres(3), [0.1, 0.3, 0.5])

    def test_levels_do_not_depend_on_tiles(self, monkeypatch):
        part = uneven()
        whole = predict(part, ParameterSet()).heights_um
        monkeypatch.setattr("dlwpredict.model.exposed_surface.TILE_PX", 23)
        np.testing.assert_allclose(predict(part, ParameterSet()).heights_um, whole, atol=2e-3)


@pytest.mark.parametrize(
    ("heights", "said"),
    [
        (np.zeros((4, 4)), "nothing written"),
        (np.full((4, 4), -1.0), "at least 0"),
        (np.array([[1, np.nan], [1, 1]]), "complete"),
    ],
)
def test_targets_that_cannot_be_written_are_refused(heights, said):
    with pytest.raises(InputError, match=said):
        predict(HeightMap(heights, 1, 1), ParameterSet())


class TestUnderAFit:
    def test_the_levels_stay_while_the_focus_changes(self):
        """What a slight change of the focus does, it does in proportion, to a hundredth; moving levels spoil 4 %."""
        widths = 1.48 * (1 + 0.01 * np.arange(-3, 4))
        papers = [with_paper(exposure_fwhm_z_um=width) for width in widths]
        found = np.array([predict(uneven(), paper, numerics=Levels(whole_pixels=True)).heights_um for paper in papers])
        change, bend = (np.sqrt(np.mean(np.diff(found, order, axis=0) ** 2)) for order in (1, 2))
        assert 0 < bend < 0.01 * change


class TestEdges:
    """Where the edge of the exposed resin runs through a pixel."""

    @pytest.mark.parametrize("pitch", [0.2, 0.25])
    @pytest.mark.parametrize("threshold", [0.33, 0.41, 0.5, 0.62])
    def test_a_wall_stands_where_exposure_meets_the_threshold(self, threshold, pitch):
        """At s_xy·Φ⁻¹(1 − P) outside; the area between two squares leaves their corners out."""
        paper = Paper(0.6, 0.2, threshold, shrinkage_min=1.0, shrinkage_max=1.0)
        halves = 3.0, 5.0
        maps = [predict(block(4.0, half, 16.0, pitch), ParameterSet(paper=paper)).heights_um for half in halves]
        areas = [heights.sum() * pitch**2 / heights.max() for heights in maps]
        sides = [2 * half for half in halves]
        out = (areas[1] - areas[0] - sides[1] ** 2 + sides[0] ** 2) / (4 * (sides[1] - sides[0]))
        assert out == pytest.approx(-0.6 / FWHM_PER_SIGMA * ndtri(threshold), abs=0.012)

    def test_a_wall_that_moves_a_little_changes_the_part_a_little(self):
        """With whole pixels a threshold that is 0.002 higher lowers points far from walls by 10 nm at once."""
        part = block(6.0, 4.0, 12.0, 0.4)
        inside = (part.heights_um > 0) & ~near_walls(part)

        def largest_step(numerics):
            thresholds = np.arange(0.12, 0.16, 0.002)
            maps = [predict(part, with_paper(threshold=p), numerics=numerics).heights_um[inside] for p in thresholds]
            return np.abs(np.diff(maps, 2, axis=0)).max()

        assert largest_step(Levels(whole_pixels=True)) > 0.01
        assert largest_step(Levels()) < 0.0005

    def test_away_from_walls_a_pixel_is_the_point_at_its_centre(self):
        paper = Paper(shrinkage_min=1.0, shrinkage_max=1.0)
        inside = (uneven().heights_um > 0) & ~near_walls(uneven())
        share, whole = (
            predict(uneven(), ParameterSet(paper=paper), numerics=n).heights_um for n in (Levels(), Levels(1, True))
        )
        np.testing.assert_allclose(share[inside], whole[inside], rtol=0, atol=1e-4)

    def test_a_top_that_a_tail_lifts_by_nanometres_is_still_exposed(self):
        """It rose above the levels, and the column was lost."""
        part = stairs(size_um=30, pitch_um=0.5, margin_um=4)
        process = ParameterSet(paper=Paper(0.549, threshold=0.46), effects=(library()["galvo-lag"](lag_um=0.32),))
        inside = (part.heights_um > 0) & ~near_walls(part)
        assert predict(part, process).heights_um[inside].min() > 0


class TestPixelsThatAreNotSquare:
    """Widths are µm along x and y, whatever the pitches."""

    @pytest.mark.parametrize("angle_deg", [0.0, 180.0, 90.0])
    def test_a_spot_has_its_widths(self, angle_deg):
        spot = np.zeros((81, 161))
        spot[40, 80] = 1
        cloud = Focus(1.0, 3.0, 6.0, 1.0, angle_deg=angle_deg).spread(spot, 0.2, 0.5)
        x, y = (np.arange(161) - 80) * 0.2, (40 - np.arange(81)) * 0.5
        expected = (3.0, 6.0) if angle_deg % 180 == 0 else (6.0, 3.0)
        found = [np.sqrt(cloud.sum(axis=a) @ u**2) * FWHM_PER_SIGMA for a, u in ((0, x), (1, y))]
        np.testing.assert_allclose(found, expected, rtol=1e-3)

    def test_a_lag_is_a_way_along_y(self):
        spot = np.zeros((161, 41))
        spot[80, 20] = 1
        cloud = Focus(1.0, 1.0, 1.0, 1.0, lag_y_um=1.7).spread(spot, 0.2, 0.5)
        assert cloud.sum(axis=1) @ (80 - np.arange(161)) * 0.5 == pytest.approx(1.7, abs=1e-3)

    def test_the_room_around_a_part_is_five_sigma_along_each_axis(self):
        part = HeightMap(np.ones((4, 4)), 0.2, 0.5)
        reach_um = 5 * 0.5 / 2.3548
        assert room_px(part, ParameterSet()) == (np.ceil(reach_um / 0.5) + 1, np.ceil(reach_um / 0.2) + 1)

    def test_both_numerics_agree(self):
        rng = np.random.default_rng(4)
        part = HeightMap(np.pad(np.kron(rng.uniform(2, 5, (4, 4)), np.ones((10, 20))), 10), 0.15, 0.35)
        paper = Paper(crosslink_fwhm_xy_um=3.0, crosslink_fwhm_z_um=9.0)
        process = ParameterSet(paper=paper, readings=Readings(crosslink_reference="bulk"))
        fast, voxel = (predict(part, process, numerics=n).heights_um for n in (Levels(whole_pixels=True), Voxels(0.02)))
        assert np.sqrt(np.mean((fast - voxel)[fast > 0] ** 2)) < 0.02


def test_factors_of_one_kind_multiply_and_dose_is_a_power_of_intensity():
    twice, thrice = (lambda written, z, f=f: np.full(written.shape, f) for f in (2.0, 3.0))
    focus = (Focus(1.0, 0.5, 0.5, 1.5),)
    assert (Dose(block(), focus, Levels(), threshold_factor=(twice, thrice)).relative_threshold(1.0) == 6.0).all()
    dose = Dose(block(), focus, Levels(), intensity=(twice, thrice), background=(twice,), photon_order=3.0)
    assert (dose.relative_dose(1.0) == 216.0).all() and (dose.relative_background(1.0) == 8.0).all()
    assert (dose.relative_threshold(1.0) == 1 / 8).all()


def test_conversion_follows_the_dose_over_the_exposed_resin():
    """An effect may ask for the heights written: up to the surface of what was exposed, here half as high again."""
    dose = Dose(
        block(), (), Levels(), intensity=(lambda written, z: written.heights_um,), conversion=1.0, photon_order=1.0
    )
    surface = block(height_um=9.0)
    weight = Crosslinked(Exposed(surface, dose), 7.0, 7.0).source_weight(0.0)
    np.testing.assert_allclose(weight, surface.heights_um)


def test_the_root_of_a_cubic_is_found():
    def cubic(t):
        return (0.3 - t) * (1 + 0.4 * t + 0.25 * t**2)

    assert _cubic_root(*(np.array([cubic(t)]) for t in (-1.0, 0.0, 1.0, 2.0)))[0] == pytest.approx(0.3, abs=1e-9)


class TestLayers:
    """A weight that changes along z, over one column and over none."""

    @staticmethod
    def column(weight_at, height_um, *, from_glass=True) -> Columns:
        layers = Layers.of(lambda z: weight_at(z) * np.ones((1, 2)), 2.0, 0.05, 1)
        return Columns(layers, np.array([[height_um, 0.0]]), from_glass=from_glass)

    @pytest.mark.parametrize("from_glass", [True, False])
    @pytest.mark.parametrize("z_um", [-0.2, 0.5, 1.2])
    def test_the_convolution_is_the_integral(self, z_um, from_glass):
        height, sigma = 1.13, 0.3
        found = self.column(lambda z: 1 + 0.4 * z, height, from_glass=from_glass).convolved([z_um], [sigma])[0]
        z = np.linspace(-4 if from_glass else 0, height, 40001)
        density = np.exp(-(((z - z_um) / sigma) ** 2) / 2) / sigma / np.sqrt(2 * np.pi)
        assert found[0, 0] == pytest.approx(np.trapezoid((1 + 0.4 * np.maximum(z, 0)) * density, z), abs=2e-4)
        assert found[0, 1] == 0

    def test_the_highest_weight_may_lie_deep_in_the_column(self):
        highest = self.column(lambda z: np.where((z > 0.39) & (z < 0.41), 3.0, 1.0), 1.13).highest
        np.testing.assert_array_equal(highest, [[3.0, 0.0]])
        assert self.column(lambda z: np.where(z > 1.5, 3.0, 1.0), 1.13).highest[0, 0] == 1.0

    @pytest.mark.parametrize("from_glass", [True, False])
    @pytest.mark.parametrize("same", ["at every height", "on the whole plane"])
    def test_a_weight_that_does_not_depend_on_z_or_on_the_place_is_the_same_written_out(self, same, from_glass):
        rng = np.random.default_rng(0)
        heights = rng.uniform(0, 2, (5, 6)) * (rng.random((5, 6)) < 0.8)
        plane = rng.uniform(0.5, 1.5, (5, 6)) if same == "at every height" else np.ones((1, 1))

        def weight(z):
            return plane if same == "at every height" else 1 + 0.3 * z**2

        short = Layers.of(weight, 2.0, 0.05, 1)
        whole = Layers.of(lambda z: weight(z) * np.ones((len(z), 5, 6)), 2.0, 0.05, 1)
        assert short.factors and not whole.factors and short.weights.size < whole.weights.size
        one, other = (Columns(layers, heights, from_glass=from_glass) for layers in (short, whole))
        np.testing.assert_allclose(one.highest, other.highest, rtol=1e-6)
        z, sigma = [-0.1, 0.7, 1.9], [0.3, 0.3, 0.4]
        np.testing.assert_allclose(one.convolved(z, sigma), other.convolved(z, sigma), atol=2e-6)

    def test_layers_far_below_count_as_the_lowest_one_kept(self):
        def weight(z):
            return (1 + 0.3 * z) * np.ones((1, 2))

        whole, upper = (Layers.of(weight, 4.0, 0.2, 1, bottom_um) for bottom_um in (0.0, 1.1))
        assert upper.faces_um[0] == pytest.approx(1.0) and len(upper.weights) == len(whole.weights) - 5
        np.testing.assert_array_equal(upper.at(7), whole.at(7))
        heights = np.array([[3.7, 3.1]])
        found = [Columns(layers, heights, from_glass=True).convolved([3.0], [0.3]) for layers in (whole, upper)]
        np.testing.assert_allclose(*found, atol=2e-6)

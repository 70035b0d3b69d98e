"""Large maps in tiles: the same heights as the whole map to 0.1 nm, whatever the tiles; on disk; resumed; refused."""

import numpy as np
import pytest
import tifffile
from typer.testing import CliRunner

from dlwpredict import designs
from dlwpredict.cli.app import app
from dlwpredict.effects import library
from dlwpredict.errors import InputError
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.mapped_tiff import mapped, mapping
from dlwpredict.files.parameters_yaml import write_parameters
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import Paper, ParameterSet, Readings
from dlwpredict.process import predict
from dlwpredict.tiling import large
from dlwpredict.tiling.expose import Canvas
from dlwpredict.tiling.large import Large, canvas_of, halo_px, tile_side_px
from dlwpredict.tiling.reach import LOCAL, REACH_UM, WHOLE, check_tileable, halo_um
from dlwpredict.tiling.window import Tile, tiles

TOLERANCE_UM = 1e-4
PAPER = Paper(crosslink_fwhm_xy_um=4.0)


def effects(*named):
    return tuple(library()[name](**settings) for name, settings in named)


PROCESSES = {
    "paper": ParameterSet(paper=PAPER),
    "bulk": ParameterSet(paper=PAPER, readings=Readings(crosslink_reference="bulk")),
    "curve": ParameterSet(paper=PAPER, effects=effects(("shrinkage-nonlinearity", {"exponent": 1.5}))),
    "field": ParameterSet(
        paper=PAPER,
        effects=effects(
            ("substrate-tilt", {"tilt_x_mrad": 5.0, "tilt_y_mrad": -3.0}),
            ("vignetting", {"strength": 0.1, "centre_x_um": 5.0, "centre_y_um": -4.0, "conversion": 1.0}),
            ("field-curvature", {"sag_um": 0.3, "coma_y_um": 0.2, "centre_y_um": 7.0}),
        ),
    ),
    "dose": ParameterSet(
        paper=PAPER,
        effects=effects(
            ("dose-memory", {"gain": 0.1, "length_um": 1.0}), ("line-end-pileup", {"gain": 0.1, "length_um": 0.5})
        ),
    ),
    "focus": ParameterSet(
        paper=PAPER,
        effects=effects(
            ("galvo-lag", {"lag_um": 0.2, "height_share": 0.5}),
            ("psf-wings", {"weight": 0.1}),
            ("edge-inhibition", {"gain": 0.1, "fwhm_um": 2.0}),
        ),
    ),
    "lines": ParameterSet(
        paper=PAPER,
        effects=effects(
            ("line-length-error", {"start_um": -0.37, "end_um": 0.2}),
            ("tip-convolution", {"radius_um": 0.4}),
            ("slope-error", {"bias_abs_x_um": 0.1, "bias_abs_y_um": -0.1}),
        ),
    ),
    "surface": ParameterSet(
        paper=PAPER,
        effects=effects(
            ("edge-drying", {"depth_um": 0.2, "length_um": 1.0}),
            ("batwings", {"gain": 0.3}),
            ("instrument-blur", {"fwhm_um": 0.8}),
        ),
    ),
}


@pytest.fixture(scope="module")
def target(tmp_path_factory):
    """A part with walls, relief and bare glass, not square, on pixels that are not square."""
    path = tmp_path_factory.mktemp("large") / "target.tif"
    relief = designs.air(size_um=40, pitch_um=0.25, margin_um=3, seed=1)
    write_height_map(path, HeightMap(relief.heights_um[:150], 0.25, 0.3))
    return path


def in_tiles(target, process, side_px, folder, **given):
    source = mapped(target)
    canvas, _ = canvas_of(target, source.heights_um, source.dx_um, source.dy_um, process)
    printed = np.zeros(canvas.target_shape)
    Large(canvas, process, side_px, as_measured=True, threads=1, **given).predict(folder, printed)
    return printed


@pytest.mark.slow
@pytest.mark.parametrize("name", PROCESSES)
def test_tiles_make_no_difference(target, name, tmp_path):
    process = PROCESSES[name]
    whole = predict(read_height_map(target), process, as_measured=True).heights_um
    for side_px in (45, 100):
        printed = in_tiles(target, process, side_px, tmp_path / str(side_px))
        np.testing.assert_allclose(printed, whole, rtol=0, atol=TOLERANCE_UM)


def test_nor_in_a_part_that_is_small_beside_the_reach_of_cross_linking(tmp_path):
    """Cross-linking is a thousandth of that of a large block there, and divided by its largest value."""
    heights = np.zeros((4, 14))
    heights[:2, 12:], heights[2:, 6:8] = 4.9, 1.0
    process = ParameterSet(paper=Paper(0.25, 1.0, 0.5, 7.0, 1.0, 0.5, 1.0))
    target = HeightMap(np.float32(heights), 0.25, 0.125)
    write_height_map(tmp_path / "target.tif", target)
    whole = predict(target, process).heights_um
    found = in_tiles(tmp_path / "target.tif", process, 12, tmp_path / "work")
    np.testing.assert_allclose(found, whole, rtol=0, atol=TOLERANCE_UM)


def test_without_a_halo_they_would(target, tmp_path, monkeypatch):
    whole = predict(read_height_map(target), PROCESSES["paper"]).heights_um
    monkeypatch.setattr(large, "halo_um", lambda process: (0.5, 0.5))
    printed = in_tiles(target, PROCESSES["paper"], 45, tmp_path / "x")
    assert np.abs(printed - whole).max() > 100 * TOLERANCE_UM


def test_a_window_knows_where_it_lies():
    whole = HeightMap(np.zeros((7, 10)), 0.5, 0.25)
    tile = Tile(2, 6, 3, 8)
    window = tile.window(np.zeros(tile.shape), 0.5, 0.25, whole.shape)
    np.testing.assert_allclose(window.x_um, whole.x_um[3:8])
    np.testing.assert_allclose(window.y_um, whole.y_um[2:6])
    padded = window.with_heights(np.zeros((6, 7)))
    np.testing.assert_allclose(padded.x_um, np.append(whole.x_um[2:8], whole.x_um[8]))


def test_tiles_cover_the_map_once():
    covered = np.zeros((103, 57), int)
    for tile in tiles(covered.shape, 20):
        covered[tile.slices] += 1
        assert max(tile.shape) <= 20
    assert (covered == 1).all()


def test_a_halo_begins_on_the_grid_of_pixels_taken_together_and_ends_with_the_map():
    grown = Tile(10, 20, 13, 20).grown((3, 5), (22, 40), (4, 3))
    assert grown == Tile(4, 22, 6, 25)
    assert Tile(1, 20, 2, 20).grown((3, 5), (40, 40), (4, 3)) == Tile(0, 23, 0, 25)


@pytest.mark.parametrize(
    ("named", "further_um"),
    [
        (("dose-memory", {"gain": 0.1, "length_um": 3.0}), (0.0, 24.0)),
        (("dose-memory", {"gain": 0.1, "length_um": 3.0, "conversion": 1.0}), (0.0, 48.0)),
        (("line-end-pileup", {"gain": 0.1, "length_um": 3.0}), (24.0, 0.0)),
        (("edge-inhibition", {"gain": 0.1, "fwhm_um": 2.3548}), (5.0, 5.0)),
        (("line-length-error", {"start_um": -0.3, "end_um": 0.1}), (0.3, 0.0)),
        (("vignetting", {"strength": 0.1}), (0.0, 0.0)),
    ],
)
def test_memory_reaches_along_the_hatch_and_line_ends_along_the_lines(named, further_um):
    """Eight lengths of an exponential, five standard deviations of a Gaussian; (y, x)."""
    plain, with_it = halo_um(PROCESSES["paper"]), halo_um(ParameterSet(paper=PAPER, effects=effects(named)))
    np.testing.assert_allclose(np.subtract(with_it, plain), further_um, atol=1e-3)


def test_a_halo_in_pixels_follows_the_pitch_of_its_axis():
    canvas = Canvas(None, (100, 100), 0.1, 0.5, (0, 0))
    assert halo_px(canvas, (5.0, 1.0)) == (10 + 2, 10 + 2)


def test_every_effect_is_placed():
    """A new effect must say how far it reaches, or that it needs the whole map."""
    assert set(library()) == {*REACH_UM, *LOCAL, *WHOLE}


@pytest.mark.parametrize(
    ("named", "said"),
    [
        (("curl", {"rise_um": 0.2}), "effects.curl: bends the part about its centroid"),
        (("power-drift", {"drift": 0.1}), "effects.power-drift: counts from the highest layer"),
        (("stitching", {"shift_x_um": 0.1}), "effects.stitching: moves whole blocks"),
        (("z-linearity", {"quadratic_um": 0.1}), "effects.z-linearity: needs the whole range"),
        (("slope-error", {"max_angle_deg": 60.0}), "effects.slope-error: leaves gaps"),
        (("tip-convolution", {"half_angle_deg": 20.0}), "effects.tip-convolution: reaches as far as walls are high"),
    ],
)
def test_effects_of_the_whole_part_are_refused(named, said):
    with pytest.raises(InputError) as caught:
        check_tileable(ParameterSet(effects=effects(named)), as_measured=True)
    assert said in str(caught.value) and "--tile-px 0" in str(caught.value)
    check_tileable(ParameterSet(effects=effects((named[0], {}))), as_measured=True)  # switched off


def test_conversion_is_refused_where_windows_do_not_show_the_maximum():
    named = (("vignetting", {"strength": 0.1, "conversion": 1.0}), ("shrinkage-nonlinearity", {"exponent": 1.5}))
    with pytest.raises(InputError, match="with conversion above 0"):
        check_tileable(ParameterSet(effects=effects(*named)), as_measured=False)
    check_tileable(
        ParameterSet(effects=effects(*named), readings=Readings(crosslink_reference="bulk")), as_measured=False
    )


def test_measurement_effects_are_refused_only_where_they_are_asked_for():
    process = ParameterSet(effects=effects(("misregistration", {"shift_x_um": 1.0})))
    check_tileable(process, as_measured=False)
    with pytest.raises(InputError, match="turns and stretches"):
        check_tileable(process, as_measured=True)


@pytest.mark.slow
def test_an_interrupted_map_goes_on(target, tmp_path):
    """What is there is used: after an interruption only the missing tiles are computed."""

    def stop(done, count):
        if done == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        in_tiles(target, PROCESSES["paper"], 45, tmp_path / "x", on_tile=stop)
    first = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "x").glob("*.npz")}
    assert len(first) == 4
    again = in_tiles(target, PROCESSES["paper"], 45, tmp_path / "x")
    assert {name: (tmp_path / "x" / name).stat().st_mtime_ns for name in first} == first
    np.testing.assert_array_equal(again, in_tiles(target, PROCESSES["paper"], 45, tmp_path / "y"))


def test_tiles_of_another_process_are_not_used(target, tmp_path):
    other = ParameterSet(paper=Paper(threshold=0.4, crosslink_fwhm_xy_um=4.0))
    in_tiles(target, other, 100, tmp_path / "x")
    printed = in_tiles(target, PROCESSES["paper"], 100, tmp_path / "x")
    np.testing.assert_array_equal(printed, in_tiles(target, PROCESSES["paper"], 100, tmp_path / "y"))


def dlw(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.mark.slow
def test_predict_cuts_large_maps_by_itself(target, tmp_path, monkeypatch):
    monkeypatch.setattr("dlwpredict.tiling.disk.WHOLE_PX", 1000)
    write_parameters(tmp_path / "p.yaml", PROCESSES["paper"])
    words = ("predict", target, "-p", tmp_path / "p.yaml", "-o")
    by_itself = dlw(*words, tmp_path / "a.tif")
    assert by_itself.exit_code == 0 and "in tiles of at most" in by_itself.output
    assert dlw(*words, tmp_path / "b.tif", "--tile-px", 64).exit_code == 0
    whole = dlw(*words, tmp_path / "c.tif", "--tile-px", 0)
    assert whole.exit_code == 0 and "tiles" not in whole.output
    assert dlw(*words, tmp_path / "d.npy", "--tile-px", 64).exit_code == 0
    maps = [read_height_map(tmp_path / f"{name}.tif") for name in "abc"]
    maps.append(read_height_map(tmp_path / "d.npy", pitch_um=(0.25, 0.3)))
    for one in maps:
        assert (one.dx_um, one.dy_um) == (0.25, 0.3)
        np.testing.assert_allclose(one.heights_um, maps[2].heights_um, rtol=0, atol=TOLERANCE_UM)
    assert not list(tmp_path.glob(".*"))


def test_a_target_of_any_format_can_be_cut(target, tmp_path):
    np.save(tmp_path / "t.npy", read_height_map(target).heights_um)
    assert dlw("convert", tmp_path / "t.npy", tmp_path / "t.gsf", "--pitch-um", "0.25", "0.3").exit_code == 0
    assert dlw("predict", tmp_path / "t.gsf", "-o", tmp_path / "p.tif", "--tile-px", 100).exit_code == 0
    assert dlw("predict", target, "-o", tmp_path / "q.tif", "--tile-px", 100).exit_code == 0
    found = [read_height_map(tmp_path / name).heights_um for name in ("p.tif", "q.tif")]
    np.testing.assert_allclose(*found, rtol=0, atol=2e-6)  # the pitch of a .gsf is rounded in its last digit


@pytest.mark.parametrize(
    ("heights", "said"),
    [
        (np.zeros((99, 99)), "heights: nothing written"),
        (np.pad([[1.0, -2.0]], 40), "at least 0"),
        (np.pad([[1.0, np.nan]], 40), "heights: 1 points without a height"),
    ],
)
def test_targets_that_cannot_be_written_leave_one_line_and_no_file(tmp_path, heights, said):
    write_height_map(tmp_path / "odd.tif", HeightMap(heights, 0.5, 0.5))
    done = dlw("predict", tmp_path / "odd.tif", "-o", tmp_path / "out.tif", "--tile-px", 64)
    assert done.exit_code == 1 and said in done.output
    assert done.output.startswith(f"error: {tmp_path}/odd.tif: ") and done.output.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["odd.tif"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--tile-px", 5], "--tile-px: found 5, allowed: 0, or 64 and more"),
        (["--tile-px", 64, "--plot", "a.png"], "--plot"),
    ],
)
def test_options_at_fault_are_named(target, tmp_path, words, said):
    done = dlw("predict", target, "-o", tmp_path / "out.tif", *words)
    assert done.exit_code == 1 and said in done.output


def test_an_effect_that_reaches_too_far_is_refused(target):
    process = ParameterSet(effects=effects(("dose-memory", {"gain": 0.1, "length_um": 50.0})))
    canvas = Canvas(target, (9000, 9000), 0.1, 0.1, (12, 12))
    with pytest.raises(InputError, match="too much memory in tiles"):
        tile_side_px(canvas, process, 12.0)
    assert tile_side_px(canvas, ParameterSet(), 12.0) == large.TILE_PX


def test_a_mapped_file_reads_like_any_other(tmp_path):
    heights = np.arange(12.0).reshape(3, 4)
    with mapping(tmp_path / "a.tif", (3, 4), 0.1, 0.25) as written:
        written[:] = heights
    write_height_map(tmp_path / "b.tif", HeightMap(heights, 0.1, 0.25))
    first, second = (read_height_map(tmp_path / name) for name in ("a.tif", "b.tif"))
    assert first.same_grid(second) and first.dx_um == second.dx_um
    np.testing.assert_array_equal(first.heights_um, second.heights_um)
    assert tifffile.tiffcomment(tmp_path / "a.tif") == tifffile.tiffcomment(tmp_path / "b.tif")
    np.testing.assert_array_equal(mapped(tmp_path / "b.tif").heights_um, heights)


def test_a_half_written_map_is_no_file(tmp_path):
    with pytest.raises(ValueError, match="stop"), mapping(tmp_path / "a.tif", (3, 4), 0.1, 0.1):
        raise ValueError("stop")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("options", [{"compression": "zlib"}, {"dtype": np.uint16}, {"metadata": {"unit": "um"}}])
def test_other_tiffs_are_left_to_the_usual_reader(tmp_path, options):
    kind = options.pop("dtype", np.float32)
    imagej = "compression" not in options
    lines = {"unit": "um", "pitch_x_um": "0.1", "pitch_y_um": "0.1"}
    tifffile.imwrite(tmp_path / "a.tif", np.ones((3, 4), kind), imagej=imagej, **{"metadata": lines, **options})
    assert mapped(tmp_path / "a.tif") is None

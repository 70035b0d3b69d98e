"""Corrections that can be printed, and parts that go on beyond their map."""

import numpy as np
import pytest
from typer.testing import CliRunner

from dlwpredict import designs
from dlwpredict.cli import app
from dlwpredict.correction.limits import HIGHEST, Limits
from dlwpredict.correction.precompensate import precompensate
from dlwpredict.correction.printable import Printable
from dlwpredict.correction.surround import Continued, doubt_of_edges
from dlwpredict.errors import InputError
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import predict

WAVES = HeightMap(np.round(1.5 + 0.5 * np.add.outer(np.sin(np.arange(80) / 9), np.cos(np.arange(90) / 7)), 1), 0.2, 0.2)
"""A design in steps of 0.1 µm that fills its map."""

PROCESS = ParameterSet()


def roughness(written: HeightMap) -> float:
    """Root mean square of the second differences of a correction, µm."""
    change = written.heights_um - WAVES.heights_um
    return float(np.sqrt(np.mean(np.diff(change, 2, axis=0) ** 2) + np.mean(np.diff(change, 2, axis=1) ** 2)))


def corrected(**shape) -> HeightMap:
    limits = Limits.about(WAVES, printable=Printable(**shape))
    return precompensate(WAVES, lambda written: predict(written, PROCESS), limits=limits).corrected


class TestPrintable:
    def test_a_design_in_steps_is_not_answered_by_a_comb(self):
        plain, smooth, coarse = corrected(), corrected(smooth_um=1.0), corrected(smallest_um=1.0)
        assert roughness(smooth) < 0.1 * roughness(plain)
        assert roughness(coarse) < 0.6 * roughness(plain)

    def test_nothing_is_steeper_than_said_but_for_what_the_target_is(self):
        rough = WAVES.with_heights(WAVES.heights_um + np.random.default_rng(0).random(WAVES.shape))
        found = Printable(steepest=0.4).of(rough.heights_um, WAVES)
        for axis in (0, 1):
            rise, own = np.diff(found, axis=axis), np.diff(WAVES.heights_um, axis=axis)
            assert (rise <= np.maximum(0.4 * 0.2, own) + 1e-9).all()
            assert (-rise <= np.maximum(0.4 * 0.2, -own) + 1e-9).all()
        assert (found <= rough.heights_um).all()

    def test_what_is_printable_stays(self):
        smooth = WAVES.heights_um + 0.1
        for shape in ({}, {"smooth_um": 0.6}, {"smallest_um": 0.6}, {"steepest": 3.0}):
            np.testing.assert_allclose(Printable(**shape).of(smooth, WAVES), smooth, atol=1e-9)

    def test_a_slope_of_the_target_is_no_step_to_be_cut(self):
        ramp = HeightMap(np.tile(np.arange(1.0, 13.0), (8, 1)), 1, 1)
        np.testing.assert_allclose(Printable(steepest=0.1).of(ramp.heights_um, ramp), ramp.heights_um)

    def test_the_same_change_everywhere_is_smooth_up_to_the_rim_of_the_part(self):
        part = HeightMap(np.pad(np.full((12, 16), 4.0), 5), 1, 1)
        raised = np.where(part.heights_um > 0, part.heights_um + 0.5, 0.0)
        np.testing.assert_allclose(Printable(smooth_um=4).of(raised, part), raised)

    def test_what_is_wider_than_the_smallest_stays(self):
        """Five pixels: a square of seven keeps its middle, one of three goes."""
        part = HeightMap(np.full((40, 40), 4.0), 1, 1)
        written = part.heights_um.copy()
        written[8:15, 8:15], written[28:31, 28:31] = 5.0, 5.0
        shaped = Printable(smallest_um=5).of(written, part)
        assert shaped[11, 11] == 5.0 and shaped[29, 29] == 4.0

    def test_beside_the_part_nothing_is_touched(self):
        part = designs.air(size_um=10, pitch_um=0.4, margin_um=4)
        found = Printable(0.8, 0.5, 0.8).of(1.3 * part.heights_um, part)
        assert (found[part.heights_um == 0] == 0).all()

    @pytest.mark.parametrize("shape", [{"smooth_um": -1}, {"steepest": 0}, {"smallest_um": np.inf}])
    def test_what_makes_no_sense_is_refused(self, shape):
        with pytest.raises(InputError):
            Printable(**shape)


class TestSurround:
    def test_a_flat_part_that_goes_on_prints_flat(self):
        flat = HeightMap(np.full((40, 50), 2.0), 0.4, 0.4)
        view = Continued.of(flat, PROCESS)
        ends = view.in_view(predict(view.whole, PROCESS)).heights_um
        assert np.ptp(ends) < 5e-3
        assert np.ptp(predict(flat, PROCESS).heights_um) > 0.2

    def test_the_middle_of_a_large_part_prints_as_the_part_does(self):
        large = designs.air(size_um=60, pitch_um=0.4, margin_um=4)
        middle = tuple(slice(n // 2 - 25, n // 2 + 25) for n in large.shape)
        cut = HeightMap(large.heights_um[middle], 0.4, 0.4)
        whole, view = predict(large, PROCESS).heights_um[middle], Continued.of(cut, PROCESS)
        errors = [
            np.abs(found.heights_um - whole)[2:-2, 2:-2].max()
            for found in (view.in_view(predict(view.whole, PROCESS)), predict(cut, PROCESS))
        ]
        assert errors[0] < 0.3 * errors[1]

    def test_only_a_part_at_the_edge_is_doubted(self):
        assert doubt_of_edges(WAVES) and not doubt_of_edges(designs.air(size_um=10, pitch_um=0.5, margin_um=2))


def test_no_wall_grows_along_the_edge_of_a_map_that_is_cut_out(tmp_path):
    write_height_map(tmp_path / "cut.tif", WAVES)

    def run(*words, command="precompensate"):
        given = [command, str(tmp_path / "cut.tif"), "-o", str(tmp_path / "out.tif"), "--overwrite", *words]
        ended = CliRunner().invoke(app, given)
        assert ended.exit_code == 0, ended.output
        return read_height_map(tmp_path / "out.tif").heights_um, ended.stderr

    written, said = run()
    assert "touches the edge" in said
    assert written.max() <= HIGHEST * WAVES.heights_um.max() + 1e-6
    continued, said = run("--surround", "continued", "--smooth-um", "0.6")
    assert "touches the edge" not in said and continued.shape == WAVES.shape
    change = continued - WAVES.heights_um
    assert change[[0, -1]].max() < 1.2 * change[20:-20, 20:-20].max()
    _, said = run(command="predict")
    assert "touches the edge" in said
    _, said = run("--surround", "empty", command="predict")
    assert "touches the edge" not in said


def test_tiles_do_not_go_on_beyond_the_map(tmp_path):
    write_height_map(tmp_path / "cut.tif", WAVES)
    words = ["--surround", "continued", "--tile-px", "64"]
    ended = CliRunner().invoke(app, ["predict", str(tmp_path / "cut.tif"), "-o", str(tmp_path / "o.tif"), *words])
    assert ended.exit_code == 1 and "--surround" in ended.stderr and not (tmp_path / "o.tif").exists()

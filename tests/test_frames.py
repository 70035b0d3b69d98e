"""What a recording knows of its instrument travels with it: through files, and through an alignment."""

from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from dlwpredict import designs
from dlwpredict.alignment import align
from dlwpredict.cli import app
from dlwpredict.errors import InputError
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.heightmap import HeightMap, Instrument

MAP = HeightMap(np.arange(12.0).reshape(3, 4), 0.2, 0.3, instrument=Instrument("afm", 12.5))


@pytest.fixture(scope="module")
def part():
    return designs.air(size_um=24.0, pitch_um=0.3, margin_um=4.0, seed=2)


class TestInstrument:
    def test_a_direction_is_counted_between_minus_180_and_180(self):
        found = [Instrument("wli", angle).fast_axis_deg for angle in (180.0, -180.0, 270.0, -725.0)]
        assert found == [180, 180, -90, -5]

    def test_what_is_unknown_stays_so(self):
        assert Instrument("wli").turned(30.0) == Instrument("wli").mirrored() == Instrument("wli")

    @pytest.mark.parametrize(("kind", "angle"), [("camera", None), ("afm", np.nan), ("afm", np.inf)])
    def test_anything_else_is_refused(self, kind, angle):
        with pytest.raises(InputError, match="instrument"):
            Instrument(kind, angle)


class TestFiles:
    @pytest.mark.parametrize("ending", [".tif", ".txt"])
    def test_it_comes_back(self, tmp_path, ending):
        path = tmp_path / f"map{ending}"
        write_height_map(path, MAP)
        assert read_height_map(path).instrument == MAP.instrument

    def test_what_may_be_the_print_s_comes_back(self, tmp_path):
        path = tmp_path / "map.tif"
        write_height_map(path, replace(MAP, instrument=Instrument(scale=0.99)))
        assert read_height_map(path).instrument == Instrument(scale=0.99)

    def test_a_file_says_nothing_of_an_unknown_one(self, tmp_path):
        path = tmp_path / "map.txt"
        write_height_map(path, HeightMap(MAP.heights_um, 0.2, 0.3))
        assert "instrument" not in path.read_text()

    @pytest.mark.parametrize(
        "line",
        [
            "instrument=camera",
            "instrument_fast_axis_deg=left",
            "instrument_pitch_um=0",
            "instrument_scale=-1",
            "instrument_scale=1.01",
        ],
    )
    def test_a_line_that_makes_no_sense_is_refused(self, tmp_path, line):
        path = tmp_path / "map.txt"
        path.write_text(f"# pitch_x_um=0.2\n# pitch_y_um=0.2\n# {line}\n1 2\n3 4\n")
        with pytest.raises(InputError, match="instrument"):
            read_height_map(path)


class TestAlignment:
    @pytest.mark.slow
    def test_lines_of_the_scan_stay_lines_of_the_scan(self, part):
        """A sample that lies turned by 90°: the scan along x runs along −y of the target."""
        seen = HeightMap(np.rot90(part.heights_um), part.dy_um, part.dx_um, instrument=Instrument("afm", 0.0))
        found = align(seen, part)
        assert found.pose.rotation_deg == pytest.approx(90, abs=0.1)
        assert found.aligned.instrument.kind == "afm"
        assert found.aligned.instrument.fast_axis_deg == pytest.approx(-90, abs=0.1)
        assert found.as_dict()["instrument_fast_axis_deg"] == found.aligned.instrument.fast_axis_deg

    @pytest.mark.slow
    def test_a_laid_map_knows_how_wide_the_pixels_were_that_it_was_recorded_with(self, part):
        own, wider = (replace(part, instrument=Instrument(pitch_um=pitch_um)) for pitch_um in (None, 3 * part.dx_um))
        assert align(own, part).aligned.instrument.pitch_um == pytest.approx(max(part.dx_um, part.dy_um))
        assert align(wider, part).aligned.instrument.pitch_um == pytest.approx(3 * part.dx_um)

    @pytest.mark.slow
    def test_a_recording_that_was_turned_back_has_its_lines_turned_back(self, part):
        seen = HeightMap(part.heights_um[:, ::-1], part.dx_um, part.dy_um, instrument=Instrument("confocal", 20.0))
        found = align(seen, part, allow_mirror=True)
        assert found.aligned.instrument.fast_axis_deg == pytest.approx(160, abs=0.1)


def test_the_user_says_what_the_file_does_not(tmp_path):
    source, first, second = (tmp_path / name for name in ("in.npy", "first.tif", "second.tif"))
    np.save(source, MAP.heights_um)
    said = ["--pitch-um", "0.2", "--instrument", "wli", "--fast-axis-deg", "90"]
    for words in ([source, first, *said], [first, second, "--instrument", "afm"]):
        assert CliRunner().invoke(app, ["convert", *map(str, words)]).exit_code == 0
    assert read_height_map(first).instrument == Instrument("wli", 90.0)
    assert read_height_map(second).instrument == Instrument("afm", 90.0)

"""Units, pitches and clipping: caught at the door, before anything is fitted."""

from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from dlwpredict import designs
from dlwpredict.cli import app
from dlwpredict.errors import InputError
from dlwpredict.files import write_height_map
from dlwpredict.files.plausibility import doubts_of_size, require_sizes, require_unclipped
from dlwpredict.heightmap import HeightMap

TARGET = designs.air(size_um=20, pitch_um=0.4, margin_um=3)
PRINTED = TARGET.with_heights(0.7 * TARGET.heights_um + np.random.default_rng(0).normal(0, 0.005, TARGET.shape))


def scaled(z: float = 1.0, pitch: float = 1.0) -> HeightMap:
    return HeightMap(z * PRINTED.heights_um, pitch * PRINTED.dx_um, pitch * PRINTED.dy_um)


def test_a_print_is_not_doubted():
    assert doubts_of_size(TARGET, PRINTED) == []
    wedge = TARGET.with_heights(np.add.outer(np.zeros(TARGET.shape[0]), 0.1 * np.arange(TARGET.shape[1])))
    assert doubts_of_size(wedge, wedge) == []
    tilted = PRINTED.with_heights(PRINTED.heights_um + 0.5 * PRINTED.x_um)
    assert doubts_of_size(TARGET, tilted) == []


def test_a_part_that_fills_the_view_shows_its_relief_and_not_its_height():
    """Sixty micrometres high, one of which varies: a recording without bare substrate shows that one."""
    tall = TARGET.with_heights(60 + np.add.outer(np.zeros(TARGET.shape[0]), np.sin(TARGET.x_um)) / 2)
    shown = replace(tall, heights_um=tall.heights_um - 60, height_reference="relative")
    require_sizes(tall, shown)
    assert doubts_of_size(tall, shown) == doubts_of_size(tall, tall) == []
    with pytest.raises(InputError, match="relief"):
        require_sizes(tall, shown.with_heights(1e-3 * shown.heights_um))


@pytest.mark.parametrize(
    ("z", "pitch", "said"),
    [
        (1e3, 1, "looks like nm: convert --z-scale 0.001"),
        (1e-6, 1, "looks like m: convert --z-scale 1e.06"),
        (1e-3, 1, "looks like mm: convert --z-scale 1000"),
        (1e4, 1, "looks like Å: convert --z-scale 0.0001"),
        (1, 1e3, "the unit looks like nm: convert --pitch-um"),
        (60, 1, "is the unit right"),
    ],
)
def test_a_wrong_unit_is_refused_with_its_likely_cause(z, pitch, said):
    with pytest.raises(InputError, match=said):
        require_sizes(TARGET, scaled(z, pitch))


@pytest.mark.parametrize(("z", "pitch"), [(6, 1), (0.2, 1), (1, 4)])
def test_what_is_far_off_is_doubted(z, pitch):
    require_sizes(TARGET, scaled(z, pitch))
    (doubt,) = doubts_of_size(TARGET, scaled(z, pitch))
    assert "is the unit right" in doubt


def test_a_clipped_recording_is_refused_as_clipped():
    wavy = HeightMap(np.random.default_rng(1).random((60, 60)), 0.4, 0.4)
    require_unclipped(wavy)
    with pytest.raises(InputError, match="the recording is clipped"):
        require_unclipped(wavy.with_heights(np.minimum(wavy.heights_um, 0.9)))


@pytest.mark.parametrize("command", ["align", "calibrate", "diagnose"])
def test_every_door_refuses_nanometres_before_anything_is_fitted(tmp_path, command):
    write_height_map(tmp_path / "target.tif", TARGET)
    write_height_map(tmp_path / "nm.tif", scaled(1e3))
    target, recording, output = (str(tmp_path / name) for name in ("target.tif", "nm.tif", "out"))
    words = {"align": [recording, target, "-o", output + ".tif"]}.get(command, ["--pair", target, recording])
    ended = CliRunner().invoke(app, [command, *words, *([] if command == "align" else ["-o", output + ".yaml"])])
    assert ended.exit_code == 1
    assert ended.stderr.startswith(f"error: {recording}: heights: relief") and "--z-scale 0.001" in ended.stderr
    assert not list(tmp_path.glob("out*"))


def test_a_pitch_against_the_file_is_doubted(tmp_path):
    write_height_map(tmp_path / "in.tif", PRINTED)
    for pitch, doubted in (("0.4", False), ("0.1", True)):
        out = str(tmp_path / f"{pitch}.tif")
        ended = CliRunner().invoke(app, ["convert", str(tmp_path / "in.tif"), out, "--pitch-um", pitch])
        assert ended.exit_code == 0
        assert ("the file itself 0.4 x 0.4" in ended.stderr) == doubted

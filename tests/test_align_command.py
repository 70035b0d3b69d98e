"""The command ``align``: what it reads, leaves behind and refuses."""

import os
from pathlib import Path

import numpy as np
import pytest
import tifffile
import yaml
from scipy import ndimage
from typer.testing import CliRunner

from dlwpredict import designs
from dlwpredict.alignment import align
from dlwpredict.cli.app import app
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.heightmap import HeightMap
from tests.bench.recorder import Truth, record

PRINTS = Path(os.environ.get("DLWPREDICT_RECORDINGS", "../shared/recordings")) / "two_photon"


@pytest.fixture
def pair(tmp_path):
    target = designs.f(size_um=30.0, pitch_um=0.3, margin_um=6.0)
    truth = Truth(shift_um=(2.0, 1.0), rotation_deg=90.0, pitch_um=(0.4, 0.4), missing=0.1, mirrored=True)
    write_height_map(tmp_path / "target.tif", target)
    write_height_map(tmp_path / "recording.tif", record(target, truth, np.random.default_rng(0)))
    return tmp_path


def run(folder: Path, *options: str):
    files = [str(folder / name) for name in ("recording.tif", "target.tif")]
    return CliRunner().invoke(app, ["align", *files, "-o", str(folder / "out.tif"), *options])


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize(
    ("stated", "pitch", "narrower"),
    [(1.0, False, False), (0.98, False, True), (0.999, False, False), (1.1, True, False)],
)
def test_a_wrong_pitch_is_named(pair, stated, pitch, narrower):
    """What a certificate leaves open, 0.2 %, is not said; a pitch beyond all instruments is asked about."""
    seen = read_height_map(pair / "recording.tif")
    wrong = HeightMap(seen.heights_um, stated * seen.dx_um, stated * seen.dy_um)
    write_height_map(pair / "recording.tif", wrong)
    done = run(pair, "--allow-mirror")
    assert done.exit_code == 0, done.output
    assert ("is its pixel pitch right" in done.stderr) is pitch
    assert all(f"2 % narrower than the target along {axis}" in done.stderr for axis in "xy") is narrower
    assert ("certified pitch" in done.stderr) is narrower
    assert ("a print that shrinks sideways" in done.stderr) is narrower
    if narrower:  # nothing is left open where its user has said that it is the microscope's
        done = run(pair, "--allow-mirror", "--distortion", "affine", "--overwrite")
        assert "certified pitch" in done.stderr and "a print that shrinks sideways" not in done.stderr


def test_a_recording_without_a_pitch_is_sent_to_convert(pair):
    np.savetxt(pair / "recording.txt", np.eye(30))
    done = CliRunner().invoke(
        app, ["align", str(pair / "recording.txt"), str(pair / "target.tif"), "-o", str(pair / "a.tif")]
    )
    assert done.exit_code == 1
    assert "recording.txt: pitch: no pitch in the file, allowed with --pitch-um DX [DY] of convert" in done.stderr


@pytest.mark.slow
def test_leaves_map_and_report_and_never_overwrites(pair):
    report = pair / "align.yaml"
    done = run(pair, "--allow-mirror", "--report", str(report))
    assert done.exit_code == 0, done.output
    figures = yaml.safe_load(report.read_text())
    assert figures["mirrored"] is True
    assert figures["rotation_deg"] == pytest.approx(90.0, abs=0.02)
    assert figures["height_reference"] == "substrate"
    aligned = read_height_map(pair / "out.tif")
    assert aligned.same_grid(read_height_map(pair / "target.tif"))
    again = run(pair, "--allow-mirror")
    assert again.exit_code == 1
    assert "--overwrite" in again.output


@pytest.mark.slow
def test_mirrored_recording_is_refused_in_one_line_and_leaves_nothing(pair):
    refused = run(pair, "--report", str(pair / "align.yaml"))
    assert refused.exit_code == 1
    assert refused.output.startswith("error:")
    assert "mirrored" in refused.output
    assert refused.output.count("\n") == 1
    assert sorted(path.name for path in pair.iterdir()) == ["recording.tif", "target.tif"]


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.skipif(not PRINTS.is_dir(), reason="recordings of real prints are not at hand")
@pytest.mark.parametrize("field", ["FOV12", "FOV71"])
def test_real_prints_correlate_at_093(field):
    design = 0.1 * tifffile.imread(PRINTS / f"{field}_design_levels.tif")
    raw = PRINTS / f"{field}_afm.tif"
    heights = tifffile.imread(raw) if raw.exists() else 1e6 * np.loadtxt(PRINTS / f"{field}_afm.txt")
    found = align(HeightMap(heights, 0.1, 0.1), HeightMap(design, 0.1, 0.1))
    blurred = [ndimage.gaussian_filter(m, 3).ravel() for m in (found.aligned.heights_um, design)]
    assert np.corrcoef(*blurred)[0, 1] >= 0.93
    assert found.aligned.height_reference == "relative"
    assert found.pose.scale[0] == pytest.approx(0.982 if field == "FOV12" else 1.005, abs=0.002)
    assert found.distortion != "rigid"

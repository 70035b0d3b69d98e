"""Input that is well-formed and wrong: refused, or a warning that names the file."""

import numpy as np
import pytest
from typer.testing import CliRunner

from dlwpredict import designs
from dlwpredict.cli.app import app
from dlwpredict.files import write_height_map
from dlwpredict.files.doubts import disagreement
from dlwpredict.files.plausibility import clipping
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import Paper, ParameterSet
from dlwpredict.process import predict

TARGET = designs.f(size_um=30.0, pitch_um=0.5, margin_um=5.0)
PRINTED = predict(TARGET, ParameterSet(paper=Paper(shrinkage_min=0.74, shrinkage_max=0.96)))
NOISE = np.random.default_rng(0).normal(scale=0.02, size=(TARGET.shape[0] + 16, TARGET.shape[1] + 16))
WIDE = np.pad(PRINTED.heights_um, 8) + NOISE
KAPPAS = ["--free", "shrinkage_min", "--free", "shrinkage_max"]


@pytest.fixture
def call(tmp_path, monkeypatch):
    """Run a command among a target, a recording of it, and recordings that are wrong in one way each."""
    monkeypatch.chdir(tmp_path)
    aligned = PRINTED.heights_um + NOISE[8:-8, 8:-8]
    other = predict(
        designs.posts(size_um=30.0, pitch_um=0.5, margin_um=5.0, width_max_um=6.0), ParameterSet()
    ).heights_um
    maps = {
        "target": TARGET,
        "recording": HeightMap(WIDE, 0.5, 0.5),
        "aligned": TARGET.with_heights(aligned),
        "metres": HeightMap(WIDE * 1e-6, 0.5, 0.5),
        "nanometres": HeightMap(WIDE * 1e3, 0.5, 0.5),
        "mirrored": HeightMap(WIDE[:, ::-1], 0.5, 0.5),
        "mirrored_aligned": TARGET.with_heights(aligned[:, ::-1]),
        "turned_aligned": TARGET.with_heights(np.rot90(aligned).copy()),
        "nm_aligned": TARGET.with_heights(aligned * 1e3),
        "other_aligned": TARGET.with_heights(other + NOISE[8:-8, 8:-8]),
        "other": HeightMap(np.pad(other, 8)[:, ::-1] + NOISE, 0.5, 0.5),
        "half_pitch": HeightMap(WIDE, 1.0, 1.0),
        "pitch_in_nm": HeightMap(WIDE, 500.0, 500.0),
        "pitch_in_mm": HeightMap(WIDE, 5e-4, 5e-4),
        "other_pitch": HeightMap(PRINTED.heights_um, 0.5, 0.6),
        "clipped": HeightMap(np.minimum(WIDE, 4.0), 0.5, 0.5),
    }
    for name, height_map in maps.items():
        write_height_map(tmp_path / f"{name}.tif", height_map)

    def run(*words):
        return CliRunner().invoke(app, [str(word) for word in words])

    return run


def align(call, recording, *options):
    return call("align", f"{recording}.tif", "target.tif", "-o", "out.tif", "--overwrite", *options)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("recording", "said"),
    [
        ("mirrored", "mirrored.tif: mirrored: the recording is mirrored"),
        ("other", "match: no reliable match"),
        ("half_pitch", "match: no reliable match"),
        ("pitch_in_mm", "the unit looks like mm"),
        ("pitch_in_nm", "the unit looks like nm"),
        ("metres", "looks like m: convert --z-scale 1e+06"),
        ("nanometres", "looks like nm: convert --z-scale 0.001"),
        ("clipped", "the recording is clipped"),
    ],
)
def test_align_refuses(call, tmp_path, recording, said):
    result = align(call, recording)
    assert result.exit_code == 1
    assert said in result.stderr
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "out.tif").exists()


@pytest.mark.slow
def test_align_warns_where_a_few_points_are_clipped(call, tmp_path):
    few = np.sort(WIDE.ravel())[-30]
    write_height_map(tmp_path / "few.tif", HeightMap(np.minimum(WIDE, few), 0.5, 0.5))
    result = align(call, "few")
    assert result.exit_code == 0, result.stderr
    assert f"warning: few.tif: 30 points at the highest height, {few:.4g} µm: is the recording clip" in result.stderr


@pytest.mark.slow
def test_a_good_recording_is_no_matter_of_doubt(call):
    assert align(call, "recording").stderr == ""
    assert call("score", "target.tif", "aligned.tif").stderr == ""


@pytest.mark.parametrize(
    ("recording", "said"),
    [
        ("mirrored_aligned", "fits better mirrored left to right"),
        ("turned_aligned", "fits better turned by 270°"),
        ("nm_aligned", "is the unit right (--z-scale)?"),
        ("other_aligned", "is it a recording of another structure?"),
    ],
)
def test_pairs_that_do_not_belong_together(call, recording, said):
    result = call("score", "target.tif", f"{recording}.tif")
    assert result.exit_code == 0, result.stderr
    assert any(line.startswith(f"warning: {recording}.tif: ") and said in line for line in result.stderr.splitlines())


@pytest.mark.slow
def test_pairs_of_a_fit_that_do_not_belong_together(call):
    words = [*KAPPAS, "--wall-px", 1, "-o", "p.yaml"]
    result = call("calibrate", "--pair", "target.tif", "mirrored_aligned.tif", *words)
    assert result.exit_code == 0, result.stderr
    assert "warning: mirrored_aligned.tif: fits better mirrored left to right" in result.stderr
    result = call("calibrate", "--pair", "target.tif", "nm_aligned.tif", *words, "--overwrite")
    assert result.exit_code == 1
    assert result.stderr.startswith("error: nm_aligned.tif: heights: relief") and "looks like nm" in result.stderr


def test_pitch_that_disagrees_is_refused(call):
    for words in (["score", "target.tif"], ["calibrate", "-o", "p.yaml", "--pair", "target.tif"]):
        result = call(*words, "other_pitch.tif")
        assert result.exit_code == 1
        assert "other_pitch.tif: grid: " in result.stderr
        assert "0.5 x 0.6 µm" in result.stderr


@pytest.mark.parametrize("factor", [1e3, 1e-3, 1e6, 1e-6])
def test_units_a_thousand_or_a_million_off_are_told_on_import(call, tmp_path, factor):
    np.save(tmp_path / "raw.npy", WIDE)
    heights = call("convert", "raw.npy", "a.tif", "--pitch-um", "0.5", "--z-scale", factor, "--overwrite").stderr
    pitch = call("convert", "raw.npy", "a.tif", "--pitch-um", 0.5 * factor, "--overwrite").stderr
    assert ("raw.npy: z range" in heights and "is the unit right" in heights) or factor == 1e-3
    assert "raw.npy: field" in pitch and "is the pitch right" in pitch


def test_heights_given_in_mm_show_against_the_target(call):
    """4.9 nm of relief could be an import; beside a target of 5 µm it cannot."""
    assert disagreement(TARGET, PRINTED.with_heights(PRINTED.heights_um * 1e-3))


@pytest.mark.slow
def test_levelling_twice_is_told(call):
    assert align(call, "recording").exit_code == 0
    result = call("align", "out.tif", "target.tif", "-o", "again.tif")
    assert result.exit_code == 0, result.stderr
    assert "warning: out.tif: is levelled and on a target's grid already: align the recording itself" in result.stderr


def test_correcting_twice_is_told_also_after_a_conversion(call):
    assert call("precompensate", "target.tif", "-o", "corrected.tif").stderr == ""
    assert call("convert", "corrected.tif", "corrected.csv").exit_code == 0
    for name in ("corrected.tif", "corrected.csv"):
        result = call("precompensate", name, "-o", "twice.tif", "--overwrite")
        assert result.exit_code == 0
        assert f"warning: {name}: is corrected already: correct the target itself" in result.stderr


def test_correcting_a_prediction_is_told(call):
    assert call("predict", "target.tif", "-o", "predicted.tif").exit_code == 0
    assert "is a prediction, not a target" in call("precompensate", "predicted.tif", "-o", "c.tif").stderr


def test_a_file_changed_since_has_no_history(call):
    """The record beside a file is not believed where the file is another one by now."""
    assert call("precompensate", "target.tif", "-o", "corrected.tif").exit_code == 0
    write_height_map("corrected.tif", TARGET)
    assert call("precompensate", "corrected.tif", "-o", "c.tif").stderr == ""


@pytest.mark.slow
def test_target_and_recording_swapped(call):
    words = ["--size-um", 30, "--pitch-um", 0.5, "--margin-um", 5]
    assert call("design", "f", "-o", "design.tif", *words).exit_code == 0
    assert call("align", "recording.tif", "design.tif", "-o", "al.tif", "--keep-missing").exit_code == 0
    assert "swapped?" in call("score", "al.tif", "design.tif").stderr


@pytest.mark.slow
def test_a_design_in_the_place_of_the_recording(call):
    words = ["--size-um", 30, "--pitch-um", 0.5, "--margin-um", 5]
    assert call("design", "f", "-o", "design.tif", *words).exit_code == 0
    said = "design.tif: was made by design: are target and recording exchanged?"
    assert said in call("align", "design.tif", "aligned.tif", "-o", "al.tif", "--keep-missing").stderr
    assert said not in call("align", "recording.tif", "design.tif", "-o", "al.tif", "--overwrite").stderr


def test_a_recording_in_the_place_of_the_target(call):
    words = ["--size-um", 30, "--pitch-um", 0.5, "--margin-um", 5]
    assert call("design", "f", "-o", "design.tif", *words).exit_code == 0
    negative = PRINTED.with_heights(PRINTED.heights_um - 0.1)
    write_height_map("low.tif", negative)
    write_height_map("same.tif", TARGET)
    refused = call("calibrate", "--pair", "low.tif", "same.tif", "-o", "p.yaml")
    assert refused.exit_code == 1 and "are target and recording exchanged?" in refused.stderr


@pytest.mark.parametrize("kind", designs.KINDS)
def test_designs_and_their_prints_raise_no_doubt(kind):
    target = designs.KINDS[kind](pitch_um=0.5)
    printed = predict(target, ParameterSet())
    assert disagreement(target, printed) == []
    noisy = printed.with_heights(printed.heights_um + np.random.default_rng(1).normal(scale=0.01, size=printed.shape))
    assert clipping(noisy) == []


def test_the_flat_top_of_a_design_is_no_clipping():
    """A design of many heights with 13 points at its highest one; in a recording it is a limit of the instrument."""
    heights = np.random.default_rng(0).uniform(3, 10, (60, 60))
    heights[20, 10:23] = 11.0
    design = np.pad(heights, 20)
    assert clipping(HeightMap(design, 0.5, 0.5)) == []
    recorded = design + np.random.default_rng(1).normal(scale=0.01, size=design.shape)
    recorded[40, 30:43] = recorded.max() + 1
    assert "13 points at the highest height" in clipping(HeightMap(recorded, 0.5, 0.5))[0]

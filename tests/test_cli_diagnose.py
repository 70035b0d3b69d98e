"""`dlwpredict diagnose` from files to files: what it finds, what it leaves, and what it refuses."""

from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from dlwpredict import designs
from dlwpredict.api.diagnose import Answer
from dlwpredict.cli.app import app
from dlwpredict.diagnosis.answer.words import kind_of_remainder, remainder
from dlwpredict.diagnosis.structure.columns import Columns
from dlwpredict.diagnosis.structure.forms import Energy
from dlwpredict.diagnosis.structure.ripple import Ripple
from dlwpredict.diagnosis.structure.spots import Spot
from dlwpredict.effects import library
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.parameters_yaml import read_parameters
from dlwpredict.files.yaml_text import read_yaml
from dlwpredict.heightmap import HeightMap, Instrument
from dlwpredict.noise.covariance import Noise
from dlwpredict.parameters import Paper, ParameterSet
from dlwpredict.process import predict

PROCESS = Paper(exposure_fwhm_z_um=1.7, threshold=0.47, shrinkage_min=0.74, shrinkage_max=0.96)
NOISE = Noise(0.004, 0.01, 1.0, 0.4, 0.4)
DRYING = library()["edge-drying"](depth_um=0.15, length_um=3.0)
PART = {"size_um": 20.0, "pitch_um": 0.4, "margin_um": 4.0}
LARGER = PART | {"size_um": 24.0}
"""One such part alone tells the process: what is left out is predicted by the other."""


def recorded(target, seed, *effects):
    surface = predict(target, ParameterSet(paper=PROCESS, effects=effects), as_measured=True)
    return surface.with_heights(surface.heights_um + NOISE.simulate(target.shape, np.random.default_rng(seed)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("prints")
    for k, target in enumerate((designs.air(**PART), designs.stairs(feature_um=2.5, **PART))):
        write_height_map(folder / f"t{k}.tif", target)
        write_height_map(folder / f"plain{k}.tif", recorded(target, 10 + k))
        write_height_map(folder / f"dried{k}.tif", recorded(target, 20 + k, DRYING))
    for k, target in enumerate((designs.air(**LARGER), designs.stairs(feature_um=2.5, **LARGER))):
        write_height_map(folder / f"larger{k}.tif", target)
        write_height_map(folder / f"larger_dried{k}.tif", recorded(target, 20 + k, DRYING))
    write_height_map(folder / "dried0_again.tif", recorded(designs.air(**PART), 30, DRYING))
    return folder


def called(folder, *words):
    return CliRunner().invoke(app, ["diagnose", *(str(folder / w) if w.endswith(".tif") else w for w in words)])


def pairs(kind):
    target = "larger" if kind.startswith("larger") else "t"
    return [w for k in (0, 1) for w in ("--pair", f"{target}{k}.tif", f"{kind}{k}.tif")]


@pytest.fixture(scope="module")
def dried(folder, tmp_path_factory):
    out = tmp_path_factory.mktemp("diagnosis")
    files = [
        "--plot",
        out / "diagnosis.png",
        "--maps",
        out / "maps",
        "--report",
        out / "report.html",
        "--params-out",
        out / "extended.yaml",
    ]
    found = called(folder, *pairs("larger_dried"), "-o", str(out / "d.yaml"), *map(str, files))
    assert found.exit_code == 0, found.output
    return out, found


@pytest.mark.slow
def test_effect_is_named_and_sized(dried):
    content = read_yaml(dried[0] / "d.yaml")
    assert content["verdict"] in ("identified", "ambiguous")
    first = content["findings"][0]
    assert "edge-drying" in first["effects"]
    depth = first["parameters"]["edge-drying"]["depth_um"]
    assert depth["low"] <= DRYING.depth_um <= depth["high"]
    assert first["p_value"] < 0.01
    assert content["extended"]["rmse_um"] < content["baseline"]["rmse_um"]
    assert content["extended"]["holdout_rmse_um"] < content["baseline"]["holdout_rmse_um"]
    assert content["noise_um"] == pytest.approx(NOISE.sigma_um, rel=0.25)
    assert "z-amplification" in content["not_testable"]
    assert set(content["tested"]) | set(content["not_testable"]) == set(library())


@pytest.mark.slow
def test_content_has_the_keys_that_others_rely_on(dried):
    content = read_yaml(dried[0] / "d.yaml")
    assert content["format"] == "dlwpredict-diagnosis/1"
    for model in ("baseline", "extended"):
        assert {"rmse_um", "holdout_rmse_um", "parameters"} <= set(content[model])
    for place in content["locations"]:
        assert {"pair", "where", "share", "x_um", "y_um"} <= set(place)
    for finding in content["findings"]:
        assert {"effects", "side", "statement", "parameters", "p_value", "rmse_um", "holdout_rmse_um",
                "separate_by"} <= set(finding)  # fmt: skip
        assert sum(finding["members"].values()) == pytest.approx(1, abs=1e-3)
        assert list(finding["members"]) == finding["effects"]
        assert sum(finding["side_probability"].values()) == pytest.approx(1, abs=1e-3)
        assert 0.5 < finding["probability"] <= 1
    assert {"significant", "rms_um", "p_value", "description"} <= set(content["remainder"])
    assert content["remainder"]["kind"] in ("none", "smooth", "ripple", "spot", "columns")
    assert content["complete"] is True and content["not_tried"] == []
    assert content["working_pitch_um"] == PART["pitch_um"]
    assert content["work"]["predictions"] > 50 and content["work"]["cpu_s"] > 1
    assert [path.name for path in dried[0].glob("*.resume.json")] == []


@pytest.mark.slow
def test_maps_add_up(folder, dried):
    for k in (0, 1):
        maps = {n: read_height_map(dried[0] / "maps" / f"{n}_{k}.tif") for n in ("residual", "explained", "remainder")}
        target = read_height_map(folder / f"larger{k}.tif")
        assert maps["residual"].shape == target.shape
        assert maps["residual"].dx_um == pytest.approx(target.dx_um)
        added = maps["explained"].heights_um + maps["remainder"].heights_um
        np.testing.assert_allclose(maps["residual"].heights_um, added, atol=1e-5)
        sure = read_height_map(dried[0] / "maps" / f"mismatch_{k}.tif").heights_um
        assert np.nanmin(sure) >= 0
        assert np.nanmax(sure) <= 1


@pytest.mark.slow
def test_extended_file_predicts(folder, dried):
    process = read_parameters(dried[0] / "extended.yaml")
    sides = [process, process.decided("print"), process.decided("measurement")]
    assert "edge-drying" in {effect.name for one in sides for effect in one.effects}
    assert predict(read_height_map(folder / "t0.tif"), process).heights_um.max() > 1


@pytest.mark.slow
def test_terminal_and_page(dried):
    out, found = dried
    lines = found.stdout.splitlines()
    assert len(lines) <= 27  # two of them before it begins
    assert "working pixels of 0.4 µm (as recorded); this takes" in lines[0]
    assert (out / "diagnosis.png").stat().st_size > 50_000
    assert "edge-drying" in found.stdout
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "edge-drying" in page
    assert "dlwpredict diagnose --pair" in page


@pytest.mark.slow
def test_nothing_is_named_where_nothing_is_missing(folder, tmp_path):
    found = called(folder, *pairs("plain"), "-o", str(tmp_path / "d.yaml"), "--no-advice")
    assert found.exit_code == 0, found.output
    content = read_yaml(tmp_path / "d.yaml")
    assert content["verdict"] == "none"
    assert content["findings"] == []
    assert content["extended"] == content["baseline"]


@pytest.mark.slow
def test_spikes_holes_and_relative_heights_are_no_physics(folder, tmp_path):
    """A print cropped without substrate, lifted and tilted, a tenth of it missing, with lone spikes and a scar."""
    rng, target = np.random.default_rng(40), designs.air(**PART | {"margin_um": 0.0})
    heights = recorded(target, 41).heights_um - 3 + 0.002 * target.x_um[None, :]
    heights[rng.random(target.shape) < 0.1] = np.nan
    heights[rng.random(target.shape) < 0.002] += 1.0
    heights[20] += 0.15
    write_height_map(folder / "cropped.tif", target)
    scan = HeightMap(heights, target.dx_um, target.dy_um, "relative", instrument=Instrument("afm", 0.0))
    write_height_map(folder / "lifted.tif", scan)
    words = "-o", str(tmp_path / "d.yaml"), "--no-advice", "--report", str(tmp_path / "d.html")
    found = called(folder, "--pair", "cropped.tif", "lifted.tif", *words)
    assert found.exit_code == 0, found.output
    content = read_yaml(tmp_path / "d.yaml")
    assert content["verdict"] == "none"
    assert content["noise"][0]["scars"] == 1
    assert "1 line of the scan left out for scars" in found.output
    assert "Spectrum along x, the fast axis" in (tmp_path / "d.html").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.long
def test_held_out_recordings_and_repeats_are_used(folder, tmp_path):
    found = called(
        folder, "--pair", "t0.tif", "dried0.tif", "--repeat", "dried0.tif", "dried0_again.tif",
        "--holdout", "t1.tif", "dried1.tif", "-o", str(tmp_path / "d.yaml"), "--no-advice",
    )  # fmt: skip
    assert found.exit_code == 0, found.output
    content = read_yaml(tmp_path / "d.yaml")
    assert content["holdout_by"] == "recordings held out"
    assert content["noise_from"] == "repeats"
    assert content["noise_um"] == pytest.approx(NOISE.sigma_um, rel=0.25)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--pair", "t0.tif", "t0.tif"], "the recording is the target itself"),
        (["--pair", "t0.tif", "gone.tif"], "gone.tif"),
        (["--pair", "t0.tif", "dried0.tif", "--repeat", "dried1.tif", "dried0.tif"], "stands in no --pair"),
        (["--pair", "t0.tif", "dried0.tif", "--holdout", "t1.tif", "t1.tif"], "--holdout"),
    ],
)
def test_bad_input_is_one_line(folder, tmp_path, words, said):
    found = called(folder, *words, "-o", str(tmp_path / "d.yaml"))
    assert found.exit_code == 1
    assert said in found.stderr
    assert len(found.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "d.yaml").exists()


def test_folder_of_maps_is_not_overwritten(folder, tmp_path):
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "mine.txt").write_text("keep")
    found = called(folder, *pairs("plain"), "-o", str(tmp_path / "d.yaml"), "--maps", str(tmp_path / "maps"))
    assert found.exit_code == 1
    assert "exists already" in found.stderr


def test_what_the_diagnosis_left_open_goes_with_the_parameters():
    recordings = [SimpleNamespace(measured=HeightMap(np.eye(3), 1, 1))]
    rest = {"significant": True, "rms_um": 0.0123}

    def cautions(better=True, named=("curl",), **content):
        return Answer(
            content, SimpleNamespace(recordings=recordings, predicts_better=better, explained=0.4, named=named), []
        ).cautions

    (said,) = cautions(verdict="unexplained", remainder=rest)
    assert "60 % of the mismatch has no name" in said
    (said,) = cautions(better=False, named=(), verdict="unexplained", remainder=rest)
    assert "what the seven parameters leave has no name" in said
    (said,) = cautions(better=False, verdict="unexplained", remainder=rest)
    assert "do not predict better what was held out" in said
    (said,) = cautions(verdict="identified", remainder=rest)
    assert "left 0.0123 µm beyond noise" in said
    assert "before it was complete" in cautions(verdict="none", complete=False, remainder=rest)[0]
    assert cautions(verdict="none", remainder={"significant": False, "rms_um": None}) == []


NAMELESS = "9.0 nm of structure have no name"
LARGE, TINY = (1e-6, 1000.0), (1e-6, 5.0)
"""p-value and energy of free forms that hold more, or less, than any pattern of the test below."""


@pytest.mark.parametrize(
    ("wave", "spot", "lines", "smooth", "kind", "said"),
    [
        (
            0.5,
            1e-99,
            0.5,
            TINY,
            "spot",
            ["A spot about 2.0 µm wide sits at x = 3.6, y = -3.2 µm in dust", NAMELESS],
        ),
        (1e-15, 0.5, 0.5, TINY, "ripple", ["A ripple of period 4.6 µm runs at 18° to x in waves.tif", NAMELESS]),
        (0.5, 0.5, 1e-4, TINY, "columns", ["Lines along y differ by 7.0 nm from one another in lines.tif", NAMELESS]),
        (0.0, 1e-3, 0.5, TINY, "spot", ["A spot about", "A ripple of period", NAMELESS]),
        (0.5, 0.5, 0.5, TINY, "smooth", [NAMELESS]),
        (0.5, 0.5, 1e-99, LARGE, "smooth", [NAMELESS, "Lines along y differ"]),
        (0.5, 1e-3, 1e-99, (0.5, 1000.0), "spot", ["A spot about", "Lines along y differ"]),
    ],
)
def test_what_holds_most_describes_what_is_left(wave, spot, lines, smooth, kind, said):
    """However sure: lines of 3 nm, known to be there beyond doubt, are not what is left where 29 nm have no name."""
    patterns = (
        Ripple(pair=0, period_um=4.6, angle_deg=18, excess=30, p_value=wave),
        Spot(pair=1, x_um=3.6, y_um=-3.2, fwhm_um=2, excess=400, p_value=spot),
        Columns(pair=2, size_um=0.007, excess=20, p_value=lines),
    )
    forms = Energy(excess=smooth[1], p_value=smooth[0])
    model = SimpleNamespace(unexplained=True, patterns=patterns, forms=forms, structure_um=0.009)
    recordings = [SimpleNamespace(name=name) for name in ("waves.tif", "dust.tif", "lines.tif")]
    found = SimpleNamespace(extended=model, recordings=recordings, named=(), blemishes=(), doubted=())
    places = [remainder(found).index(part) for part in said]
    assert places == sorted(places) and places[0] == 0
    assert (NAMELESS in remainder(found)) == (NAMELESS in said)
    found.blemishes = (SimpleNamespace(pair=1, x_um=1.25, y_um=-2.0),)
    assert remainder(found).endswith("Left out of the fits as blemishes: x = 1.2, y = -2.0 µm in dust.tif.")
    assert kind_of_remainder(found) == kind
    found.doubted = ("curl",)
    assert "curl would explain more than noise; so might the form of the process itself" in remainder(found)
    found.extended, found.blemishes = SimpleNamespace(unexplained=False), ()
    assert remainder(found).startswith("curl would explain"), "noise is not all that is left"

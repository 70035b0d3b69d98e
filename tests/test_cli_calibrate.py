"""`dlwpredict calibrate` from files to files, and what it refuses."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from dlwpredict import designs
from dlwpredict.cli.app import app
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.parameters_yaml import read_parameters, write_parameters
from dlwpredict.files.yaml_text import read_yaml
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import Paper, ParameterSet
from dlwpredict.process import predict

TRUTH = ParameterSet(paper=Paper(shrinkage_min=0.74, shrinkage_max=0.96))
KAPPAS = ["--free", "shrinkage_min", "--free", "shrinkage_max"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pairs")
    target = designs.air(size_um=24.0, pitch_um=0.5, margin_um=4.0)
    noise = np.random.default_rng(0).normal(scale=0.01, size=target.shape)
    printed = predict(target, TRUTH)
    write_height_map(folder / "target.tif", target)
    write_height_map(folder / "aligned.tif", printed.with_heights(printed.heights_um + noise))
    write_height_map(folder / "twin.tif", printed.with_heights(printed.heights_um - noise))
    write_height_map(folder / "small.tif", HeightMap(np.ones((20, 20)), 0.5, 0.5))
    write_height_map(folder / "empty.tif", target.with_heights(np.zeros(target.shape)))
    write_height_map(
        folder / "gone.tif",
        target.with_heights(np.where(target.x_um[None, :] < 11.5, np.nan, 1.0) + 0 * target.heights_um),
    )
    narrow = ParameterSet(bounds={"threshold": (0.1, 0.2)})
    write_parameters(folder / "narrow.yaml", narrow)
    return folder


@pytest.fixture
def call(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(folder)

    def run(*words):
        return CliRunner().invoke(app, ["calibrate", *map(str, words), "-o", str(tmp_path / "p.yaml")])

    return run


@pytest.mark.slow
def test_two_pairs_give_parameters_report_and_provenance(call, tmp_path):
    result = call(
        "--pair",
        "target.tif",
        "aligned.tif",
        "--pair",
        "target.tif",
        "twin.tif",
        *KAPPAS,
        "--report",
        tmp_path / "r.json",
    )
    assert result.exit_code == 0, result.output
    found = read_parameters(tmp_path / "p.yaml")
    assert (found.paper.shrinkage_min, found.paper.shrinkage_max) == pytest.approx((0.74, 0.96), abs=2e-3)
    assert set(found.intervals) == {"shrinkage_min", "shrinkage_max"}
    assert set(found.provenance["inputs"]) == {"target.tif", "aligned.tif", "twin.tif"}
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["rmse_um"]["after"] == pytest.approx(0.01, rel=0.05)
    assert report["recordings"][0]["cc"]["after"] > 0.999
    assert report["holdout"]["rmse_um"] == pytest.approx(0.01, rel=0.1)


@pytest.mark.slow
def test_same_command_same_bytes(call, tmp_path):
    words = ("--pair", "target.tif", "aligned.tif", *KAPPAS, "--overwrite", "--report", tmp_path / "r.yaml")
    texts = []
    for _ in range(2):
        assert call(*words).exit_code == 0
        texts.append([(tmp_path / name).read_bytes() for name in ("p.yaml", "r.yaml")])
    assert texts[0] == texts[1]
    assert read_yaml(tmp_path / "r.yaml")["format"] == "dlwpredict-calibration/1"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["--pair", "target.tif", "small.tif"],
            "small.tif: grid: 20 x 20 px at 0.5 x 0.5 µm, but target.tif has 64 x 64",
        ),
        (["--pair", "empty.tif", "aligned.tif"], "empty.tif: heights: nothing written"),
        (["--pair", "target.tif", "gone.tif", "--wall-px", "0"], "gone.tif: heights: 48 measured points on the part"),
        (["--pair", "target.tif", "target.tif"], "target.tif: --pair: the recording is the target itself"),
        (
            ["--pair", "target.tif", "aligned.tif", "--pair", "target.tif", "aligned.tif"],
            "aligned.tif: --pair: given in two",
        ),
        (["--pair", "target.tif", "aligned.tif", "--fix", "kappa"], "--fix: found kappa, allowed: exposure_fwhm_xy_um"),
        (
            ["--pair", "target.tif", "aligned.tif", "-p", "narrow.yaml"],
            "narrow.yaml: threshold: start value 0.5, allowed",
        ),
        (["--pair", "target.tif", "absent.tif"], "absent.tif"),
        (["--pair", "target.tif", "aligned.tif", "--report", "r.txt"], "r.txt: --report: found .txt"),
    ],
)
def test_bad_input_is_refused_in_one_line(call, tmp_path, words, said):
    result = call(*words)
    assert result.exit_code == 1
    assert said in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "p.yaml").exists()


def test_half_a_pair_is_a_usage_error(call):
    result = call("--pair", "target.tif")
    assert result.exit_code == 2
    assert "--pair takes two files" in result.stderr


def test_existing_output_is_kept(call, tmp_path):
    (tmp_path / "p.yaml").write_text("mine")
    assert call("--pair", "target.tif", "aligned.tif", *KAPPAS).exit_code == 1
    assert (tmp_path / "p.yaml").read_text() == "mine"


def test_interrupt_leaves_the_best_so_far_under_a_partial_name(call, tmp_path, monkeypatch):
    from dlwpredict.infer.objective import Objective

    counted, at = [], Objective.at

    def interrupted(self, free, vector, near=None):
        counted.append(1)
        if len(counted) > 3:
            raise KeyboardInterrupt
        return at(self, free, vector, near)

    monkeypatch.setattr(Objective, "at", interrupted)
    result = call("--pair", "target.tif", "aligned.tif")
    assert result.exit_code == 130
    assert "interrupted" in result.stderr and "p.partial.yaml" in result.stderr
    assert not (tmp_path / "p.yaml").exists()
    assert read_parameters(tmp_path / "p.partial.yaml").paper


@pytest.mark.slow
def test_the_bare_fit_and_the_papers_are_there_for_the_asking(call, tmp_path):
    """Priors move what they are about; κ has none, so three ways of fitting it agree."""
    found = []
    for words in ((), ("--no-priors",), ("--method", "simplex", "--loss", "square", "--fixed-shift")):
        result = call("--pair", "target.tif", "aligned.tif", *KAPPAS, *words, "--overwrite")
        assert result.exit_code == 0, result.output
        found.append(read_parameters(tmp_path / "p.yaml").paper)
    for one in found[1:]:
        assert one.shrinkage_max == pytest.approx(found[0].shrinkage_max, abs=2e-3)


@pytest.mark.slow
def test_the_report_keeps_its_keys(call, tmp_path):
    assert call("--pair", "target.tif", "aligned.tif", *KAPPAS, "--report", tmp_path / "r.yaml").exit_code == 0
    report = read_yaml(tmp_path / "r.yaml")
    assert list(report)[:9] == [
        "format",
        "rmse_um",
        "holdout",
        "parameters",
        "correlation",
        "open_directions",
        "noise_from",
        "recordings",
        "work",
    ]
    assert set(report["holdout"]) == {"rmse_um", "folds", "block_um", "buffer_um"}
    keys = {"value", "low", "high", "standard_error", "interval_from", "identified", "unit"}
    assert set(report["parameters"]["shrinkage_min"]) == keys
    assert {"white", "correlated", "length", "smoothness"} < set(report["recordings"][0]["noise_um"])
    assert report["correlation"]["shrinkage_min"]["shrinkage_min"] == 1.0
    assert report["noise_from"] == "residual" and set(report["work"]) == {"fit", "all"}


@pytest.mark.slow
def test_a_parameter_at_its_bound_is_not_identified(call, tmp_path, folder):
    """The truth, 0.96, lies beyond the bound: however narrow the interval there, it is the bound's."""
    write_parameters(
        folder / "low.yaml", ParameterSet(paper=Paper(shrinkage_max=0.9), bounds={"shrinkage_max": (0.5, 0.92)})
    )
    words = ["--pair", "target.tif", "aligned.tif", *KAPPAS, "-p", "low.yaml", "--report", tmp_path / "r.yaml"]
    result = call(*words)
    assert result.exit_code == 0, result.output
    assert "at a bound: shrinkage_max 0.92" in result.stderr and "diagnose says what" in result.stderr
    found = read_yaml(tmp_path / "r.yaml")["parameters"]
    ends = found["shrinkage_max"]["low"], found["shrinkage_max"]["high"]
    assert ends == (None, None) or 0 < ends[1] - ends[0] < 0.2
    assert found["shrinkage_max"]["identified"] is False
    assert found["shrinkage_min"]["identified"] is True


@pytest.mark.slow
def test_a_process_from_relative_heights_says_so_where_it_is_used(call, tmp_path, folder):
    aligned = read_height_map(folder / "aligned.tif")
    write_height_map(folder / "relative.tif", replace(aligned, height_reference="relative"))
    said = "learned from relative heights only"
    for recording, warned in (("relative.tif", True), ("aligned.tif", False)):
        assert call("--pair", "target.tif", recording, *KAPPAS, "--overwrite").exit_code == 0
        words = ["precompensate", "target.tif", "-p", tmp_path / "p.yaml", "-o", tmp_path / "c.tif", "--overwrite"]
        done = CliRunner().invoke(app, [str(word) for word in words])
        assert done.exit_code == 0
        assert (f"p.yaml: {said}" in done.stderr) is warned
        stated = read_yaml(tmp_path / "p.yaml")["provenance"]
        assert stated["command"].startswith("dlwpredict calibrate") and len(stated["inputs"]) == 2
        assert CliRunner().invoke(app, ["verify", str(tmp_path / "p.yaml")]).exit_code == 0

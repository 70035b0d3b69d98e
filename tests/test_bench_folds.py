"""Real prints halved again and again: divisions, the trivial predictions, and what is kept."""

import json

import numpy as np
import pytest

from dlwpredict import designs
from tests.bench import folds
from tests.bench.real import blurred

FIELDS = [f"FOV{k:02d}" for k in range(16)]


def test_a_division_is_two_halves_and_no_two_are_alike():
    divisions = [folds.halved(FIELDS, fold) for fold in range(7)]
    assert all(sorted(fitted + unseen) == FIELDS and len(fitted) == 8 for fitted, unseen in divisions)
    assert len({tuple(fitted) for fitted, _ in divisions}) == 7
    assert folds.halved(FIELDS[::-1], 3) == divisions[3]


def test_a_bent_scale_of_a_blurred_target_is_found():
    target = designs.lens(size_um=24, pitch_um=0.4, margin_um=2)
    shape = blurred(target, 1.7)
    measured = target.with_heights(0.8 * shape - 0.03 * shape**2 + 0.1)
    predicted = folds.bent([(target, measured)])(target)
    assert folds.left_um(predicted, measured)["plane"] < 1e-4


def test_lines_are_free_besides():
    target = designs.lens(size_um=24, pitch_um=0.4, margin_um=2)
    rng = np.random.default_rng(0)
    rows, cols = target.shape
    places = np.linspace(-1, 1, cols)
    lines = 0.02 * rng.normal(size=(rows, 1)) + 0.01 * rng.normal(size=(rows, 1)) * places
    measured = target.with_heights(target.heights_um + lines + 0.3 * places + 1)
    left = folds.left_um(target.heights_um, measured)
    assert left["plane"] == pytest.approx(np.hypot(0.02, 0.01 / np.sqrt(3)), rel=0.3)
    assert left["lines"] < 1e-12


def one(fold: int, error_um: float = 0.02, names=(("slope-error",), ("curl", "vignetting"))) -> dict:
    errors = {
        way: {"plane": size, "lines": 0.9 * size} for way, size in ((folds.SEVEN, 0.027), (folds.NAMED, error_um))
    }
    named = [[list(some), 0.6] for some in names]
    return {"fold": fold, "version": folds.__version__, "cpu_s": 1000 + fold, "verdict": "unexplained",
            "explained": 0.7, "named": named, "errors_um": errors}  # fmt: skip


def test_the_table_says_how_far_divisions_differ_and_how_often_a_name_comes():
    some = [one(0, 0.020), one(1, 0.023), one(2, 0.028, (("vignetting",),))]
    rows = {row["what"]: row["value"] for row in folds.table_of(some)["rows"]}
    assert rows["offset and tilt free: with what was named, median (20.0 to 28.0)"] == pytest.approx(23)
    assert rows["offset and tilt free: names predict better than the seven alone, share"] == pytest.approx(0.667)
    assert rows["slope-error in a named class, divisions (2 times the likeliest of it)"] == 2
    assert rows["vignetting in a named class, divisions (1 times the likeliest of it)"] == 3
    assert rows["processor time, median"] == 1001


def test_a_run_goes_on_after_what_is_kept(tmp_path, monkeypatch):
    asked, report = [], tmp_path / "folds.json"
    monkeypatch.setattr(folds, "folded", lambda real, fold: asked.append(fold) or one(fold))
    for words in (["--minutes", "0"], ["--folds", "2"], ["--folds", "4"]):
        assert folds.main([str(tmp_path), "--report", str(report), "--processes", "1", *words]) == 0
    assert asked == [0, 1, 2, 3]
    assert [kept["fold"] for kept in json.loads(report.read_text())["folds"]] == [0, 1, 2, 3]
    another = json.loads(report.read_text()) | {"folds": [one(0) | {"version": "0.1.0"}]}
    report.write_text(json.dumps(another))
    folds.main([str(tmp_path), "--report", str(report), "--processes", "1", "--folds", "1"])
    assert asked[4:] == [0]

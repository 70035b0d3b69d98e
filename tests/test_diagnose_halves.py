"""Halves of the recordings, diagnosed apart: how they are drawn, what they agree on, what is said of it."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from dlwpredict import designs
from dlwpredict.api.diagnose import Answer, in_halves
from dlwpredict.cli import app
from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.answer.halves import agreeing, halves, with_halves
from dlwpredict.diagnosis.run import Course
from dlwpredict.effects import library
from dlwpredict.files import write_height_map
from dlwpredict.files.yaml_text import read_yaml
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import predict


@pytest.mark.parametrize("count", [4, 5, 16])
def test_two_halves_hold_every_recording_once(count):
    found = halves(count, 20, seed=3)
    for one, other in zip(found[::2], found[1::2], strict=True):
        assert sorted(one + other) == list(range(count)) and abs(len(one) - len(other)) <= 1
    assert found == halves(count, 20, seed=3) != halves(count, 20, seed=4)
    together = sum(0 in half and 1 in half for half in found)
    assert together > 0 and len(set(found)) > 3


def test_chance_seldom_agrees():
    """A name that a half has by chance every other time, five splits: as often settled as the binomial law says."""
    rng = np.random.default_rng(0)
    drawn = rng.random((4000, 2 * policy.SPLITS)) < 0.5
    asked = [answered(content(finding("curl")), [[CURL] if hit else [] for hit in row]) for row in drawn]
    settled = [said["findings"][0]["reproducible"]["settled"] for said in asked]
    assert np.mean(settled) == pytest.approx(56 / 1024, abs=0.011)


def finding(*names):
    return {"effects": list(names), "statement": "It is so."}


def content(*findings, verdict="identified"):
    return {"verdict": verdict, "sentence": "The model lacks it.", "findings": list(findings)}


def answered(content, named):
    return with_halves(content, halves(8, len(named) // 2, seed=0), named)


CURL, LOOKS, DRIFT = frozenset({"curl"}), frozenset({"curl", "vignetting"}), frozenset({"z-drift"})


@pytest.mark.parametrize(
    ("named", "verdict", "settled"),
    [
        ([[CURL, DRIFT]] * 10, "identified", [True, True]),
        ([[LOOKS]] * 8 + [[]] * 2, "identified", [True, False]),
        ([[DRIFT]] * 10, "ambiguous", [False, True]),
        ([[CURL]] * 7 + [[DRIFT]] * 3, "ambiguous", [False, False]),
    ],
)
def test_nothing_is_identified_that_halves_do_not_agree_on(named, verdict, settled):
    said = answered(content(finding("curl"), finding("z-drift")), named)
    assert said["verdict"] == verdict
    assert [one["reproducible"]["settled"] for one in said["findings"]] == settled
    for one, name in zip(said["findings"], ("curl", "z-drift"), strict=True):
        assert ("not settled" in one["statement"]) is not one["reproducible"]["settled"]
        assert (name in said["sentence"]) is not one["reproducible"]["settled"]


def test_what_found_nothing_stays_as_it_is():
    said = content(verdict="none")
    empty = [{"recordings": list(half), "named": []} for half in halves(8, 1, seed=0)]
    assert answered(said, [[], []]) == said | {"findings": [], "halves": empty}


def test_a_class_of_a_half_stands_for_one_finding():
    """Look-alikes in two findings: what halves name once is settled once, and it is the likest one."""
    findings = finding("curl", "z-drift"), finding("vignetting", "z-drift", "power-drift")
    said = answered(content(*findings), [[DRIFT]] * 10)
    assert [one["reproducible"]["agree"] for one in said["findings"]] == [10, 0]
    effects = [one["effects"] for one in findings]
    assert agreeing(effects, [DRIFT, CURL]).tolist() == [True, True]
    assert agreeing(effects[::-1], [DRIFT]).tolist() == [False, True]
    assert all(half["named"] == [["z-drift"]] and len(half["recordings"]) == 4 for half in said["halves"])


def test_halves_say_how_far_they_are(monkeypatch):
    told, pair = [], SimpleNamespace(recording=None, repeats=())
    monkeypatch.setattr("dlwpredict.api.diagnose.named_by", lambda *_: [CURL])
    answer = in_halves(Answer(content(finding("curl")), None, [pair] * 4), None, course=Course(told.append))
    assert answer.content["findings"][0]["reproducible"]["settled"]
    assert [stage.share for stage in told] == pytest.approx(np.arange(2 * policy.SPLITS) / (2 * policy.SPLITS))


@pytest.fixture(scope="module")
def pairs(tmp_path_factory):
    """Four recordings of different structures, of one press with dose memory."""
    folder, words = tmp_path_factory.mktemp("halves"), []
    effect, rng = library()["dose-memory"](gain=0.05), np.random.default_rng(2)
    size = {"size_um": 24, "pitch_um": 0.6, "margin_um": 4}
    parts = designs.air(**size, seed=1), designs.cin(**size), designs.air(**size, seed=5), designs.stairs(**size)
    for k, part in enumerate(parts):
        printed = predict(part, ParameterSet(effects=(effect,)))
        noisy = printed.with_heights(printed.heights_um + rng.normal(0, 0.01, part.shape))
        for name, one in ((f"target_{k}", part), (f"recording_{k}", noisy)):
            write_height_map(folder / f"{name}.tif", one)
        words.append(["--pair", str(folder / f"target_{k}.tif"), str(folder / f"recording_{k}.tif")])
    return folder, words


@pytest.mark.slow
@pytest.mark.long
def test_halves_of_real_data_agree_on_what_all_have(pairs, monkeypatch):
    folder, words = pairs
    monkeypatch.setattr(policy, "SPLITS", 1)
    out = folder / "diagnosis.yaml"
    line = ["diagnose", *itertools.chain(*words), "-o", str(out), "--reproducible", "--no-advice", "--jobs", "1"]
    result = CliRunner().invoke(app, line)
    assert result.exit_code == 0, result.output
    said = read_yaml(out)
    assert said["complete"] and said["findings"]
    first = said["findings"][0]
    assert "dose-memory" in first["effects"] and first["reproducible"] == {"halves": 2, "agree": 2, "settled": True}


def test_too_few_recordings_are_refused(pairs):
    folder, words = pairs
    line = ["diagnose", *itertools.chain(*words[:3]), "-o", str(folder / "few.yaml"), "--reproducible"]
    result = CliRunner().invoke(app, line)
    assert result.exit_code == 1 and "--reproducible: 3 recordings, allowed: with 4 or more" in result.stderr
    assert not (folder / "few.yaml").exists()

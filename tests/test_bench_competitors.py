"""The other methods, on a small linear problem: a strong effect is found, and noise is given no name."""

import json
import runpy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from dlwpredict.heightmap import HeightMap
from dlwpredict.noise.covariance import Noise
from tests.bench import competitors
from tests.bench.competitors import Blocks, Screen, SetsOfSize, calibrated, entering, forward, spiked, stable
from tests.prove.sealed import write

ROWS, BLOCKS, EACH = 960, 24, 3
NAMES = "vignetting", "curl", "galvo-lag", "psf-wings", "dose-memory", "tip-convolution"


def made(strengths=None, seed=0):
    """Six effects of three like columns each, beside four nuisances, in white noise of variance 1."""
    rng = np.random.default_rng(seed)
    nuisances, noise = rng.standard_normal((ROWS, 4)), rng.standard_normal(ROWS)
    basis = np.linalg.qr(nuisances)[0]
    names = [name for name in NAMES for _ in range(EACH)]
    columns = np.repeat(rng.standard_normal((ROWS, len(NAMES))), EACH, axis=1) + rng.standard_normal((ROWS, len(names)))
    columns -= basis @ (basis.T @ columns)
    columns /= np.linalg.norm(columns, axis=0)
    residual = noise + nuisances @ [3.0, -2.0, 1.0, 5.0]
    for name, size in (strengths or {}).items():
        residual = residual + size * columns[:, names.index(name) + 1]
    blocks = Blocks.of(nuisances, columns, residual, np.arange(ROWS) * BLOCKS // ROWS)
    count = len(names)
    return Screen(
        names, np.zeros(count), columns.T @ columns, columns.T @ (residual - basis @ (basis.T @ residual)),
        np.full(count, 8.0), np.ones(count), float(ROWS), blocks,
    )  # fmt: skip


METHODS = {"bic": forward, "lasso": lambda screen: stable(screen)[0], "slab": lambda screen: spiked(screen)[0]}


@pytest.fixture(autouse=True)
def fewer_draws(monkeypatch):
    monkeypatch.setattr(competitors, "DRAWS", 400)


@pytest.mark.parametrize("method", METHODS)
def test_a_strong_effect_is_named_and_noise_is_not(method):
    assert METHODS[method](made({"galvo-lag": 15.0})) == ["galvo-lag"]
    assert METHODS[method](made()) == []


@pytest.mark.parametrize("method", METHODS)
def test_two_strong_effects_are_both_named(method):
    assert sorted(METHODS[method](made({"galvo-lag": 15.0, "curl": -14.0}))) == ["curl", "galvo-lag"]


@pytest.mark.parametrize("method", ["bic", "slab"])
def test_a_forbidden_sign_is_not_named(method):
    screen = made({"galvo-lag": 15.0})
    assert METHODS[method](replace(screen, signs=-np.ones(len(screen.names)))) != ["galvo-lag"]


def test_bic_extended_by_the_columns_asks_for_more():
    screen = made()
    weak = replace(screen, scores=3.1 * screen.products[screen.names.index("galvo-lag")])
    assert np.log(screen.points) < 3.1**2 < np.log(screen.points) + 2 * np.log(len(screen.names))
    assert forward(weak) == ["galvo-lag"] and forward(weak, extended=True) == []


def test_all_blocks_together_are_the_whole_problem():
    screen = made({"curl": 6.0})
    products, scores = screen.blocks.part(range(BLOCKS))
    assert np.allclose(products, screen.products) and np.allclose(scores, screen.scores)


def test_halves_are_fitted_alone():
    """A block that is left out has no say, not even by what it would make of the nuisances."""
    screen, other = made({"curl": 6.0}), made({"curl": 6.0})
    other.blocks.products[0] *= 7
    for mine, its in zip(screen.blocks.part(range(1, 13)), other.blocks.part(range(1, 13)), strict=True):
        assert np.array_equal(mine, its)


def test_first_group_on_the_path_has_the_steepest_gradient_for_its_size():
    screen = made({"curl": 6.0, "psf-wings": 5.0})
    steep = {name: np.linalg.norm(screen.scores[[one == name for one in screen.names]]) for name in NAMES}
    order = entering(screen.products, screen.scores, screen.names, 3)
    assert order[0] == max(steep, key=steep.get) and len(set(order)) == 3


def test_group_lasso_ends_where_no_group_can_be_lowered():
    screen, penalty = made({"curl": 8.0, "psf-wings": 7.0}), 3.0
    groups = [np.flatnonzero(np.array(screen.names) == name) for name in NAMES]
    strengths = np.zeros(len(screen.names))
    sizes = [np.linalg.eigvalsh(screen.products[np.ix_(own, own)])[-1] for own in groups]
    competitors._descend(
        screen.products, screen.scores, strengths, [(own, penalty, s) for own, s in zip(groups, sizes, strict=True)]
    )
    gradient = screen.scores - screen.products @ strengths
    assert strengths.any()
    for own in groups:
        size = np.linalg.norm(strengths[own])
        wanted = penalty * strengths[own] / size if size else gradient[own]
        assert np.allclose(gradient[own], wanted, atol=0.01) and np.linalg.norm(gradient[own]) < penalty + 0.01


def test_threshold_keeps_the_false_selections_expected():
    for groups in (14, 26):
        tau = competitors.threshold(groups)
        assert competitors.false_selections(tau, groups) <= competitors.EXPECTED
        assert competitors.false_selections(tau - 0.01, groups) > competitors.EXPECTED


@pytest.mark.slow
def test_spike_and_slab_names_noise_as_often_as_it_is_told_to():
    screen = made()
    sizes = [SetsOfSize.of(screen, size) for size in (1, 2, 3)]
    odds = calibrated(screen, sizes)
    root = np.linalg.cholesky(screen.products + 1e-12 * np.eye(len(screen.names)))
    scores = np.random.default_rng(5).standard_normal((400, len(screen.names))) @ root.T
    sums = [[sets.factors(one, screen.signs) + k * odds for k, sets in enumerate(sizes, start=1)] for one in scores]
    false = np.mean([np.logaddexp.reduce(np.concatenate(one)) > 0 for one in sums])
    assert 0.002 < false < 0.06


def test_bayes_factor_of_a_set_is_that_of_the_scores():
    """Beside the covariance of scores with and without the set's slab, computed in full."""
    screen = made({"curl": 3.0})
    sets = SetsOfSize.of(screen, 2)
    row = 7
    own, kind = sets.columns[row], dict.fromkeys(screen.names)
    sd = competitors.SLAB * screen.visible[own]
    noise = screen.products
    with_it = noise + (noise[:, own] * sd**2) @ noise[own]
    gain = screen.scores @ np.linalg.solve(noise, screen.scores) - screen.scores @ np.linalg.solve(
        with_it, screen.scores
    )
    wanted = gain / 2 - (np.linalg.slogdet(with_it)[1] - np.linalg.slogdet(noise)[1]) / 2 - 2 * np.log(EACH)
    assert sets.factors(screen.scores, screen.signs)[row] == pytest.approx(wanted)
    assert sets.names[sets.effects[row]] == tuple(name for name in kind if name in {screen.names[k] for k in own})


def test_effective_points_fall_with_the_correlation():
    far, near = (competitors.effective(Noise(0.003, 0.01, length, 0.4, 0.4), 6400) for length in (2.0, 0.5))
    assert far < near < 6400


def effect(name, times=2.0):
    return {"name": name, "times": times}


@pytest.mark.parametrize(
    ("truth", "said", "expected"),
    [
        ({"kind": "null", "effects": []}, ["curl"], {"false": True}),
        ({"kind": "single", "effects": [effect("curl", 0.5)]}, [], {"wrong": False}),
        ({"kind": "single", "effects": [effect("curl", 0.5)]}, ["curl", "vignetting"], {"wrong": True}),
        (
            {"kind": "single", "effects": [effect("curl")]}, ["vignetting", "galvo-lag"],
            {"heard": True, "class": True, "exact": False, "wrong": True},
        ),
        (
            {"kind": "pair", "effects": [effect("curl"), effect("vignetting")]}, ["curl"],
            {"pairs": False, "pairs exact": False, "wrong": False},
        ),
        (
            {"kind": "pair", "effects": [effect("curl"), effect("galvo-lag")]}, ["galvo-lag", "vignetting"],
            {"pairs": True, "pairs exact": False, "wrong": False},
        ),
        ({"kind": "outside", "effects": [effect("particle")]}, ["curl"], {"outside": True}),
        ({"kind": "form", "effects": []}, [], {"form": False}),
    ],
)  # fmt: skip
def test_all_are_marked_by_the_same_rules(truth, said, expected):
    assert competitors.marks(truth, {"names": said, "heard": bool(said)}) == expected


def test_recordings_off_their_targets_grid_are_aligned(tmp_path, monkeypatch):
    target = HeightMap(np.pad(np.full((30, 30), 5.0), 5), 0.45, 0.45)
    other = HeightMap(np.full((50, 50), 5.0), 0.3, 0.3)
    (tmp_path / "data" / "a").mkdir(parents=True)
    for k, measured in enumerate((target, other)):
        write(tmp_path / "data" / "a" / f"target_{k}.tif", target)
        write(tmp_path / "data" / "a" / f"recording_{k}.tif", measured)
    monkeypatch.setattr(competitors, "align", lambda measured, part: SimpleNamespace(aligned=part))
    found = competitors.recordings(tmp_path, "a")
    assert [one.measured.shape for one in found] == [target.shape] * 2
    assert found[0].points == found[1].points > 0


@pytest.mark.slow
def test_a_run_is_told_and_shown(tmp_path, monkeypatch):
    """Every method beside the program's answer; a case that cannot be read is told, not lost."""
    truths = {"a": {"kind": "null", "effects": []}, "b": {"kind": "single", "effects": [effect("galvo-lag")]},
              "c": {"kind": "null", "effects": []}}  # fmt: skip
    finding = {"verdict": "identified", "findings": [{"effects": ["galvo-lag", "curl"]}]}
    (tmp_path / "results").mkdir()
    for name, truth in truths.items():
        said = finding if name == "b" else {"verdict": "unexplained", "findings": []}
        result = {"name": name, "truth": truth, "seconds": 9.0, "code": "0", **said}
        (tmp_path / "results" / f"{name}.json").write_text(json.dumps(result))
    (tmp_path / "seal.json").write_text(json.dumps({"cases": {"b": {}, "a": {}, "c": {}}}))
    monkeypatch.setattr(competitors, "recordings", lambda folder, name: name)

    def screen_of(name):
        if name == "c":
            raise OSError("no such map")
        return made({"galvo-lag": 15.0} if name == "b" else None)

    monkeypatch.setattr(competitors, "screen_of", screen_of)
    told, kept = [], []
    table = competitors.run(tmp_path, None, 1.0, told.append, kept.append)
    assert [case["name"] for case in table["cases"]] == ["b", "a"] and table["failed"] == {"c": "no such map"}
    assert len(told) == 3 and [len(one["cases"]) for one in kept] == [1, 2, 2]
    own = {line["method"]: line for line in table["methods"]}
    assert own["diagnose"]["exact"]["hit"] == own["diagnose"]["false"]["hit"] == 1
    assert own["group lasso, stability selection"]["class"]["hit"] == 1
    shown = competitors.markdown(json.loads(json.dumps(table))).splitlines()
    assert len(shown) == 2 + len(own) and shown[0].count("|") == shown[-1].count("|")
    assert "1 of 1" in shown[-1] and "no case" in shown[-1] and "9 s" in shown[-1]


def test_page_of_evidence_shows_the_table_only_where_there_is_one():
    made_page = runpy.run_path(str(competitors.MAKE))
    title = "Sealed cases, answered by other methods"
    assert (title in made_page["evidence"]()) == (Path(competitors.MAKE).parent / "evidence/competitors.json").exists()

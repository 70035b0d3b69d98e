"""``design`` through the whole program: every kind, and how it refuses."""

import inspect

import numpy as np
import pytest
from typer.testing import CliRunner

from dlwpredict.cli import app
from dlwpredict.designs import KINDS, options_of
from dlwpredict.files import read_height_map


def run(*arguments):
    return CliRunner().invoke(app, ["design", *map(str, arguments)])


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_written_as_designed(tmp_path, kind):
    path = tmp_path / "target.tif"
    result = run(kind, "-o", path, "--pitch-um", 0.4)
    assert result.exit_code == 0, result.output
    assert f"{kind}, " in result.stdout
    assert result.stdout.count("\n") == 1
    written, made = read_height_map(path), KINDS[kind](pitch_um=0.4)
    assert written.same_grid(made)
    assert np.array_equal(written.heights_um, made.heights_um.astype(np.float32))


@pytest.mark.parametrize("kind", KINDS)
def test_help_lists_every_option_with_its_meaning(kind, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    text = run(kind, "--help").stdout
    for name, declaration in options_of(KINDS[kind]).items():
        assert f"--{name.replace('_', '-')} " in text
        assert declaration.meaning[1:] in text


@pytest.mark.parametrize("kind", KINDS)
def test_every_option_reaches_the_design(tmp_path, kind):
    """Give each option its default by name: the map is the default one."""
    first, second = tmp_path / "first.npy", tmp_path / "second.npy"
    given = []
    for name, option in inspect.signature(KINDS[kind]).parameters.items():
        if option.default is not None and option.default is not False:
            given += [f"--{name.replace('_', '-')}", 0.4 if name == "pitch_um" else option.default]
    assert run(kind, "-o", first, *given).exit_code == 0
    assert run(kind, "-o", second, "--pitch-um", 0.4).exit_code == 0
    assert first.read_bytes() == second.read_bytes()


def test_the_kinds_are_listed():
    text = run("--help").stdout
    assert all(kind in text for kind in KINDS)


def test_switches_and_options_change_the_part(tmp_path):
    path = tmp_path / "sinus.tif"
    assert run("grating", "-o", path, "--sinus", "--height-um", 2, "--base-um", 1, "--margin-um", 0).exit_code == 0
    heights = read_height_map(path).heights_um
    assert np.unique(np.round(heights, 3)).size > 10
    assert (heights.min(), heights.max()) == (pytest.approx(1, abs=0.01), pytest.approx(3, abs=0.01))


def test_the_seed_chooses_the_surface(tmp_path):
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        assert run("air", "-o", tmp_path / f"{name}.tif", "--pitch-um", 1, "--seed", seed).exit_code == 0
    first, second, third = ((tmp_path / f"{name}.tif").read_bytes() for name in "abc")
    assert first == second != third


def test_rounding_to_whole_pixels_is_told(tmp_path):
    result = run("f", "-o", tmp_path / "f.tif", "--size-um", 30.1, "--pitch-um", 0.5)
    assert result.exit_code == 0
    assert "warning: size and margin rounded to whole pixels: field 50 x 50 µm instead of 50.1 µm" in result.stderr


def test_quiet_says_nothing(tmp_path):
    assert run("f", "-o", tmp_path / "f.tif", "--quiet").output == ""


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["cin", "--radius-um", 3], 2, "--radius-um"),
        (["pyramid"], 2, "pyramid"),
        (["cin", "--size-um", "big"], 2, "--size-um"),
        (["cin", "--size-um", -5], 1, "error: design cin: --size-um: found -5, allowed 0.1 to 10000 µm"),
        (["cin", "--size-um", "nan"], 1, "--size-um: found nan"),
        (["cin", "--pitch-um", 0], 1, "--pitch-um: found 0"),
        (["cin", "--pitch-um", 5], 1, "--period-min-um: 3 µm is too fine"),
        (["cin", "--pitch-um", 0.001], 1, "pixels, allowed: at most"),
        (["lens", "--radius-um", 100, "--height-um", 1], 1, "--radius-um: given beside --height-um"),
        (["air", "--seed", -1], 1, "--seed: found -1"),
    ],
)
def test_what_cannot_be_made_is_refused_in_one_line(tmp_path, arguments, code, words):
    path = tmp_path / "target.tif"
    result = run(*arguments, "-o", path)
    assert result.exit_code == code
    assert words in result.stderr
    assert code == 2 or result.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_stairs_of_any_size_have_features_that_fit(tmp_path):
    for size, widest in ((80, 8.0), (20, 2.0)):
        path = tmp_path / f"{size}.tif"
        assert run("stairs", "-o", path, "--size-um", size, "--margin-um", 0).exit_code == 0
        heights = read_height_map(path).heights_um
        assert (heights[:, : heights.shape[1] // 4] > 4.1).any(axis=1).sum() * 0.2 == pytest.approx(2.5 * widest, abs=1)
    assert run("stairs", "-o", tmp_path / "a.tif", "--feature-um", 20).stderr.startswith(
        "error: design stairs: --feature-um"
    )


def test_an_existing_target_stays_unless_told(tmp_path):
    path = tmp_path / "f.tif"
    path.write_text("mine")
    assert run("f", "-o", path).exit_code == 1
    assert path.read_text() == "mine"
    assert run("f", "-o", path, "--overwrite").exit_code == 0
    assert read_height_map(path).heights_um.max() == 5

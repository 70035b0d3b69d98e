"""Pictures: one colour range for what is compared, scale bars, µm, colours that everyone can tell apart."""

from itertools import combinations

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image
from typer.testing import CliRunner

from dlwpredict import designs, plots
from dlwpredict.cli.app import app
from dlwpredict.files import write_height_map
from dlwpredict.parameters import ParameterSet
from dlwpredict.plots import panels
from dlwpredict.process import predict

TARGET = designs.cin(size_um=24, pitch_um=0.5, margin_um=4)
FIGURES = {
    "overview": lambda: plots.overview(TARGET, name="cin"),
    "comparison": lambda: plots.comparison(TARGET, lowered()),
    "correction": lambda: plots.correction(TARGET, lowered(), lowered(), TARGET.heights_um >= 0),
    "diagnosis": lambda: plots.diagnosis([("one", TARGET, *[lowered().heights_um * 0.01] * 4)] * 2),
    "calibration": lambda: plots.calibration([("one", TARGET, lowered(), TARGET, lowered().heights_um * 0)] * 2),
}


def lowered():
    return TARGET.with_heights(0.9 * TARGET.heights_um)


def maps_of(figure):
    """Return the images of heights and those of differences."""
    images = [image for axes in figure.axes for image in axes.images]
    split = {colours: [] for colours in (panels.HEIGHT_COLOURS, panels.DIFFERENCE_COLOURS, panels.CERTAINTY_COLOURS)}
    for image in images:
        split[image.get_cmap().name].append(image)
    return split[panels.HEIGHT_COLOURS], split[panels.DIFFERENCE_COLOURS]


@pytest.mark.parametrize("name", FIGURES)
def test_maps_share_one_colour_range_and_differences_one_about_zero(name):
    heights, differences = maps_of(FIGURES[name]())
    assert len({image.get_clim() for image in heights}) == (name != "diagnosis")
    assert len({image.get_clim() for image in differences}) == (name != "overview")
    for low, high in (image.get_clim() for image in differences):
        assert low == -high


@pytest.mark.parametrize("name", FIGURES)
def test_every_axis_is_in_um(name):
    axes = FIGURES[name]().axes
    labels = [text for one in axes for text in (one.get_xlabel(), one.get_ylabel()) if text]
    assert labels
    assert [text for text in labels if not text.endswith(" / µm")] == []
    for one in axes:
        if one.images:
            assert (one.get_xlabel(), one.get_ylabel()) == ("x / µm", "y / µm")
            certain = one.images[0].get_cmap().name == panels.CERTAINTY_COLOURS
            assert one.child_axes[0].get_ylabel().endswith("1 − p" if certain else " / µm")


@pytest.mark.parametrize("name", FIGURES)
def test_every_map_has_the_same_scale_bar_of_the_length_it_states(name):
    heights, differences = maps_of(FIGURES[name]())
    found = []
    for axes in (image.axes for image in heights + differences):
        (bar,) = (line for line in axes.lines if not line.get_clip_on())
        (label,) = (text.get_text() for text in axes.texts)
        assert label == f"{np.ptp(bar.get_xdata()):g} µm "
        found.append(label)
    assert set(found) == {"5 µm "}


def test_walls_and_spikes_do_not_govern_the_colours():
    """A print moved by two pixels, 0.1 µm too high, with spikes: the range shows the 0.1 µm, not the 11 µm of walls."""
    shifted = np.roll(TARGET.heights_um, 2, axis=1) + 0.1
    shifted[20, 20] += 30
    smooth = TARGET.with_heights(np.where(TARGET.heights_um > 0, 10.0, 0.0))
    block = smooth.with_heights(np.roll(smooth.heights_um, 2, axis=1) + 0.1)
    _, (difference,) = maps_of(plots.comparison(smooth, block))
    assert difference.get_clim()[1] == pytest.approx(0.1, rel=0.01)
    low, high = panels.height_limits(TARGET, TARGET.with_heights(shifted))
    assert 8.9 < low < 9.1
    assert 11 < high < 11.2


def test_a_raw_recording_keeps_its_substrate_in_the_range():
    low, high = panels.height_limits(TARGET.with_heights(TARGET.heights_um + 4))
    assert low == pytest.approx(4)
    assert high == pytest.approx(15, abs=0.1)


def lightness(rgb):
    """Return CIE L* of sRGB colours, shape (..., 3) to (...)."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    y = linear @ (0.2126, 0.7152, 0.0722)
    return np.where(y > 0.008856, 116 * np.cbrt(y) - 16, 903.3 * y)


PROTAN = np.array([[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]])
DEUTAN = np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]])
TRITAN = np.array([[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]])
"""Dichromats' view of linear RGB: Machado, Oliveira, Fernandes 2009."""


def seen(rgb, eye):
    """Return sRGB as seen by an eye, which acts on linear light."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    mixed = np.clip(linear @ eye.T, 0, 1)
    return np.where(mixed <= 0.0031308, 12.92 * mixed, 1.055 * mixed ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize("eye", [np.eye(3), PROTAN, DEUTAN, TRITAN], ids=["full", "protan", "deutan", "tritan"])
def test_colours_rise_in_lightness_and_can_be_told_apart(eye):
    levels = np.linspace(0, 1, 65)
    heights = lightness(seen(matplotlib.colormaps[panels.HEIGHT_COLOURS](levels)[:, :3], eye))
    assert np.all(np.diff(heights) > 0)
    assert np.diff(heights).max() < 2.2 * np.diff(heights).mean()
    colours = seen(matplotlib.colormaps[panels.DIFFERENCE_COLOURS](levels)[:, :3], eye)
    shades = lightness(colours)
    assert np.all(np.diff(shades[:33]) > 0)
    assert np.all(np.diff(shades[32:]) < 0)
    assert np.abs(colours[10] - colours[-11]).max() > 0.15  # the same distance above and below zero
    lines = seen(np.array([to_rgb(line["color"]) for line in panels.LINES]), eye)
    dashes = [str(line.get("ls", "-")) for line in panels.LINES]
    for one, other in combinations(range(len(lines)), 2):
        assert dashes[one] != dashes[other] or np.abs(lines[one] - lines[other]).max() > 0.15


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plots")
    write_height_map(folder / "target.tif", TARGET)
    printed = predict(TARGET, ParameterSet())
    noise = np.random.default_rng(0).normal(scale=0.01, size=TARGET.shape)
    write_height_map(folder / "print.tif", printed.with_heights(printed.heights_um + noise))
    return folder


VERBS = {
    "design": "design f --pitch-um 0.5 -o {out}.tif",
    "convert": "convert target.tif {out}.gsf",
    "align": "align print.tif target.tif -o {out}.tif",
    "predict": "predict target.tif -o {out}.tif",
    "score": "score target.tif print.tif",
    "calibrate": "calibrate --pair target.tif print.tif --free shrinkage_min --free shrinkage_max -o {out}.yaml",
    "precompensate": "precompensate target.tif -o {out}.tif",
    "export-stl": "export-stl target.tif -o {out}.stl",
}
REFUSING = VERBS | {"diagnose": "diagnose --pair target.tif print.tif -o {out}.yaml"}
"""What diagnose draws is looked at in its own tests: it takes longer."""


def call(line):
    return CliRunner().invoke(app, line.split())


@pytest.mark.slow
@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_draws_what_it_did(verb, folder, monkeypatch):
    monkeypatch.chdir(folder)
    done = call(VERBS[verb].format(out=f"{verb}-out") + f" --plot {verb}.png")
    assert done.exit_code == 0, done.output
    with Image.open(folder / f"{verb}.png") as image:
        pixels = np.asarray(image.convert("RGB"), dtype=int)
    bright = np.array([round(255 * value) for value in matplotlib.colormaps[panels.HEIGHT_COLOURS](1.0)[:3]])
    assert (np.abs(pixels - bright).max(axis=-1) < 12).sum() > 1000  # the highest parts, in the maps
    assert min(pixels.shape[:2]) > 500


@pytest.mark.parametrize("verb", REFUSING)
def test_a_picture_of_another_kind_is_refused_before_any_work(verb, folder, monkeypatch):
    monkeypatch.chdir(folder)
    done = call(REFUSING[verb].format(out=f"{verb}-never") + " --plot picture.jpg")
    assert done.exit_code == 1
    assert "error: picture.jpg: --plot: ends in .jpg, allowed .png .pdf .svg" in done.output
    assert list(folder.glob(f"{verb}-never*")) == []


@pytest.mark.slow
@pytest.mark.parametrize("ending, start", [("pdf", b"%PDF"), ("svg", b"<?xml")])
def test_vector_pictures(ending, start, folder, monkeypatch):
    monkeypatch.chdir(folder)
    assert call(f"predict target.tif -o {ending}.tif --plot {ending}-figure.{ending}").exit_code == 0
    assert (folder / f"{ending}-figure.{ending}").read_bytes().startswith(start)

"""The virtual press with its own physics off, and the program: two codes, two numerics, one chain."""

import numpy as np
import pytest

from dlwpredict import designs
from dlwpredict.heightmap import HeightMap
from dlwpredict.metrology.walls import near_walls
from dlwpredict.model.levels import Levels
from dlwpredict.model.voxels import Voxels
from dlwpredict.numerics.smoothing import block_mean
from dlwpredict.parameters import Paper, ParameterSet, Readings
from dlwpredict.process import predict
from tests.press import press_from, print_part

PAPERS = [
    Paper(0.7, 1.5, 0.5, 7.0, 7.0, 0.7, 1.0),
    Paper(0.8, 2.1, 0.44, 5.0, 6.0, 0.72, 0.95),
    Paper(0.6, 1.3, 0.56, 4.4, 8.0, 0.65, 0.9),
]


FINER = 3
"""Squares are printed on pixels so many times finer: the press takes its pixels for points."""


def pressed(target, paper):
    names = {"exposure_fwhm_xy_um": "focus_fwhm_xy_um", "exposure_fwhm_z_um": "focus_fwhm_z_um"}
    settings = {names.get(name, name): value for name, value in vars(paper).items()}
    return print_part(target.heights_um, target.dx_um, target.dy_um, press_from(settings))


@pytest.mark.parametrize("paper", PAPERS)
@pytest.mark.parametrize("kind", ["cin", "air", "posts"])
def test_press_prints_what_is_predicted(kind, paper, monkeypatch):
    """Smooth places agree to a nanometre or two; beside walls the pixel kernels of two codes may differ by more."""
    monkeypatch.setattr("tests.press.voxels.THIN", [(0, 0)])
    target = getattr(designs, kind)(size_um=32, pitch_um=0.25, margin_um=4)
    predicted = predict(target, ParameterSet(paper=paper), numerics=Levels(whole_pixels=True)).heights_um
    printed = pressed(target, paper)
    difference = (printed - predicted)[target.heights_um > 0]
    assert np.sqrt(np.median(difference**2)) < 0.002
    assert np.sqrt(np.mean(difference**2)) < 0.006


@pytest.mark.parametrize("paper", PAPERS)
@pytest.mark.parametrize("kind", ["cin", "stairs"])
def test_both_see_walls_alike(kind, paper):
    """What cross-linking makes of a wall shows over the part: 2 nm are some 8 nm of the wall's place."""
    target = getattr(designs, kind)(size_um=20, pitch_um=0.15, margin_um=3)
    predicted = predict(target, ParameterSet(paper=paper)).heights_um
    used = (target.heights_um > 0) & ~near_walls(target)
    assert np.sqrt(np.mean((pressed(target, paper) - predicted)[used] ** 2)) < 0.002


def test_press_prints_what_voxels_predict(monkeypatch):
    monkeypatch.setattr("tests.press.voxels.THIN", [(0, 0)])
    target = designs.air(size_um=16, pitch_um=0.25, margin_um=3)
    voxels = predict(target, ParameterSet(paper=PAPERS[1]), numerics=Voxels(0.02)).heights_um
    difference = (pressed(target, PAPERS[1]) - voxels)[target.heights_um > 0]
    rounding = 0.02 / np.sqrt(12)
    assert np.sqrt(np.mean(difference**2)) < rounding + 0.003


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cin", "air"])
def test_press_prints_squares_as_they_are_read(kind, monkeypatch):
    """Pixels of 0.4 µm beside a focus of 0.5 µm: read as points they err more than twice as much as as squares."""
    target, paper = getattr(designs, kind)(size_um=24, pitch_um=0.4, margin_um=4), Paper(0.5, 1.5, 0.45)
    monkeypatch.setattr("tests.press.voxels.THIN", [(0, 0)])
    squares = np.kron(target.heights_um, np.ones((FINER, FINER)))
    fine = HeightMap(squares, target.dx_um / FINER, target.dy_um / FINER)
    printed = block_mean(pressed(fine, paper), (FINER, FINER))
    used = (target.heights_um > 0) & ~near_walls(target)
    errors = []
    for reading in ("points", "squares"):
        process = ParameterSet(paper=paper, readings=Readings(pixels=reading))
        predicted = predict(target, process, numerics=Levels(whole_pixels=True)).heights_um
        errors.append(np.sqrt(np.mean((printed - predicted)[used] ** 2)))
    assert errors[1] < 0.5 * errors[0]

"""Spectra of what is left: the model's is the expectation of what is measured, and both are densities."""

from dataclasses import replace

import numpy as np
import pytest

from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.lines import Lines
from dlwpredict.noise.spectrum import spectra
from dlwpredict.noise.unevenness import Uneven

EVEN = Noise(0.005, 0.012, 0.8, 0.3, 0.4)
UNEVEN = Uneven(
    EVEN, jitter_um=0.01, rows=Lines(0.004, 0.006, 4.0, 0.005, 20.0, 4.5, 0.006), columns=Lines(0.003, tilt_um=0.004)
)
SHAPE = 40, 50


@pytest.fixture(scope="module")
def holes() -> np.ndarray:
    used = np.random.default_rng(0).random(SHAPE) > 0.1
    used[10:20, 10:25] = False
    return used


LEANING = Uneven(EVEN, rows=Lines(0.006, 0.006, 4.0, 0.006, 20.0, 4.5, lean=0.37))
ACROSS = Uneven(EVEN, columns=Lines(0.006, 0.006, 4.0, lean=-0.6))


@pytest.mark.parametrize("noise", [Uneven(EVEN), UNEVEN, LEANING, ACROSS], ids=["even", "uneven", "leaning", "across"])
def test_the_models_is_the_mean_over_draws(noise, holes):
    rng = np.random.default_rng(1)
    slope = rng.random(SHAPE)
    found = [spectra(draw * holes, holes, noise, slope) for draw in noise.simulate_many(SHAPE, rng, 60, slope)]
    for axis in (0, 1):
        drawn = np.array([pair[axis].measured_um3 for pair in found])
        error = (drawn.mean(axis=0) - found[0][axis].model_um3) / (drawn.std(axis=0) / np.sqrt(len(drawn)))
        assert np.abs(error).max() < 4
        assert np.sqrt(np.mean(error**2)) < 1.7


def test_the_integral_is_the_variance():
    used = np.ones((256, 256), dtype=bool)
    for one in spectra(np.zeros(used.shape), used, Uneven(Noise(0.003, 0.012, 0.9, 0.3, 0.3))):
        below = one.per_um[0] * one.model_um3[0]
        assert below + np.trapezoid(one.model_um3, one.per_um) == pytest.approx(0.003**2 + 0.012**2, rel=0.03)


def test_a_wave_stands_at_its_frequency_along_its_axis():
    x = 0.3 * np.arange(SHAPE[1])
    wave = np.broadcast_to(0.02 * np.sin(2 * np.pi * x / 1.5), SHAPE)
    along_x, along_y = spectra(wave, np.ones(SHAPE, dtype=bool), Uneven(EVEN))
    assert along_x.per_um[np.argmax(along_x.measured_um3)] == pytest.approx(1 / 1.5, rel=0.15)
    assert np.argmax(along_y.measured_um3) == 0


def test_axes_keep_their_pitch_and_lines_their_axis():
    used = np.ones((30, 30), dtype=bool)
    flat = np.zeros(used.shape)
    along_x, along_y = spectra(flat, used, UNEVEN)
    assert along_x.per_um[-1] < 1 / (2 * 0.3) and along_y.per_um[-1] < 1 / (2 * 0.4)
    assert along_x.per_um[-1] > along_y.per_um[-1]
    more = spectra(flat, used, replace(UNEVEN, rows=replace(UNEVEN.rows, hum_um=0.03)))
    hum = np.argmin(np.abs(along_y.per_um - 1 / (4.5 * 0.4)))
    assert more[1].model_um3[hum] > 3 * along_y.model_um3[hum]
    assert more[0].model_um3[-1] == pytest.approx(along_x.model_um3[-1], rel=0.05)

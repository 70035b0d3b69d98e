"""Another matrix library, another Fourier transform: the same heights."""

import os
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import scipy.fft

from dlwpredict.correction.precompensate import precompensate
from dlwpredict.effects import library
from dlwpredict.heightmap import HeightMap
from dlwpredict.model.levels import Levels
from dlwpredict.noise.covariance import Noise
from dlwpredict.numerics.smoothing import blur, blur_turned
from dlwpredict.parameters import Paper, ParameterSet
from dlwpredict.process import predict

ROOT = Path(__file__).parent.parent
TOLERANCE_UM = 5e-6
"""Exposure is computed in single precision; the differences measured are 5e-7 µm."""


def figures() -> np.ndarray:
    """Return a print and its correction: convolutions, splines, least squares."""
    rng = np.random.default_rng(0)
    target = HeightMap(np.pad(np.kron(rng.uniform(1, 4, (4, 5)), np.ones((6, 6))), 4), 0.25, 0.3)
    process = ParameterSet(paper=Paper(crosslink_fwhm_xy_um=4.0), effects=(library()["astigmatism"](0.1, 30.0),))

    def printed(written: HeightMap) -> HeightMap:
        return predict(written, process, numerics=Levels(1))

    found = precompensate(target, printed, most_predictions=4)
    return np.stack([printed(target).heights_um, found.corrected.heights_um])


def computed_by(core: str, folder: Path) -> tuple[np.ndarray, str]:
    """Return the figures under one kind of OpenBLAS kernels, and what that library says it uses."""
    code = (
        "import sys, numpy as np; from tests.test_properties_backends import figures; np.save(sys.argv[1], figures())"
    )
    path = folder / f"{core}.npy"
    settings = {**os.environ, "OPENBLAS_CORETYPE": core, "OPENBLAS_VERBOSE": "2", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)], cwd=ROOT, env=settings, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return np.load(path), done.stderr


@pytest.mark.slow
def test_other_matrix_kernels_give_the_same_heights(tmp_path):
    (first, one), (second, other) = (computed_by(core, tmp_path) for core in ("Nehalem", "Haswell"))
    if one == other:
        pytest.skip(f"this OpenBLAS does not let its kernels be chosen: {one[:200]!r}")
    np.testing.assert_allclose(second, first, rtol=0, atol=TOLERANCE_UM)


class ByMatrix:
    """Real Fourier transforms over one or two axes, as products with the matrices of their definition."""

    __ua_domain__ = "numpy.scipy.fft"

    @staticmethod
    def __ua_function__(method, args, kwargs):
        found = getattr(ByMatrix, method.__name__, None)
        return found(*args, **kwargs) if found else NotImplemented

    @staticmethod
    def rfftn(x, s=None, axes=None, **_):
        axes = np.atleast_1d(axes)
        for axis, size in zip(axes, np.atleast_1d(s if s is not None else np.take(x.shape, axes)), strict=True):
            x = times(waves(size, -1)[:, : x.shape[axis]], x, axis)
        return np.take(x, np.arange(size // 2 + 1), axis)

    @staticmethod
    def irfftn(x, s, axes, **_):
        *axes, last = np.atleast_1d(axes)
        *sizes, size = np.atleast_1d(s)
        for axis, count in zip(axes, sizes, strict=True):
            x = times(waves(count, +1) / count, x, axis)
        k = np.arange(size // 2 + 1)
        twice = np.where((k == 0) | (2 * k == size), 1, 2)  # X(−k) is X(k) conjugated
        return times(waves(size, +1)[:, : k.size] * twice / size, x, last).real

    @staticmethod
    def rfft2(x, s=None, axes=(-2, -1), **_):
        return ByMatrix.rfftn(x, s, axes)

    @staticmethod
    def irfft2(x, s, axes=(-2, -1), **_):
        return ByMatrix.irfftn(x, s, axes)


def waves(size, sign):
    n = np.arange(size)
    return np.exp(sign * 2j * np.pi * (np.outer(n, n) % size) / size)


def times(matrix, values, axis):
    return np.moveaxis(np.moveaxis(values, axis, -1) @ matrix.T, -1, axis)


@contextmanager
def by_matrix():
    with scipy.fft.set_backend(ByMatrix, only=True):
        yield


@pytest.mark.parametrize(
    "convolved",
    [
        lambda plane: blur(plane, 14.0, 3.0),
        lambda plane: blur_turned(plane, np.array([[9.0, 2.0], [2.0, 4.0]])),
        lambda plane: Noise(0.003, 0.02, 1.0, 0.5, 0.4).times(plane),
        lambda plane: blur_turned(plane[:, :-1], np.array([[3.0, 0.5], [0.5, 7.0]])),
    ],
)
def test_fourier_transforms_by_definition_give_the_same_convolution(convolved):
    plane = np.random.default_rng(1).normal(size=(150, 41))
    expected = convolved(plane)
    with by_matrix():
        np.testing.assert_allclose(convolved(plane), expected, rtol=0, atol=1e-11)


def test_fourier_transforms_by_definition_give_the_same_print():
    expected = figures()
    with by_matrix():
        np.testing.assert_allclose(figures(), expected, rtol=0, atol=TOLERANCE_UM)

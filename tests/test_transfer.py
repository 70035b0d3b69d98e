"""The transfer function of a CIN against the closed form of a Gaussian blur, and through `score`."""

import json

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift
from typer.testing import CliRunner

from dlwpredict.cli import app
from dlwpredict.designs import air, cin
from dlwpredict.errors import InputError, ResultError
from dlwpredict.files import write_height_map
from dlwpredict.metrology.transfer import transfer

FWHM_PER_SIGMA = 2 * np.sqrt(2 * np.log(2))


def of_gaussian(period, fwhm):
    """T = exp(-2π²σ²/λ²): what a Gaussian leaves of a wave."""
    return np.exp(-2 * (np.pi * fwhm / FWHM_PER_SIGMA / period) ** 2)


def at_half(fwhm):
    """The period at which that is a half: πF/(2 ln 2)."""
    return np.pi * fwhm / (2 * np.log(2))


def blurred(target, fwhm_x, fwhm_y):
    sigma = np.array([fwhm_y / target.dy_um, fwhm_x / target.dx_um]) / FWHM_PER_SIGMA
    return target.with_heights(gaussian_filter(target.heights_um, sigma))


@pytest.mark.parametrize(("pitch", "shortest"), [(0.25, 3.0), (0.4, 3.0), (0.1, 1.5)])
@pytest.mark.parametrize("fwhm", [1.5, 2.0, 3.0])
def test_a_gaussian_blur_is_found(pitch, shortest, fwhm):
    target = cin(pitch_um=pitch, margin_um=6, period_min_um=shortest)
    for one in transfer(target, blurred(target, fwhm, fwhm)).values():
        period, found = np.array(one.period_um), np.array(one.transfer)
        truth = of_gaussian(period, fwhm)
        assert found[truth > 0.3] == pytest.approx(truth[truth > 0.3], abs=0.03)
        assert np.all(np.diff(period) > 0)
        if at_half(fwhm) > period[0]:
            assert one.half_period_um == pytest.approx(at_half(fwhm), rel=0.02)
        else:
            assert one.half_period_um is None


def test_x_and_y_are_told_apart():
    target = cin(pitch_um=0.25, margin_um=6)
    found = transfer(target, blurred(target, 2.0, 3.0))
    assert found["x"].half_period_um == pytest.approx(at_half(2.0), rel=0.03)
    assert found["y"].half_period_um == pytest.approx(at_half(3.0), rel=0.03)


def test_gain_offset_tilt_and_a_shift_do_not_disturb():
    """A plain gain is the transfer at every period (a tilt across the sectors costs 1.3e-4); a shift loses nothing."""
    target = cin(pitch_um=0.25, margin_um=6)
    tilt = 0.01 * target.x_um + 0.02 * target.y_um[:, None]
    spoilt = target.with_heights(0.8 * target.heights_um - 3 + tilt)
    moved = target.with_heights(shift(target.heights_um, (0, 1), order=1))
    for one in transfer(target, spoilt).values():
        assert one.transfer == pytest.approx([0.8] * len(one.transfer), abs=1e-4)
        assert one.half_difference == pytest.approx([0] * len(one.transfer), abs=2e-4)
    assert transfer(target, moved)["x"].transfer == pytest.approx([1] * 8, abs=0.02)


def test_noise_and_gaps_are_borne():
    target = cin(pitch_um=0.25, margin_um=6)
    heights = np.array(blurred(target, 2.0, 2.0).heights_um)
    generator = np.random.default_rng(3)
    heights += generator.normal(0, 0.05, heights.shape)
    heights[generator.random(heights.shape) < 0.3] = np.nan
    for one in transfer(target, target.with_heights(heights)).values():
        assert one.half_period_um == pytest.approx(at_half(2.0), rel=0.04)


def test_what_is_no_chirp_is_refused():
    for target in (air(pitch_um=0.5), cin(pitch_um=0.4, period_min_um=14.0, height_um=1e-9)):
        with pytest.raises(InputError, match="allowed: a cin target"):
            transfer(target, target)
    target = cin(pitch_um=0.4)
    empty = np.full(target.shape, np.nan)
    empty[0] = 1
    with pytest.raises(ResultError, match="too few measured points along x"):
        transfer(target, target.with_heights(empty))


def test_score_prints_and_draws_it(tmp_path):
    target = cin(pitch_um=0.4, margin_um=6)
    paths = [tmp_path / "cin.tif", tmp_path / "print.tif"]
    for path, one in zip(paths, (target, blurred(target, 2.0, 2.0)), strict=True):
        write_height_map(path, one)
    outputs = ["--json", tmp_path / "score.json", "--transfer-plot", tmp_path / "t.svg"]
    result = CliRunner().invoke(app, ["score", *map(str, [*paths, "--transfer", *outputs])])
    assert result.exit_code == 0, result.output
    found = json.loads((tmp_path / "score.json").read_text())["transfer"]
    assert found["y"]["half_period_um"] == pytest.approx(at_half(2.0), rel=0.02)
    assert f"50 % along x: {found['x']['half_period_um']:.3f} µm" in result.stdout
    assert f"  along y  {found['y']['period_um'][0]:8.3f}  {found['y']['transfer'][0]:.3f}" in result.stdout
    assert (tmp_path / "t.svg").read_text().rstrip().endswith("</svg>")
    sharp = CliRunner().invoke(app, ["score", str(paths[0]), str(paths[0]), "--transfer"])
    assert "50 % along x: below" in sharp.stdout
    refused = CliRunner().invoke(
        app, ["score", str(paths[0]), str(paths[1]), "--transfer-plot", str(tmp_path / "t.gif")]
    )
    assert (refused.exit_code, refused.stderr.count("\n")) == (1, 1)

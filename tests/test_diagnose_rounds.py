"""Rounds of a search: the noise is estimated beside other effects, not beside one more switch of the same."""

import numpy as np
import pytest

from dlwpredict import designs
from dlwpredict.diagnosis import run
from dlwpredict.diagnosis.library import signatures
from dlwpredict.diagnosis.library.candidates import candidates
from dlwpredict.effects import library
from dlwpredict.infer.recording import prepare
from dlwpredict.noise.covariance import Noise
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import predict

NOISE = Noise(0.004, 0.0, 1.0, 0.5, 0.5)
FEW = {"instrument-blur", "slope-error", "vignetting"}


@pytest.mark.slow
@pytest.mark.long
def test_one_more_switch_of_an_effect_leaves_the_noise_as_it_is(monkeypatch):
    """Heights lost on slopes along x and, a third as much, along y: two switches of one effect."""
    noises, estimated = run.noises, []
    monkeypatch.setattr(run, "noises", lambda *of, **how: estimated.append(1) or noises(*of, **how))
    monkeypatch.setattr(signatures, "candidates", lambda *of: [one for one in candidates(*of) if one.name in FEW])
    wrong = ParameterSet(effects=(library()["slope-error"](bias_abs_x_um=0.15, bias_abs_y_um=0.05),))
    target = designs.air(size_um=24, pitch_um=0.5, margin_um=4, seed=3)
    seen = predict(target, wrong, as_measured=True).heights_um + NOISE.simulate(target.shape, np.random.default_rng(1))
    found = run.diagnose([prepare(target, target.with_heights(seen))], ParameterSet())
    (one,) = found.named
    assert one.names == ["slope-error"]
    switches = {name.partition(".")[2] for name in found.extended.fit.free.names if name.startswith("slope-error")}
    assert switches == {"bias_abs_x_um", "bias_abs_y_um"}
    assert len(estimated) == 2  # beside what might be there, and beside a slope error

"""The machinery of the spike-ins: noise in the microscope's words, and what counts as said beyond the control."""

import json

import numpy as np
import pytest

from dlwpredict import designs
from dlwpredict.effects import library
from dlwpredict.files import write_height_map
from dlwpredict.files.parameters_yaml import parameters_as_dict
from dlwpredict.parameters import Paper, ParameterSet
from dlwpredict.process import predict
from tests.prove import spiked
from tests.prove.linear import noise_model
from tests.prove.sealed import Folder

GRID = type("Grid", (), {"dx_um": 0.3, "dy_um": 0.3})


@pytest.mark.parametrize("smoothness", [0.5, 1.5, np.inf])
def test_noise_found_is_the_noise_added(smoothness):
    told = {"white_um": 0.003, "jitter_um": 0.004, "correlated_um": 0.012, "row_um": 0.003, "column_um": 0.004,
            "length_um": 1.1, "smoothness": smoothness}  # fmt: skip
    noise = noise_model(spiked.noise_of(told), GRID)
    assert (noise.white_um, noise.correlated_um) == (pytest.approx(0.005), pytest.approx(0.013))
    assert (noise.length_um, noise.smoothness) == (pytest.approx(1.1), smoothness)


def finding(*names, side="print", probability=0.99, **parameters):
    return {"effects": list(names), "side": side, "probability": probability, "parameters": parameters}


def told(*findings, verdict="identified", rms_um=0.01, **model):
    """Return an answer; what its model holds of vignetting beside its findings by value and interval."""
    own = {f"vignetting.{name}": size for name, size in model.items()}
    rest = {
        "remainder": {"rms_um": rms_um, "significant": verdict == "unexplained"},
        "extended": {"parameters": own | {"threshold": {"value": 0.4}}},
    }
    return {"verdict": verdict, "findings": list(findings), **rest}


TRUTH = {"name": "vignetting", "switch": "strength", "value": 0.2, "off": 0.0, "left_um": 0.008,
         "entry": {"name": "vignetting", "strength": 0.2}, "times": 3.0}  # fmt: skip
OWN = finding("slope-error", side="measurement")


def size(value, low, high):
    return {"strength": {"value": value, "low": low, "high": high}}


def strength(*of):
    return {"vignetting": size(*of)}


@pytest.mark.parametrize(
    ("control", "after", "expected"),
    [
        (told(OWN), told(), {"heard": False, "held": False}),
        (told(OWN), told(verdict="none"), {"heard": False}),
        (told(OWN), told(finding("vignetting", "curl", **strength(0.19, 0.1, 0.3)), **size(0.19, 0.1, 0.3)),
         {"heard": True, "held": True, "covered": True, "alone": False, "wrong_side": False}),
        (told(OWN), told(finding("curl", "vignetting", **strength(0.19, 0.1, 0.3))), {"held": True, "covered": True}),
        (told(OWN), told(finding("vignetting", **strength(0.3, 0.25, 0.35))), {"alone": True, "covered": False}),
        (told(OWN), told(finding("field-curvature", side="measurement")),
         {"heard": True, "held": False, "alike": True, "wrong_side": True, "misnamed": True}),
        (told(OWN), told(finding("field-curvature", side="measurement", probability=0.89), verdict="unexplained"),
         {"heard": True, "held": False, "wrong_side": False, "misnamed": False}),
        (told(OWN), told(OWN, finding("vignetting", **strength(0.19, 0.1, 0.3))),
         {"heard": True, "held": True, "covered": True, "wrong_side": False}),
        (told(OWN), told(OWN), {"heard": False, "held": False, "covered": None, "wrong_side": False}),
        (told(finding("curl", "slope-error")), told(OWN), {"heard": False}),
        (told(OWN), told(finding("curl", "slope-error")), {"heard": True}),
        (told(OWN), told(rms_um=0.014), {"heard": True, "held": False, "misnamed": False}),
        (told(OWN), told(verdict="unexplained"), {"heard": True}),
        (told(OWN, verdict="unexplained"), told(verdict="unexplained"), {"heard": False}),
    ],
)  # fmt: skip
def test_what_is_said_beyond_the_untouched_recording(tmp_path, monkeypatch, control, after, expected):
    monkeypatch.setattr(spiked, "own_of", lambda place, truth: 0.0)
    place = Folder(tmp_path)
    for name, content in (("again", control), ("case", after)):
        place.answer(name).parent.mkdir(exist_ok=True)
        place.answer(name).write_text(json.dumps({"status": 0, "seconds": 1.0, "diagnosis": content}))
    place.truth("case").parent.mkdir()
    place.truth("case").write_text(json.dumps(TRUTH))
    result = spiked.judged(tmp_path, "case", "again")
    assert {key: result[key] for key in expected} == expected


def test_the_table_counts_by_strength():
    base = {"verdict": "identified", "heard": True, "held": True, "alike": True, "wrong_side": False, "covered": None,
            "misnamed": False}  # fmt: skip
    results = [
        {"name": "a", "truth": TRUTH, **base},
        {"name": "b", "truth": TRUTH | {"times": 1.0}, **base, "heard": False},
        {"name": "c", "truth": TRUTH | {"name": "particle"}, **base, "misnamed": True},
    ]
    counts = {row.what: (sum(row.hits), len(row.hits)) for row in spiked.rows(results, [{"name": "d", "more": False}])}
    assert counts["from twice the limit on: heard"] == (1, 1)
    assert counts["weaker ones: heard"] == (0, 1)
    assert counts["... given a name with confidence"] == (1, 1)


def test_what_a_control_holds_without_a_name_counts_as_noise():
    assert [spiked.nameless_um(told(verdict=verdict)) for verdict in ("unexplained", "identified")] == [0.01, 0.0]


def test_what_is_added_is_printed_by_the_process_that_is_known(tmp_path):
    """A focus astigmatic already and wide cross-linking: the same change as the press makes beside both."""
    part = designs.air(size_um=12, pitch_um=0.3, margin_um=2, seed=2)
    known = ParameterSet(paper=Paper(crosslink_fwhm_xy_um=4.0), effects=(library()["astigmatism"](log_ratio=0.3),))
    place, noise = Folder(tmp_path), {"white_um": 0.003, "jitter_um": 0, "correlated_um": 0.01, "row_um": 0,
                                      "column_um": 0, "length_um": 1.0, "smoothness": 1.5}  # fmt: skip
    place.data("control").mkdir(parents=True)
    for what in ("target", "recording"):
        write_height_map(place.data("control") / f"{what}_0.tif", part)
    place.answer("control").parent.mkdir()
    answer = {"diagnosis": told(verdict="none") | {"noise": [noise]}, "extended": parameters_as_dict(known)}
    place.answer("control").write_text(json.dumps(answer, default=float))
    real = spiked.Real.of(place, "control")
    assert real.knows("astigmatism") and not real.knows("line-end-pileup")
    assert "astigmatism.log_ratio" in real.sight.fit.free.names
    process = {name.replace("exposure_", "focus_"): value for name, value in vars(known.paper).items()}
    entry, focus = {"name": "line-end-pileup", "gain": 0.1}, {"name": "astigmatism", "log_ratio": 0.3}
    with_it, without = (spiked.shown(real.part, process, effects) for effects in ([focus, entry], [focus]))
    np.testing.assert_allclose(real.change(entry), np.nan_to_num(with_it - without), atol=1e-12)


@pytest.mark.parametrize(
    ("own", "low", "high", "added", "whole"),
    [
        (0.0, 0.1, 0.25, True, True),
        (0.1, 0.1, 0.25, True, False),
        (0.05, 0.22, 0.3, False, True),
        (0.2, 0.25, 0.3, False, True),
    ],
)
def test_a_strength_is_added_to_what_was_there(own, low, high, added, whole):
    """What both make is inside the range that the program has: vignetting of 0.3 at most."""
    found = {"value": (low + high) / 2, "low": low, "high": high}
    result = spiked.sized(found, TRUTH, own)
    assert (result["covered"], result["covered_whole"]) == (added, whole)


def test_what_was_there_is_fitted_beside_what_is_known(tmp_path):
    """An untouched print with vignetting of its own, of which the control has named nothing."""
    part = designs.air(size_um=12, pitch_um=0.4, margin_um=2, seed=2)
    own = ParameterSet(effects=(library()["vignetting"](strength=0.15),))
    place = Folder(tmp_path)
    place.data("control").mkdir(parents=True)
    write_height_map(place.data("control") / "target_0.tif", part)
    write_height_map(place.data("control") / "recording_0.tif", predict(part, own))
    place.answer("control").parent.mkdir()
    place.answer("control").write_text(json.dumps({"extended": parameters_as_dict(ParameterSet())}))
    assert spiked.own_of(place, TRUTH | {"control": "control"}) == pytest.approx(0.15, abs=0.03)

"""What was said beside what was concealed: one case, after its seal has been opened."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from itertools import permutations
from pathlib import Path

import numpy as np

from dlwpredict.files import read_height_map
from dlwpredict.files.atomic import write_text
from dlwpredict.files.parameters_yaml import parameters_from
from dlwpredict.files.provenance import sha256
from dlwpredict.metrology.regrid import resampled
from dlwpredict.parameters import Paper, ParameterSet, Readings, declarations
from tests.bench.cases import NEVER, SIDES, alike, in_terms_of
from tests.prove.baselines import Bench, unseen_smooth_um, unseen_um
from tests.prove.hidden import LIBRARY_FORM, LOCAL, OUTSIDE
from tests.prove.linear import coarser, parameters_of
from tests.prove.place import points_at
from tests.prove.sealed import Folder, read
from tests.prove.structures import COARSE_UM, HELD_OUT_UM

NEAR_THE_NOISE = 1.5
"""An effect below this multiple of its detection limit is near the noise."""

_FILES = "judge.py", "place.py", "baselines.py", "linear.py"
JUDGE = hashlib.sha256(b"".join((Path(__file__).parent / name).read_bytes() for name in _FILES)).hexdigest()
"""State of the judge: results of another one are made anew."""

IN_THE_FIELD = {
    "field-curvature": ("coma_x_um", "coma_y_um", "centre_x_um", "centre_y_um"),
    "slope-error": ("signed_x_um", "signed_y_um", "bias_abs_x_um", "bias_abs_y_um"),
    "misregistration": ("shift_x_um", "shift_y_um", "rotation_deg", "scale_x", "scale_y", "shear_mrad"),
}
"""Parameters of the microscope's effects that have an axis or a place in its field."""

CONCEALMENTS = (
    "name hidden",
    "absorbed by calibration",
    "hidden behind another effect",
    "removed by levelling or registration",
    "near the noise",
)


def opened(folder: Path, name: str, seal: Mapping) -> dict:
    """Return the truth of a case if it is what was sealed.

    Raises
    ------
    ValueError
        The truth or a map is not what was sealed.
    """
    place = Folder(folder)
    found = {"truth": sha256(place.truth(name))}
    found["maps"] = {file.name: sha256(file) for file in sorted(place.data(name).glob("*.tif"))}
    for key, value in found.items():
        if value != seal[key]:
            raise ValueError(f"{name}: {key}: not what was sealed")
    return json.loads(place.truth(name).read_text())


def judged(folder: Path, name: str, seal: Mapping, beside: bool) -> dict:
    """Return the result of a case, made unless it is on file for this answer; with `beside`, the baselines too."""
    place = Folder(folder)
    answer, kept = json.loads(place.answer(name).read_text()), place.result(name)
    if kept.exists():
        result = json.loads(kept.read_text())
        if (result["code"], result["judge"]) == (answer["code"], JUDGE) and (not beside or result["baselines"]):
            return result
    truth = opened(folder, name, seal)
    result = {
        "name": name, "sealed": seal["truth"], "code": answer["code"], "judge": JUDGE, "seconds": answer["seconds"],
        "cpu_s": answer["cpu_s"], "align_cpu_s": answer["align_cpu_s"],
        "truth": truth, "concealed": concealments(truth), **said(answer), "baselines": {},
    }  # fmt: skip
    if answer["status"] == 0:
        result |= scored(truth, answer["diagnosis"])
        result["unseen_um"] = unseen(place, name, truth, answer)
        if beside:
            result["baselines"] = baselines(place, name, truth, answer)
    kept.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(result, indent=1, default=float)
    write_text(kept, text + "\n")
    return json.loads(text)


def concealments(truth: Mapping) -> list[str]:
    """Return how an effect of the library is concealed in a case, by what becomes of its change of the recordings."""
    effects = [e for e in truth["effects"] if e["name"] not in OUTSIDE]
    if not effects:
        return []
    found = []
    if truth["kind"] == "absorbed" or any(e["calibration"] > 0.5 for e in effects):
        found.append("absorbed by calibration")
    if len(effects) > 1:
        found.append("hidden behind another effect")
    if any(e["levelling"] > 0.5 for e in effects):
        found.append("removed by levelling or registration")
    if min(e["times"] for e in effects) < NEAR_THE_NOISE:
        found.append("near the noise")
    return found or ["name hidden"]


def said(answer: Mapping) -> dict:
    """Return the answer in short."""
    if answer["status"] != 0:
        return {"verdict": "failed", "complaint": answer["complaint"], "findings": []}
    told = answer["diagnosis"]
    keys = ("effects", "side", "parameters", "p_value", "gain")
    return {
        "verdict": told["verdict"],
        "findings": [{key: finding.get(key) for key in keys} for finding in told["findings"]],
        "locations": told["locations"][:3],
        "remainder": told["remainder"],
        "not_testable": told["not_testable"],
        "noise_um": told["noise_um"],
        "work": told.get("work", {}),
        "rmse_um": {model: told[model]["rmse_um"] for model in ("baseline", "extended")},
    }


def scored(truth: Mapping, told: Mapping) -> dict:
    """Return what of an answer is right."""
    effects, findings = truth["effects"], told["findings"]
    first = findings[0] if findings else None
    names = [e["name"] for e in effects if e["name"] not in (*OUTSIDE, *NEVER)]
    held = [any(name in f["effects"] for f in findings) for name in names]
    confident = told["verdict"] in ("identified", "ambiguous")
    sides = {SIDES[name] for name in names}
    return {
        "detected": told["verdict"] != "none",
        "held": held,
        "exact": [any(f["effects"] == [name] for f in findings) for name in names],
        "apart": any(
            all(name in f["effects"] for name, f in zip(names, chosen, strict=True))
            for chosen in permutations(findings, len(names))
        ),
        "first_held": bool(first) and any(name in first["effects"] for name in names),
        "first_alike": bool(first) and any(alike(name, first["effects"][0]) for name in names),
        "first_single": bool(first) and len(first["effects"]) == 1,
        "spurious": sum(not any(name in f["effects"] for name in names) for f in findings),
        "misnamed": confident and not any(name in first["effects"] for name in names),
        "wrong_side": bool(first) and confident and first["side"] != "undecided" and first["side"] not in sides,
        "intervals": [one for e in effects for one in _intervals(e, findings, turned=bool(truth.get("raw")))],
        "seven": _seven(truth["process"], told),
        "place": _place(effects, told["locations"], truth.get("sides_um", ())),
        "noise_true_um": float(np.hypot(truth["noise"]["sigma_um"], truth["noise"]["white_um"])),
    }


def _intervals(effect: Mapping, findings: list, *, turned: bool) -> list[dict]:
    """Return the intervals of an effect's parameters, where it was named.

    Of a raw recording, what has an axis or a place in the microscope's field is left out: the truth counts from the
    microscope's axes and middle, the program from the target's, and each recording lies in another way.
    """
    found, apart = [], IN_THE_FIELD.get(effect["name"], ()) if turned else ()
    for finding in findings:
        for key, interval in in_terms_of(effect["entry"], finding["parameters"].get(effect["name"]) or {}).items():
            if key in effect["entry"] and key not in apart:
                true = effect["entry"][key]
                found.append({
                    "parameter": f"{effect['name']}.{key}", "switch": key == effect["switch"],
                    "model": _form(effect["entry"]), "alone": len(finding["effects"]) == 1,
                    "times": effect["times"], "true": true, "off": effect["off"] if key == effect["switch"] else 0.0,
                    **{end: interval[end] for end in ("value", "low", "high")},
                    "covered": interval["low"] <= true <= interval["high"],
                })  # fmt: skip
    return found


def _form(entry: Mapping) -> str:
    """Return the press's model, `library` where it is the library's own formula."""
    model = entry.get("model", "literal")
    return "library" if model == LIBRARY_FORM.get(entry["name"], "literal") else model


def _seven(process: Mapping, told: Mapping) -> dict:
    """Return the errors of the seven parameters without and with the effects found, in shares of their ranges."""
    true, ranges = parameters_of(process).paper, {n: d.high - d.low for n, (_, d) in declarations(Paper).items()}
    return {
        model: {
            name: (told[model]["parameters"][name]["value"] - getattr(true, name)) / ranges[name]
            for name in ranges
            if name in told[model]["parameters"]
        }
        for model in ("baseline", "extended")
    }


def _place(effects: list, locations: list, sides_um: Sequence[Sequence[float]]) -> bool | None:
    """Tell whether the first place named is that of a local effect; None where there is none of these."""
    local = [e["entry"] for e in effects if e["name"] in LOCAL]
    if not local or not locations:
        return False if local else None
    return points_at(local[0], locations, float(np.sqrt(np.prod(sides_um[locations[0]["pair"]]))))


def unseen(place: Folder, name: str, truth: Mapping, answer: Mapping) -> dict:
    """Return the errors on the structure that was kept from the program, without and with the effects found, µm."""
    target, clean = read(place.kept(name, "target")), read(place.kept(name, "clean"))
    models = {"seven": _baseline(answer["diagnosis"]), "diagnose": parameters_from(answer["extended"])}
    noise = _noise(truth, HELD_OUT_UM)
    return {key: unseen_um(model, target, clean, noise) for key, model in models.items()}


def _noise(truth: Mapping, pitch_um: float) -> dict:
    """Return the true noise on pixels that are means over squares of another side."""
    own = (truth.get("raw") or {}).get("pitch_um", truth["pitch_um"])
    return coarser(truth["noise"], own, pitch_um)


def _baseline(told: Mapping) -> ParameterSet:
    paper = Paper(**{k: v["value"] for k, v in told["baseline"]["parameters"].items()})
    return ParameterSet(paper=paper, readings=Readings(pixels=told["baseline"].get("pixels", "points")))


def baselines(place: Folder, name: str, truth: Mapping, answer: Mapping) -> dict:
    """Return what else one could do with the same recordings, on coarser pixels."""
    places = [(place.data(name) / f"target_{k}.tif", place.recording(name, k)) for k in range(len(truth["structures"]))]
    pairs = [(resampled(read(part), COARSE_UM), resampled(read_height_map(laid), COARSE_UM)) for part, laid in places]
    target, clean, noise = read(place.kept(name, "target")), read(place.kept(name, "clean")), _noise(truth, HELD_OUT_UM)
    bench = Bench.of(pairs, _baseline(answer["diagnosis"]), _noise(truth, COARSE_UM))

    def of(fitted, **more) -> dict:
        error = unseen_um(fitted.parameters, target, clean, noise)
        return {"rmse_um": fitted.rmse_um(), "unseen_um": error, **more}

    weights, rmse_um = bench.smooth()
    names, stepwise = bench.stepwise()
    found = {
        "seven": of(bench.seven),
        "smooth": {"rmse_um": rmse_um, "unseen_um": unseen_smooth_um(weights, bench.seven, target, clean, noise)},
        "stepwise": of(stepwise, names=names),
    }
    entries = [e["entry"] for e in truth["effects"]]
    if not any(entry["name"] in OUTSIDE for entry in entries):
        found["oracle"] = of(bench.oracle(entries)) if entries else found["seven"]
    return found

"""Prove the diagnosis on real recordings: known effects added to them, sealed, asked, judged.

python -m tests.prove.spiked RUN_DIR REAL_DIR --cases 24       what `make prove-real` does

To a real recording that `align` has laid on its design is added what the virtual press prints with an effect less what
it prints without. The same recording untouched is the control, diagnosed first. What that names is given to the
diagnosis of the changed recording, as somebody would who knows what his printer and microscope lack (`-p`), and to
that of the untouched one again: counted is what is named of the changed one and not of the untouched one. A field is
brought to pixels of 0.3 µm first; the press has the seven parameters and the effects that the control came to, so that
what is added is what that process would have made of it. Everything is kept in RUN_DIR, so that an interrupted run goes
on.
"""

from __future__ import annotations

import argparse
import json
import math
import platform
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from datetime import date
from itertools import islice
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import yaml

from dlwpredict import __version__
from dlwpredict.effects import library
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.atomic import write_text
from dlwpredict.files.parameters_yaml import parameters_from, read_parameters
from dlwpredict.files.provenance import sha256
from dlwpredict.heightmap import HeightMap
from dlwpredict.metrology.regrid import resampled
from dlwpredict.parameters import declarations
from tests.bench.cases import SIDES, alike, by_machine, in_terms_of, seen
from tests.press import microscope_from, press_from
from tests.prove.answer import answered, ask, code_sha256, command_of, ran
from tests.prove.hidden import NAMED, OUTSIDE, Hidden, entry_of, named, outside
from tests.prove.linear import SMOOTHNESS, Sight
from tests.prove.mix import STRONGEST, name_of
from tests.prove.sealed import Folder, strength
from tests.prove.table import Row, counted, wilson

SEED, WEAKEST = 149671, 0.5
SURE = 0.9
"""Probability from which on a finding counts as said: by less than that a diagnosis tells its reader to doubt it."""

PITCH_UM = 0.3
START = Path("configs/real.yaml")
TRIES = 12
"""Effects drawn for a case, until one can reach its strength on this field."""

OUTSIDERS = ("particle", "vibration-ripple", "scratch", "line-jitter", "scan-wobble")
EVERY_OUTSIDE = 6
"""Every so manieth case has physics that the library does not have."""


@dataclass(frozen=True, eq=False)
class Real:
    """A real field beside what its own diagnosis came to: what a change is counted from.

    Parameters
    ----------
    part, recording : HeightMap
    process, noise : dict
        In the press's words.
    effects : list of dict
        What is known to be there, in the press's words.
    sight : Sight
    plain : numpy.ndarray, shape (rows, cols)
        The press's print of it.
    """

    part: HeightMap
    recording: HeightMap
    process: dict
    noise: dict
    effects: list[dict]
    sight: Sight
    plain: np.ndarray

    @classmethod
    def of(cls, place: Folder, control: str) -> Real:
        """Take up a control that was answered."""
        part, recording = (read_height_map(place.data(control) / f"{what}_0.tif") for what in ("target", "recording"))
        answer = json.loads(place.answer(control).read_text())
        told, known = answer["diagnosis"], parameters_from(answer["extended"])
        process = {name.replace("exposure_", "focus_"): value for name, value in asdict(known.paper).items()}
        noise = noise_of(told["noise"][0])
        noise["sigma_um"] = math.hypot(noise["sigma_um"], nameless_um(told))
        sight = Sight.of([part], process, noise, effects=known.effects)
        effects = [entry_of(effect) for effect in known.effects]
        return cls(part, recording, process, noise, effects, sight, shown(part, process, effects))

    def change(self, entry: Mapping) -> np.ndarray:
        """Return what an effect changes in the recording, µm, shape (rows, cols)."""
        return np.nan_to_num(shown(self.part, self.process, [*self.effects, entry]) - self.plain)

    def knows(self, name: str) -> bool:
        """Tell whether an effect is known to be there: more of it would be its strength, no other effect."""
        return any(effect["name"] == name for effect in self.effects)

    def shares(self, entry: Mapping) -> dict[str, float]:
        """Return what becomes of that change, beside all that a fit may move."""
        return self.sight.shares([self.change(entry)])


def noise_of(told: Mapping) -> dict:
    """Return the noise that a diagnosis found, in the microscope's words: white with grain and jitter, and the rest."""
    kind = next(k for k, (nu, _) in SMOOTHNESS.items() if nu == min((0.5, 1.5, np.inf), key=_near(told["smoothness"])))
    white = math.hypot(told["white_um"], told["jitter_um"])
    correlated = math.hypot(told["correlated_um"], told["row_um"], told["column_um"])
    return {
        "kind": kind,
        "white_um": white,
        "sigma_um": correlated,
        "correlation_um": told["length_um"] / SMOOTHNESS[kind][1],
    }


def nameless_um(told: Mapping) -> float:
    """Return what a diagnosis leaves without a name, µm: a change that is no larger is not known to be there."""
    return float(told["remainder"]["rms_um"]) if told["remainder"]["significant"] else 0.0


def said(findings: Sequence[Mapping]) -> list[Mapping]:
    """Return the findings that a diagnosis says for nearly certain."""
    return [finding for finding in findings if finding["probability"] >= SURE]


def _near(smoothness: float):
    return lambda nu: abs(1 / nu - 1 / float(smoothness))


def shown(part: HeightMap, process: Mapping, effects: Sequence[Mapping]) -> np.ndarray:
    """Return what an instrument shows of a print of the press but for noise, on the part's grid."""
    own, artefacts = by_machine(effects)
    grid = {"pitch_um": [part.dx_um, part.dy_um], "pixels": list(part.shape[::-1])}
    press = press_from({**process, "effects": list(own)})
    return seen(part, press, microscope_from({**grid, "effects": list(artefacts)}), finer=2).heights_um


def control_of(folder: Path, real: Path, field: str) -> str:
    """Lay out an untouched field as a case; return its name."""
    place, name = Folder(folder), name_of(SEED, f"control {field}", 0)
    data = place.data(name)
    if not (data / "words.json").exists():
        data.mkdir(parents=True, exist_ok=True)
        for what, source in (("target", "target"), ("recording", "aligned")):
            write_height_map(
                data / f"{what}_0.tif", resampled(read_height_map(real / field / f"{source}.tif"), PITCH_UM)
            )
        write_text(data / "words.json", json.dumps(["-p", str(START.resolve())]))
    return name


def again_of(folder: Path, field: str, control: str) -> str:
    """Lay out an untouched field once more, to be asked beside what is known of it; return the case's name."""
    place, name = Folder(folder), name_of(SEED, f"control {field}", 1)
    if not (data := place.data(name)).exists():
        maps = [read_height_map(place.data(control) / f"{what}_0.tif") for what in ("target", "recording")]
        lay_out(place, data, *maps, control)
    return name


def lay_out(place: Folder, data: Path, part: HeightMap, recording: HeightMap, control: str) -> None:
    """Write what is asked, beside what the diagnosis of the control has found."""
    data.mkdir(parents=True, exist_ok=True)
    write_height_map(data / "target_0.tif", part)
    write_height_map(data / "recording_0.tif", recording)
    known = json.loads(place.answer(control).read_text())["extended"]
    write_text(data / "known.yaml", yaml.safe_dump(known, sort_keys=False))
    write_text(data / "words.json", json.dumps(["-p", "known.yaml", "--seed", "1"]))


def drawn(index: int, rng: np.random.Generator) -> Hidden:
    """Draw what is added: the effects in turn, now and then physics that the library has not."""
    if index % EVERY_OUTSIDE == EVERY_OUTSIDE - 1:
        return outside(str(rng.choice(OUTSIDERS)), rng)
    return named(str(rng.choice(NAMED)), rng)


def spike(folder: Path, field: str, control: str, index: int) -> str:
    """Make a case unless it is there; return its name."""
    place, name = Folder(folder), name_of(SEED, "spike", index)
    if place.truth(name).exists():
        return name
    rng, real = np.random.default_rng([SEED, index]), Real.of(place, control)
    times = float(np.exp(rng.uniform(np.log(WEAKEST), np.log(STRONGEST))))
    unknown = (hidden for hidden in iter(lambda: drawn(index, rng), None) if not real.knows(hidden.name))
    for hidden in islice(unknown, TRIES):
        truth = strength(hidden, times, real)
        if truth["times"] >= WEAKEST:
            break
    changed = real.recording.with_heights(real.recording.heights_um + real.change(truth["entry"]))
    lay_out(place, place.data(name), real.part, changed, control)
    place.truth(name).parent.mkdir(parents=True, exist_ok=True)
    write_text(place.truth(name), json.dumps({"field": field, "control": control, **truth}, indent=1, default=float))
    return name


def found_of(told: Mapping, effect: Mapping) -> dict | None:
    """Return value and interval of an effect's strength where it is in the model or stands in a class, else None."""
    model = told["extended"]["parameters"]
    own = {name.partition(".")[2]: size for name, size in model.items() if name.startswith(f"{effect['name']}.")}
    for sizes in (own, *(finding["parameters"].get(effect["name"]) or {} for finding in told["findings"])):
        known = in_terms_of(effect["entry"], sizes)
        if effect["switch"] in known:
            return known[effect["switch"]]
    return None


def own_of(place: Folder, truth: Mapping) -> float:
    """Return the strength of an effect in the untouched recording, as `calibrate` fits it beside what is known.

    What was added comes on top of it: a real print may have something of the effect, or something like it.

    Raises
    ------
    RuntimeError
        The fit failed.
    """
    known = json.loads(place.answer(truth["control"]).read_text())["extended"]
    entry = {key: value for key, value in truth["entry"].items() if key != "model"}
    with tempfile.TemporaryDirectory() as folder:
        start, end = Path(folder, "start.yaml"), Path(folder, "end.yaml")
        start.write_text(yaml.safe_dump(known | {"effects": [*known["effects"], entry]}, sort_keys=False))
        words = ["calibrate", "--pair", "target_0.tif", "recording_0.tif", "-p", str(start), "-o", str(end), "--quiet"]
        status, complaint, _ = ran(command_of(words), place.data(truth["control"]))
        if status:
            raise RuntimeError(f"{truth['control']}: {truth['name']}: {complaint}")
        fitted = read_parameters(end)
    return next(getattr(effect, truth["switch"]) for effect in fitted.effects if effect.name == truth["name"])


def besides(told: Mapping, untouched: Mapping) -> list[Mapping]:
    """Return the findings whose likeliest name stands in no class of the untouched recording."""
    anyway = {name for finding in untouched["findings"] for name in finding["effects"]}
    return [finding for finding in told["findings"] if finding["effects"][0] not in anyway]


def sized(found: Mapping, truth: Mapping, own: float) -> dict:
    """Return whether an interval holds the strength that was added, and that with what was there, inside its range."""
    _, declared = declarations(library()[truth["name"]])[truth["switch"]]
    added = truth["value"] - truth["off"]
    return {
        "own": own,
        "covered": found["low"] <= truth["value"] <= found["high"],
        "covered_whole": found["low"] <= min(max(own + added, declared.low), declared.high) <= found["high"],
        "relative": (found["value"] - truth["off"]) / added - 1,
    }


def judged(folder: Path, name: str, again: str) -> dict:
    """Return what a diagnosis says of a spiked recording beyond what it says of the untouched one.

    Parameters
    ----------
    folder : pathlib.Path
    name : str
    again : str
        The untouched recording, asked beside what is known of it, as the spiked one was.
    """
    place = Folder(folder)
    truth = json.loads(place.truth(name).read_text())
    before, after = (json.loads(place.answer(one).read_text()) for one in (again, name))
    result = {"name": name, "truth": truth, "seconds": after["seconds"], "verdict": "failed"}
    if after["status"] != 0:
        return result | {"complaint": after["complaint"]}
    control, told = before["diagnosis"], after["diagnosis"]
    new = besides(told, control)
    held = [finding for finding in new if truth["name"] in finding["effects"]]
    here = found_of(told, truth) if held else None
    grown = told["remainder"]["rms_um"] ** 2 - control["remainder"]["rms_um"] ** 2 > truth["left_um"] ** 2 / 2
    strange = truth["name"] in OUTSIDE
    first, sure = (findings[0] if findings else None for findings in (new, said(new)))
    result |= sized(here, truth, own_of(place, truth)) if here else {"covered": None}
    return result | {
        "verdict": told["verdict"],
        "new": [finding["effects"] for finding in new],
        "control": [finding["effects"] for finding in control["findings"]],
        "heard": bool(new) or grown or told["verdict"] == "unexplained" != control["verdict"],
        "held": bool(held),
        "alike": bool(first) and any(alike(truth["name"], one) for one in first["effects"]),
        "alone": bool(held) and held[0]["effects"] == [truth["name"]],
        "wrong_side": bool(sure) and not strange and sure["side"] not in ("undecided", SIDES[truth["name"]]),
        "misnamed": bool(first) and told["verdict"] != "unexplained" and not held,
    }


def rows(results: Sequence[Mapping], again: Sequence[Mapping]) -> list[Row]:
    """Return the table of all spiked cases, and of the controls that were asked twice."""
    good = [r for r in results if r["verdict"] != "failed"]
    known = [r for r in good if r["truth"]["name"] not in OUTSIDE]
    strange = [r for r in good if r["truth"]["name"] in OUTSIDE]
    strong = [r for r in known if r["truth"]["times"] >= 2]
    heard = [r for r in strong if r["heard"]]
    of_size = [r for r in known if r["covered"] is not None]
    whole = "... the strength added to what the untouched recording shows of the effect"
    return [
        counted("spiked", "answered without failure", results, lambda r: r["verdict"] != "failed", "100 %"),
        counted("spiked", "from twice the limit on: heard", strong, lambda r: r["heard"], ">= 90 %"),
        counted("spiked", "... true one named besides", heard, lambda r: r["held"], ">= 90 %"),
        counted("spiked", "... or a look-alike of it", heard, lambda r: r["held"] or r["alike"], ""),
        counted("spiked", "... wrong side", heard, lambda r: r["wrong_side"], "<= 2 %"),
        counted("spiked", "weaker ones: heard", [r for r in known if r not in strong], lambda r: r["heard"], ""),
        counted("spiked", "95 % intervals hold the strength added", of_size, lambda r: r["covered"], ""),
        counted("spiked", whole, of_size, lambda r: r["covered_whole"], ">= 90 %"),
        counted("spiked", "outside the library: heard", strange, lambda r: r["heard"], ""),
        counted("spiked", "... given a name with confidence", strange, lambda r: r["misnamed"], "<= 10 %"),
        counted("control", "untouched, beside what is known: more said", again, lambda r: r["more"], "<= 5 %"),
    ]


def prove(folder: Path, real: Path, cases: int, most_fields: int, processes: int, minutes: float) -> dict:
    """Return the table and all cases."""
    every = sorted(path.parent.name for path in real.glob("*/aligned.tif"))
    fields = every[:: max(len(every) // most_fields, 1)][:most_fields]
    code, last = code_sha256(), time.monotonic() + 60 * minutes
    (folder / "data").mkdir(parents=True, exist_ok=True)
    controls = {field: control_of(folder, real, field) for field in fields}
    with ThreadPoolExecutor(processes) as askers:
        list(askers.map(lambda name: ask(folder, name, code), controls.values()))
        twice = {field: again_of(folder, field, control) for field, control in controls.items()}
        list(askers.map(lambda name: ask(folder, name, code), twice.values()))
    where = [fields[index % len(fields)] for index in range(cases)]
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        jobs = [pool.submit(spike, folder, field, controls[field], k) for k, field in enumerate(where)]
        names = [job.result() for job in jobs]
    seals = {name: sha256(Folder(folder).truth(name)) for name in names}
    if not (path := folder / "seal.json").exists():
        write_text(path, json.dumps({"seed": SEED, "cases": seals}, indent=1) + "\n")
    if json.loads(path.read_text())["cases"] != seals:
        raise ValueError(f"{folder}: sealed: with other cases; choose a new folder or remove it")

    def asked(name: str) -> bool:
        if time.monotonic() > last and not answered(folder, name, code):
            return False
        print(f"{name}: {ask(folder, name, code)['seconds']:.0f} s", flush=True)
        return True

    with ThreadPoolExecutor(processes) as askers:
        done = list(askers.map(asked, names))
    told = zip(names, where, done, strict=True)
    results = [judged(folder, name, twice[field]) for name, field, answered_it in told if answered_it]
    again = [_again(folder, controls[field], name) for field, name in twice.items()]
    table = [row.content() for row in rows(results, again)]
    return {"rows": table, "cases": results, "controls": again, "code": code, "fields": fields, "sealed": len(names)}


def _again(folder: Path, control: str, name: str) -> dict:
    first, second = (json.loads(Folder(folder).answer(one).read_text())["diagnosis"] for one in (control, name))
    return {
        "name": name,
        "more": bool(said(second["findings"])),
        "first": [f["effects"] for f in first["findings"]],
        "second": [f["effects"] for f in second["findings"]],
    }


def main(words: Sequence[str] | None = None) -> int:
    """Run the proof; leave docs/evidence/spiked.json."""
    parser = argparse.ArgumentParser(prog="python -m tests.prove.spiked", description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, metavar="RUN_DIR")
    parser.add_argument("real", type=Path, metavar="REAL_DIR", help="what `make real` has left")
    parser.add_argument("--cases", type=int, default=32)
    parser.add_argument("--fields", type=int, default=8, help="so many of the recordings, spread over the list")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=math.inf, help="ask nothing more after so long")
    parser.add_argument("--report", type=Path, help="file of the result; RUN_DIR/spiked.json without")
    chosen = parser.parse_args(words)
    proof = prove(chosen.folder, chosen.real, chosen.cases, chosen.fields, chosen.processes, chosen.minutes)
    seconds = sorted(case["seconds"] for case in proof["cases"]) or [0.0]
    about = {
        "title": "Effects added to real recordings",
        "version": __version__,
        "command": f"make prove-real with --cases {chosen.cases} --fields {chosen.fields}, seed {SEED}",
        "machine": f"{platform.system()}, {platform.machine()}, Python {platform.python_version()}",
        "date": f"{date.today()}",
        "text": f"{len(proof['cases'])} of {proof['sealed']} sealed cases were asked, on {len(proof['fields'])} "
        "published AFM recordings of two-photon prints, one field each; median "
        f"{seconds[len(seconds) // 2]:.0f} s. What the diagnosis of the untouched recording names is given to that of "
        "the changed one, and to that of the untouched one again; counted is what is said of the one and not of the "
        "other; as a wrong side, or said of an untouched one, what "
        f"has a probability of {SURE:.0%} at least. The limit is that of noise, and of what the untouched "
        "recording holds without a name. A real print has something of many effects, or something like them: intervals "
        "are held against what was added alone, and on top of what `calibrate` finds of the effect in the untouched "
        "recording, or against the end of the effect's range where that comes first.",
    }
    report = chosen.report or chosen.folder / "spiked.json"
    write_text(report, json.dumps(about | proof, indent=1, default=float) + "\n")
    for row in proof["rows"]:
        low, high = wilson(row["hit"], row["count"])
        print(f"{row['what']:70} {row['hit']:3} of {row['count']:3} ({low:.0%} to {high:.0%})  {row['wanted']}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

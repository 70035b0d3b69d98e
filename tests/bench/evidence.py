"""Leave what benches came to as JSON, from which the page of evidence is made.

Run as ``python -m tests.bench.evidence demo|real|generations|agreement|speed`` after `make demo`, `real-diagnosis`,
`generations`, `bench-agreement` or `bench` has filled runs/; of the generations both ways of one seed, with
``DIAGNOSE=1`` and without.
"""

from __future__ import annotations

import json
import platform
import sys
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dlwpredict import __version__
from dlwpredict.files.atomic import write_text
from tests.bench.demo import missing, off_um
from tests.bench.generations import RIM_UM, paper_gains, scores
from tests.bench.real import held_out_um

RUNS, EVIDENCE = Path("runs"), Path("docs/evidence")

SEEN = 3.0
"""Standard deviations at which a change can be compared."""


def row(what: str, value: float, unit: str = "", wanted: str = "") -> dict[str, Any]:
    """Return one row, the value to three digits."""
    return {
        "what": what,
        "value": float(f"{value:.3g}") if value < 1000 else round(value),
        "unit": unit,
        "wanted": wanted,
    }


def work(told: dict) -> list[dict[str, Any]]:
    """Return what a diagnosis took."""
    spent = told["work"]
    return [row("predictions", spent["predictions"]), row("processor time", spent["cpu_s"], "s")]


def demo(run: Path = RUNS / "demo", by_seven: Path = RUNS / "demo-seven") -> dict[str, Any]:
    """Return the table of the sample data."""
    rows = []
    for what, folder, printed in (
        ("as printed first", run, "aligned"),
        ("corrected by the seven parameters alone", by_seven, "reprinted"),
        ("corrected by what the diagnosis found", run, "reprinted"),
    ):
        for name in ("cin", "air"):
            error = off_um(run / name / "target.tif", folder / name / f"{printed}.tif")
            rows.append(row(f"{name.upper()} {what}", error, "µm"))
    told = yaml.safe_load((run / "diagnosis.yaml").read_text())
    text = (
        "Root mean square off the target, away from walls and rim. The virtual press prints with physics that the "
        "program is not told: a focus with wings, soft gelling, vignetting, dose memory, lateral shrinkage. Verdict: "
        f"{told['verdict']}. Named: {missing(run / 'diagnosis.yaml')}."
    )
    return {"title": "The sample data, from raw recordings to the next print", "command": "make demo", "text": text} | {
        "rows": rows + work(told)
    }


def real(run: Path = RUNS / "real") -> dict[str, Any]:
    """Return the table of the real prints."""
    told = yaml.safe_load((run / "diagnosis.yaml").read_text())
    away = "rmse on the eight held out, offset and tilt free: "
    wanted = {"with what was named": "<= 24"}
    rows = [row(away + name, 1e3 * error, "nm", wanted.get(name, "")) for name, error in held_out_um(run).items()]
    own = "the diagnosis's own figure on the eight held out, registration free as well, rim counted: "
    for name, model in (("seven parameters", "baseline"), ("with what was named", "extended")):
        rows.append(row(own + name, 1e3 * told[model]["holdout_rmse_um"], "nm"))
        rows.append(row(f"rmse on the eight fitted, {name}", 1e3 * told[model]["rmse_um"], "nm"))
    rows.append(row("noise", 1e3 * told["noise_um"], "nm"))
    rows.append(row("share of the mismatch that has a name", told["remainder"]["explained_share"], wanted=">= 60 %"))
    text = (
        "Sixteen published two-photon prints with their designs and AFM recordings (Zheng, Zhao, So, SIGGRAPH Asia "
        f"2023), worked on in pixels of {told['working_pitch_um']:g} µm; heights relative. Verdict: {told['verdict']}. "
        f"Named: {missing(run / 'diagnosis.yaml')}."
    )
    if not told["complete"]:
        text += " The search was ended before it was finished: this is the best answer until then."
    if "--resume" in told["provenance"]["command"]:
        text += " It had gone on from an earlier run: the work is that of the last leg alone."
    command = "make real-diagnosis, then python -m tests.bench.evidence real"
    return {"title": "Real prints, eight fitted and eight held out", "command": command, "text": text} | {
        "rows": rows + work(told)
    }


PRESS = Path("configs/press.yaml")
FORM = "psf-wings"
"""The library's effect that the press's focus, a Gaussian-Lorentzian, is nearest to."""

BETTER = {"cin": ">= 12", "air": ">= 12", "lens-array": ""}


def generations(run: Path = RUNS / "generations") -> dict[str, Any]:
    """Return the table of one correction, with the diagnosis and with the seven parameters alone."""
    rows, versions = [], set()
    true = {one["name"] for one in yaml.safe_load(PRESS.read_text())["effects"]} | {FORM}
    for target, wanted in BETTER.items():
        both = [(one, one.with_name(f"{one.name}-diagnosed")) for one in sorted(run.glob(f"{target}-[0-9]"))]
        if not both:
            continue
        errors = [[scores(place, "aligned.tif")[1:3] for place in ways] for ways in both]
        rmse = np.array([[[one.rmse_um for one in way] for way in ways] for ways in errors])  # seed, way, generation
        gains = rmse[..., 0] / rmse[..., 1]
        for label, way, goal in (("the seven alone", 0, ""), ("the diagnosis", 1, wanted)):
            about = f"{target}, one correction with {label}: error smaller by a factor of"
            rows.append(row(f"{about}, median of {len(gains)} seeds", float(np.median(gains[:, way])), "", goal))
            rows.append(row(f"{about}, least", float(gains[:, way].min())))
            rows.append(row(f"{about}, most", float(gains[:, way].max())))
        if target != "lens-array":
            rows.append(row(f"{target}, the paper's first generation: smaller by a factor of", paper_gains(target)[0]))
        better = float(np.mean(gains[:, 1] >= gains[:, 0]))
        rows.append(row(f"{target}, share of seeds where the diagnosis is not worse", better, "", "all"))
        told = [yaml.safe_load((place / "g0" / "diagnosis.yaml").read_text()) for _, place in both]
        versions |= {one["provenance"]["versions"]["dlwpredict"] for one in told}
        found = [set(finding["effects"]) for one in told for finding in one["findings"]]
        held = sum(bool(names & true) for names in found)
        if found:
            rows.append(row(f"{target}, share of {len(found)} findings that hold a true name", held / len(found)))
        rows.append(row(f"{target}, as printed first, median", float(np.median(rmse[:, 0, 0])), "µm"))
    text = (
        f"Root mean square off the target {RIM_UM:g} µm inside the outline, as measured, before and after one "
        f"correction. The virtual press of the sample data ({', '.join(sorted(true))}); seeds: the recordings' noise "
        f"and the surface of AIR. Diagnosed by {' and '.join(sorted(versions))}."
    )
    return {"title": "One correction on the virtual press", "command": "make generations", "text": text} | {
        "rows": rows
    }


def agreement(kept: Path = RUNS / "bench" / "agreement.json") -> dict[str, Any]:
    """Return how far press and program agree on what every effect does."""
    found = json.loads(kept.read_text())
    rows = []
    for one in found:
        law = f" ({one['model']})" if one["model"] else ""
        seen = min(one["program"], one["press"]) >= SEEN
        what = f"{one['effect']}, {one['switch']} = {one['strength']:.3g}{law}: cosine"
        rows.append(row(what, one["cosine"], "", ">= 0.9" if seen else ""))
    text = (
        "What the program's formula and the press's own physics change in the same print, at the same strength, "
        "once all that a fit may move is fitted: calibration, levelling, registration. The cosine is that between "
        "the two in units of noise; 1 = the same change. Below 0.9 the program's law is another than the press's, "
        "and a diagnosis of it leaves something without a name. In brackets which physics the press has, where it has "
        f"several. Nothing is wanted of changes that stand less than {SEEN:g} standard deviations out of the noise."
    )
    return {
        "title": "Press and program, effect by effect",
        "command": "make bench-agreement",
        "text": text,
        "rows": rows,
    }


def speed(folder: Path = RUNS / "bench") -> dict[str, Any]:
    """Return the figures of speed."""
    parts = [json.loads(path.read_text()) for path in sorted(folder.glob("*.json")) if path.stem != "agreement"]
    rows = []
    for one in (figure for part in parts for figure in part["figures"]):
        wanted = "" if one["target"] is None else f"{'>=' if one['least'] else '<='} {one['target']:g}"
        about = f"{one['name']} ({one['note']})" if one["note"] else one["name"]
        rows.append(row(about, one["value"], one["unit"], wanted))
    text = "Ratios of medians of runs in turn on one machine; the reference stands in the name or the note."
    return {"title": "Speed", "command": "make bench", "text": text, "rows": rows}


TABLES = {one.__name__: one for one in (demo, real, generations, agreement, speed)}


def main(name: str) -> None:
    """Write one table."""
    machine = f"{platform.system()}, 2 cores, Python {platform.python_version()}"
    about = {"version": __version__, "machine": machine, "date": f"{date.today()}"}
    table = TABLES[name]()
    write_text(EVIDENCE / f"{name}.json", json.dumps(about | table, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main(sys.argv[1])

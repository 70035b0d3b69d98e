"""Diagnosis against concealed truth: false alarms, names, classes, sides, effects outside the library, held-out gain.

Run as ``python -m tests.bench.diagnosis RUN_DIR [--nulls 20 --singles 1 --raw-nulls 20 ...]``;
`make bench-diagnose` does. Every case is printed on the virtual press, recorded, and diagnosed from the recordings
alone; what was concealed is looked at afterwards. A case that has its JSON in RUN_DIR is not run again.

With ``--program PATH`` another checkout answers the same cases, into a folder of its own in RUN_DIR, and the table
shows both side by side.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from dlwpredict.diagnosis.library.candidates import Candidate
from dlwpredict.diagnosis.library.signatures import Signatures
from dlwpredict.effects import library
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.objective import Work
from dlwpredict.parameters import declarations
from tests.bench import quality
from tests.bench.agreement import bare
from tests.bench.cases import NEVER, OUTSIDE, Case, by_machine, recorded
from tests.press.effect import registry
from tests.prove.hidden import LIBRARY_FORM, Hidden
from tests.prove.linear import LIMIT_Z
from tests.prove.sealed import Bare, strength

ROOT = Path(__file__).parents[2]

Pair = tuple[HeightMap, HeightMap]

PAIRED = 1.5, 4.0
"""Each effect of a pair is drawn between these multiples of its limit, uniform in the logarithm."""

LONGER = " longer"
"""Behind the name of an effect: by the press's longer physics, not in the library's form."""


def forms(name: str) -> dict[str, str]:
    """Return the press's models of an effect: the library's form, and the longer physics; none where it has but one.

    Examples
    --------
    >>> forms("galvo-lag"), forms("curl")
    ({'library': 'time', 'longer': 'literal'}, {})
    """
    models = getattr(registry()[name], "models", ())
    if not models:
        return {}
    literal = LIBRARY_FORM.get(name, "literal")
    return {"library": literal, "longer": models[-1] if models[-1] != literal else models[0]}


def limits(kept: Path, seed: int, processes: int) -> dict[str, dict[str, float | str]]:
    """Return the detection limit of every effect on the trio, as the proof takes it, by the switch that shows most.

    The limit is where the change that the press makes stands out of the noise once everything has been fitted anew;
    effects that the press has by longer physics too have one for either. For physics outside the library, whose
    strength is given: how far it stands out. What is on file is not computed again.
    """
    known = json.loads(kept.read_text()) if kept.exists() else {}
    wanted = [name for name in library() if name not in NEVER]
    wanted += [*(name + LONGER for name in wanted if forms(name)), *OUTSIDE]
    missing = [name for name in wanted if name not in known]
    if missing:
        with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
            for name, limit in zip(missing, pool.map(partial(_limit, seed), missing), strict=True):
                known[name] = limit
                kept.write_text(json.dumps(known, indent=1))
                print(f"limit of {name}: {limit}", flush=True)
    return known


def _limit(seed: int, name: str) -> dict[str, float | str]:
    """Return the limit by the switch that shows most; by the next where its size was not to be had inside the range."""
    known = _bare(seed)
    if name in OUTSIDE:
        return {"z": known.shares({"name": name, **OUTSIDE[name]})["z"]}
    own = name.removesuffix(LONGER)
    models = forms(own)
    settings = {"model": models["longer" if name.endswith(LONGER) else "library"]} if models else {}
    tried = []
    for candidate, visible in _switches(seed)[own]:
        probe = getattr(candidate.at(LIMIT_Z / max(visible, 1e-9)), candidate.switch)
        ends = candidate.declaration.low, candidate.declaration.high
        one = strength(Hidden(own, candidate.switch, candidate.off, probe, *ends, settings), 1.0, known)
        where = {"switch": candidate.switch, "off": candidate.off, "low": ends[0], "high": ends[1]}
        tried.append(where | settings | {key: one[key] for key in ("value", "z")})
        if tried[-1]["z"] > LIMIT_Z / 2:
            break
    return max(tried, key=lambda one: one["z"]) if tried[-1]["z"] <= LIMIT_Z / 2 else tried[-1]


@cache
def _bare(seed: int) -> Bare:
    return bare(seed)


@cache
def _switches(seed: int) -> dict[str, list[tuple[Candidate, float]]]:
    """Return every effect's switches at their default shape, that first whose typical size shows most beside the seven.

    With each stands the z of that size.
    """
    fitted, found = _bare(seed).sight.fit, {}
    around = Signatures.of(fitted, (), Work())
    for candidate, maps in zip(around.chosen, around.maps_um, strict=True):
        default = type(candidate.effect)(**{candidate.switch: candidate.off})
        if all(getattr(candidate.effect, n) == getattr(default, n) for n in declarations(default)):
            seen = fitted.rows.stack([fitted.seen(k, change) for k, change in enumerate(maps)])
            found.setdefault(candidate.name, []).append((candidate, float(np.linalg.norm(fitted.beside(seen)))))
    return {name: sorted(some, key=lambda one: -one[1]) for name, some in found.items()}


def strong(name: str, known: Mapping, times: float, form: str = "library") -> dict:
    """Return an effect at so many times its limit, inside its range, in one of the press's forms."""
    limit = known[name + LONGER * (form == "longer" and name + LONGER in known)]
    value = limit["off"] + times * (limit["value"] - limit["off"])
    model = {"model": limit["model"]} if "model" in limit else {}
    return {"name": name, limit["switch"]: float(np.clip(value, limit["low"], limit["high"])), **model}


def case_of(*effects: Mapping, **settings) -> Case:
    """Sort effects to the press and to the microscope."""
    return Case(*by_machine(effects), **settings)


def cases(chosen: argparse.Namespace, known: Mapping) -> Iterable[tuple[str, Case]]:
    """Yield name and case of everything that was asked for."""
    rng = np.random.default_rng(chosen.seed)
    named = [name for name in library() if name not in NEVER]
    for k in range(chosen.nulls):
        strongly = k % 2
        yield (
            f"null-{k:02d}",
            Case(sigma_um=float(rng.uniform(0.006, 0.03)), correlation_um=2.5 if strongly else 0.7, seed=1000 + k),
        )
    raw = np.random.default_rng([chosen.seed, 1])
    for k in range(chosen.raw_nulls):
        noise = {"sigma_um": float(raw.uniform(0.006, 0.03)), "correlation_um": 2.5 if k % 2 else 0.7}
        yield f"raw-null-{k:02d}", Case(**noise, seed=6000 + k, raw=True)
    for k in range(chosen.raw_singles):
        for j, name in enumerate(named):
            yield f"raw-single-{name}-{k}", case_of(strong(name, known, 2), seed=2000 + 100 * k + j, raw=True)
    for k in range(chosen.singles):
        for j, name in enumerate(named):
            if chosen.model in ("library", "both"):
                yield f"single-{name}-{k}", case_of(strong(name, known, 2), seed=2000 + 100 * k + j)
    for k in range(chosen.longer if chosen.model in ("longer", "both") else 0):
        for j, name in enumerate(named):
            if forms(name):
                yield f"single-{name}-longer-{k}", case_of(strong(name, known, 2, "longer"), seed=2000 + 100 * k + j)
    for k in range(chosen.pairs):
        own = np.random.default_rng([chosen.seed, 2, k])
        two = [str(name) for name in own.choice(named, 2, replace=False)]
        times = np.exp(own.uniform(*np.log(PAIRED), 2))
        drawn = [str(own.choice(["library", "longer"])) for _ in two]
        own_forms = drawn if chosen.model == "both" else [chosen.model] * 2
        effects = [strong(name, known, t, f) for name, t, f in zip(two, times, own_forms, strict=True)]
        yield f"pair-{k:02d}", case_of(*effects, seed=3000 + k)
    for k in range(chosen.outside):
        for j, (name, settings) in enumerate(OUTSIDE.items()):
            yield f"outside-{name}-{k}", case_of({"name": name, **settings}, seed=4000 + 100 * k + j)
    for k in range(chosen.absorbed):
        for j, name in enumerate(("instrument-blur", "astigmatism", "shrinkage-nonlinearity")):
            for kinds in (("air",), ("cin", "air", "stairs", "posts")):
                yield (
                    f"absorbed-{name}-{len(kinds)}-{k}",
                    case_of(strong(name, known, 3), structures=kinds, seed=5000 + 100 * k + j),
                )


def run(program: Path, job: tuple[str, Case, Path]) -> None:
    """Have a program diagnose one case, and write what it said beside what was concealed."""
    name, case, path = job
    with TemporaryDirectory() as folder:
        place = Path(folder, "case.npz")
        keep(place, recorded(case), case.seed)
        try:
            content = ask(program, place)
        except subprocess.CalledProcessError as error:
            print(f"{name:36s} FAILED, and is to be run again: {error}", flush=True)
            return
    truth = [dict(e) for e in (*case.effects, *case.artefacts)]
    content |= {"truth": truth, "forms": [form_of(e) for e in truth], "structures": len(case.structures)}
    part = path.with_suffix(".part")
    part.write_text(json.dumps(content, indent=1, default=float), encoding="utf-8")
    part.rename(path)
    found = [" or ".join(f["effects"]) for f in content["findings"]]
    words = ", ".join(e["name"] for e in truth) or "nothing"
    print(
        f"{name:36s} {words:40s} -> {content['verdict']:11s} {'; '.join(found)}  "
        f"[explained {content['explained']:.2f}, rest p {content['remainder']['p_value']:.2g}, "
        f"{content['work']:.0f} predictions, {content['cpu_s']:.0f} s of CPU]",
        flush=True,
    )


def form_of(entry: Mapping) -> str:
    """Return whether the press prints an effect in the library's form or by longer physics; of physics outside, none.

    Examples
    --------
    >>> form_of({"name": "galvo-lag"}), form_of({"name": "curl"}), form_of({"name": "particle"})
    ('longer', 'library', 'outside')
    """
    if entry["name"] in OUTSIDE:
        return "outside"
    models = forms(entry["name"])
    return "library" if not models or entry.get("model", "literal") == models["library"] else "longer"


def keep(place: Path, pairs: Sequence[Pair], seed: int, *, holdout: Sequence[Pair] = (), start: str = "") -> None:
    """Write a case as any program can read it; a diagnosis starts from the parameter file, or from the paper's."""
    arrays = {"pairs": len(pairs) + len(holdout), "fitted": len(pairs), "seed": seed, "start": start}
    for k, (target, measured) in enumerate([*pairs, *holdout]):
        arrays |= {f"target_{k}": target.heights_um, f"recording_{k}": measured.heights_um}
        arrays |= {f"pitch_{k}": [target.dx_um, target.dy_um], f"reference_{k}": measured.height_reference}
    np.savez(place, **arrays)


def ask(program: Path, place: Path) -> dict:
    """Return the answer of the program in a folder to a case."""
    answer = place.with_suffix(".json")
    command = [sys.executable, "-P", str(Path(__file__).with_name("answering.py")), str(place), str(answer)]
    subprocess.run(command, check=True, env={**os.environ, "PYTHONPATH": str(program), "OPENBLAS_NUM_THREADS": "1"})
    content = json.loads(answer.read_text())
    if Path(content["program"]) != program:
        raise RuntimeError(f"{program} was asked, but {content['program']} has answered")
    return content


def table(folders: Mapping[str, Path], known: Mapping, only: str = "") -> None:
    """Print the table of all cases that every program has answered, truth opened."""
    names = [{path.stem for path in folder.glob("*-*.json")} for folder in folders.values()]
    common = sorted(name for name in set.intersection(*names) if re.search(only, name))
    quality.show(
        {
            label: {name: json.loads((folder / f"{name}.json").read_text()) for name in common}
            for label, folder in folders.items()
        },
        known,
    )


def main() -> None:
    """Run what is missing, then print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    counts = {"nulls": 20, "singles": 1, "longer": 1, "pairs": 8, "outside": 1, "absorbed": 1, "raw-nulls": 20}
    for name, count in (counts | {"raw-singles": 1}).items():
        parser.add_argument(f"--{name}", type=int, default=count, metavar="N")
    parser.add_argument("--model", choices=("library", "longer", "both"), default="both",
                        help="the library's form, longer physics, or both apart (pairs: drawn)")  # fmt: skip
    parser.add_argument("--only", default="", metavar="REGEX", help="cases by their names")
    parser.add_argument("--program", type=Path, metavar="PATH", help="another checkout, asked the same cases")
    parser.add_argument("--table", action="store_true", help="run nothing")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    chosen = parser.parse_args()
    chosen.folder.mkdir(parents=True, exist_ok=True)
    known = limits(chosen.folder / "limits.json", chosen.seed, chosen.processes)
    program, folders = ROOT, {"here": chosen.folder}
    if chosen.program:
        program = chosen.program.resolve()
        folders["beside"] = chosen.folder / f"beside-{program.name}"
        folders["beside"].mkdir(exist_ok=True)
    place = list(folders.values())[-1]
    jobs = [(name, case, place / f"{name}.json") for name, case in cases(chosen, known)]
    np.random.default_rng(0).shuffle(jobs)  # an interrupted run has some of each kind
    jobs = [job for job in jobs if re.search(chosen.only, job[0]) and not job[2].exists()]
    if not chosen.table:
        with ProcessPoolExecutor(chosen.processes, mp_context=get_context("spawn")) as pool:
            list(pool.map(partial(run, program), jobs))
    table(folders, known, chosen.only)


if __name__ == "__main__":
    main()

"""Prove the diagnosis on concealed effects: seal, ask, open, judge, publish.

python -m tests.prove RUN_DIR --seed final --report sample_data/proof     what `make prove` does
python -m tests.prove RUN_DIR --quick                                      what `make prove-quick` does

Everything is kept in RUN_DIR case by case, so that an interrupted run goes on where it stopped; answers of another
state of the program are asked for again. More cases of the same seed, asked of the same state of the program, join
those of an earlier report: --skip 75 --cases 75 --join sample_data/proof.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from dlwpredict.files.atomic import write_text
from tests.prove.answer import answered, ask, code_sha256
from tests.prove.judge import JUDGE, judged
from tests.prove.mix import DEVELOPMENT_SEED, FINAL_SEED, FULL, QUICK, listed
from tests.prove.page import publish
from tests.prove.sealed import Folder, seal, seals

SEEDS = {"development": DEVELOPMENT_SEED, "final": FINAL_SEED}

EVERY, EVERY_QUICK = 6, 3
"""The baselines are computed for every so manieth case of each kind."""

MAKERS = (
    "press", "bench/cases.py", "prove/mix.py", "prove/hidden.py", "prove/sealed.py", "prove/structures.py",
    "prove/linear.py",
)  # fmt: skip
"""Files that decide what a case is."""


def makers_sha256() -> str:
    """Return the SHA-256 of everything that makes the cases."""
    root, digest = Path(__file__).parent.parent, hashlib.sha256()
    for part in MAKERS:
        path = root / part
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            digest.update(str(file.relative_to(root)).encode() + file.read_bytes())
    return digest.hexdigest()


def told(what: str, work: Callable, jobs: Iterable[Sequence], pool: Executor) -> list:
    """Do jobs two at a time and tell how far they are."""
    jobs, started, done = list(jobs), time.monotonic(), []
    for result in pool.map(work, *zip(*jobs, strict=True)):
        done.append(result)
        print(f"\r{what}: {len(done)} of {len(jobs)}, {time.monotonic() - started:.0f} s ", end="", flush=True)
    print()
    return done


def sealed(folder: Path, seed: int, jobs: Sequence[tuple[str, int]], pool: Executor) -> dict:
    """Make and seal all cases; return the seal, which is written once and never again.

    Raises
    ------
    ValueError
        The folder was sealed with other cases.
    """
    path, made = folder / "seal.json", {"seed": seed, "makers": makers_sha256(), "jobs": [list(job) for job in jobs]}
    if path.exists():
        found = json.loads(path.read_text())
        if {key: found[key] for key in made} != made:
            raise ValueError(f"{folder}: sealed: with other cases or by other code; choose a new folder or remove it")
        return found
    begun = folder / "begun.json"
    if begun.exists() and json.loads(begun.read_text()) != made:
        raise ValueError(f"{folder}: begun: with other cases or by other code; choose a new folder or remove it")
    write_text(begun, json.dumps(made) + "\n")
    names = told("sealed", partial(seal, folder, seed), jobs, pool)
    found = {**made, "cases": seals(folder, names)}
    write_text(path, json.dumps(found, indent=1) + "\n")
    return found


def prove(
    folder: Path,
    seed: int,
    jobs: Sequence[tuple[str, int]],
    *,
    every: int,
    processes: int = 2,
    minutes: float = math.inf,
) -> tuple[list[dict], dict]:
    """Return the results of all cases, and the seal with the state of the program that answered.

    After so many minutes nothing more is asked; what was asked by then is judged. The kinds take turns, in an order
    that the seal holds.
    """
    folder.mkdir(parents=True, exist_ok=True)
    code = code_sha256()
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        seal_of = sealed(folder, seed, jobs, pool)
        names = list(seal_of["cases"])
        before = opened_before(folder, names, code)
        with ThreadPoolExecutor(processes) as askers:
            last = time.monotonic() + 60 * minutes
            answers = told("answered", partial(_asked, folder, last), [(name, code) for name in names], askers)
        if code_sha256() != code:
            raise ValueError("dlwpredict: code: changed while it was asked; run again")
        opened = [
            (name, seal_of["cases"][name], kind[1] % every == 0)
            for name, kind, answer in zip(names, jobs, answers, strict=True)
            if answer is not None
        ]
        results = told("judged", partial(judged, folder), opened, pool)
    return results, {**seal_of, "code": code, "opened_before": before}


def opened_before(folder: Path, names: Sequence[str], code: str) -> int:
    """Return how many cases had been opened when others were asked, also in an earlier run; 0 where none had."""
    kept, place = folder / "opened.json", Folder(folder)
    known = json.loads(kept.read_text()) if kept.exists() else {}
    asked = [name for name in names if answered(folder, name, code)]
    opened = sum(place.result(name).exists() for name in asked)
    if code not in known and opened and len(asked) < len(names):
        known[code] = opened
        write_text(kept, json.dumps(known) + "\n")
    return known.get(code, 0)


def joined(report: Path, results: Sequence[dict], seal_of: Mapping) -> tuple[list[dict], dict]:
    """Return the results of an earlier report with those of a run, and what was sealed for both.

    Raises
    ------
    ValueError
        The report is of other cases, another state of the program or another judge; or a case stands in both.
    """
    seal_before = json.loads((report / "seal.json").read_text())
    before = json.loads((report / "cases.json").read_text())["cases"]
    for key in ("seed", "makers", "code"):
        if seal_before[key] != seal_of[key]:
            raise ValueError(f"{report}: {key}: is {seal_before[key]}, that of the run {seal_of[key]}")
    if judges := {one["judge"] for one in before} - {JUDGE}:
        raise ValueError(f"{report}: judge: is {judges.pop()}, that of the run {JUDGE}")
    if twice := seal_before["cases"].keys() & seal_of["cases"].keys():
        raise ValueError(f"{report}: cases: {min(twice)} was sealed in the run as well; choose others with --skip")
    union = {
        "jobs": [*seal_before["jobs"], *seal_of["jobs"]],
        "cases": {**seal_before["cases"], **seal_of["cases"]},
        "opened_before": len(before) + seal_of["opened_before"],
    }
    return [*before, *results], {**seal_of, **union}


def _asked(folder: Path, last: float, name: str, code: str) -> dict | None:
    return ask(folder, name, code) if time.monotonic() < last or answered(folder, name, code) else None


def main(words: Sequence[str] | None = None) -> int:
    """Run one proof."""
    parser = argparse.ArgumentParser(prog="python -m tests.prove", description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, metavar="RUN_DIR")
    parser.add_argument("--seed", choices=SEEDS, default="development")
    parser.add_argument("--quick", action="store_true", help="a handful of cases of each kind")
    parser.add_argument("--report", type=Path, help="folder of the result; RUN_DIR/report without")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--cases", type=int, help="so many cases, the kinds in proportion; all without")
    parser.add_argument("--skip", type=int, default=0, help="after so many that are left out")
    parser.add_argument("--join", type=Path, metavar="REPORT", help="publish them with the cases of an earlier report")
    parser.add_argument("--minutes", type=float, default=math.inf, help="ask nothing more after so long")
    chosen = parser.parse_args(words)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # for the processes started below
    started, report = time.monotonic(), chosen.report or chosen.folder / "report"
    mix, every = (QUICK, EVERY_QUICK) if chosen.quick else (FULL, EVERY)
    jobs = list(listed(mix))[chosen.skip :][: chosen.cases]
    try:
        results, seal_of = prove(
            chosen.folder, SEEDS[chosen.seed], jobs, every=every, processes=chosen.processes, minutes=chosen.minutes
        )
        if chosen.join:
            results, seal_of = joined(chosen.join, results, seal_of)
    except ValueError as fault:
        print(f"error: {fault}", file=sys.stderr)
        return 1
    command = "make prove" if chosen.seed == "final" and not chosen.quick else "make prove-quick"
    asked = len(seal_of["cases"])
    command += f" with --cases {asked}" if asked < sum(mix.values()) else ""
    publish(report, results, seal_of, command=command, every=every)
    print(f"{report / 'README.md'}: {len(results)} cases, {(time.monotonic() - started) / 60:.1f} minutes")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Ask an earlier state of the program the sealed cases too, and set both beside each other, case by case.

Run as ``python -m tests.bench.earlier RUN_DIR PYTHON [--minutes M] [--report FILE.json]`` on a folder of `make prove`
that has been opened; PYTHON is the interpreter of an environment that has the earlier state. It is given what the
program was given, on the target's grid already, and five minutes of one core. What it says is kept in RUN_DIR/earlier.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import date
from pathlib import Path
from typing import Any

from scipy import stats

from dlwpredict import __version__
from dlwpredict.files.atomic import write_text
from tests.bench.competitors import opened
from tests.prove.answer import diagnosed, pairs_of
from tests.prove.judge import said, scored
from tests.prove.mix import CLEAR
from tests.prove.page import right
from tests.prove.sealed import Folder
from tests.prove.table import STRONG_Z, Row, counted, strongest, weakest

LONGEST_S = 300.0
"""A bench waits no longer."""

Told = Mapping[str, Any]


def of_kind(kind: str, least: Callable[[Told], bool] = lambda told: True) -> Callable[[Told], bool]:
    """Return which cases of a kind count."""
    return lambda told: told["truth"]["kind"] == kind and least(told)


QUESTIONS: dict[str, tuple[Callable[[Told], bool], Callable[[Told], bool]]] = {
    "nothing in it: nothing said": (of_kind("null"), lambda told: told["verdict"] == "none"),
    "nothing in it: nothing named": (of_kind("null"), lambda told: not told["findings"]),
    "one effect, from twice its limit on: heard": (
        of_kind("single", lambda told: strongest(told) >= 2),
        lambda told: told["detected"],
    ),
    "one effect, from twice its limit on: in a named class": (
        of_kind("single", lambda told: strongest(told) >= 2),
        lambda told: any(told["held"]),
    ),
    "two effects, both from 1.5 times their limits on: both in named classes": (
        of_kind("pair", lambda told: weakest(told) >= CLEAR),
        lambda told: all(told["held"]),
    ),
    "outside the library, from SNR 10 on: unexplained": (
        of_kind("outside", lambda told: told["truth"]["effects"][0]["z"] >= STRONG_Z),
        lambda told: told["verdict"] == "unexplained",
    ),
    "every case: answered as well as it can be": (lambda told: True, right),
}
"""Which cases count, and what is right of them."""


def asked(folder: Path, program: Path, name: str, longest_s: float = LONGEST_S) -> dict[str, Any]:
    """Return what an earlier state says of a case; what is on file is not asked again."""
    kept = folder / "earlier" / f"{name}.json"
    if not kept.exists():
        kept.parent.mkdir(exist_ok=True)
        write_text(kept, json.dumps(diagnosed(Folder(folder), name, program, longest_s), indent=1) + "\n")
    return json.loads(kept.read_text())


def laid(folder: Path, name: str) -> bool:
    """Tell whether all recordings of a case lie on their targets: where `align` has failed nothing can be asked."""
    place = Folder(folder)
    return all(place.recording(name, k).exists() for k in pairs_of(place, name))


def judged(result: Told, answer: Told) -> dict[str, Any] | None:
    """Return what of an earlier answer is right, as the judge sees it; None where there was none in time."""
    if answer["status"]:
        return None
    told = said(answer)
    return {"name": result["name"], "truth": result["truth"], **told, **scored(result["truth"], answer["diagnosis"])}


def paired(today: Sequence[Told], before: Sequence[Told | None]) -> list[Row]:
    """Return how both answer every question, on the cases that both answered, and what speaks for a difference.

    The probability is that of a sign test: of cases that only one of both has right, as uneven a division by chance
    (McNemar, Psychometrika 12, 153, 1947; exact).
    """
    both = [(one, other) for one, other in zip(today, before, strict=True) if other and one["verdict"] != "failed"]
    rows = []
    for what, (counts, is_right) in QUESTIONS.items():
        of = [(one, other) for one, other in both if counts(one)]
        rows += [
            counted(what, f"{what}: {who}", [pair[k] for pair in of], is_right)
            for k, who in enumerate(("today", "then"))
        ]
        only = [bool(is_right(one)) for one, other in of if is_right(one) != is_right(other)]
        chance = float(stats.binomtest(sum(only), len(only)).pvalue) if only else 1.0
        rows.append(Row(what, f"{what}: only today right", [], only, "", "share"))
        rows.append(Row(what, f"{what}: as uneven by chance, p", [], [chance], "", "median"))
    return rows


def table_of(results: Sequence[Told], answers: Sequence[Told], program: str, command: str) -> dict[str, Any]:
    """Return everything that is written."""
    before = [judged(result, answer) for result, answer in zip(results, answers, strict=True)]
    times = {"today": results, f"then, at most {LONGEST_S:.0f}": answers}
    spent = [
        Row("work", f"CPU seconds, median: {who}", [], [one["cpu_s"] for one in of], "", "median")
        for who, of in times.items()
    ]
    ends = Row("work", f"then: answered within {LONGEST_S:.0f} CPU s", [], [bool(one) for one in before])
    text = (
        f"{len(results)} sealed cases, asked of an earlier state of the program ({program}) as well, which had "
        f"{LONGEST_S:.0f} CPU seconds for each and was given the recordings as today's `align` lays them. Compared are "
        "cases that both answered. Of the lines that say *only today right*, the count is that of cases which one of "
        "both has right."
    )
    machine = f"{platform.system()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    return {
        "title": "Sealed cases, and an earlier state of the program", "version": __version__, "command": command,
        "machine": machine, "date": f"{date.today()}", "text": text,
        "rows": [row.content() for row in (ends, *spent, *paired(results, before))],
    }  # fmt: skip


def main(words: Iterable[str] | None = None) -> int:
    """Ask, compare, write."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.earlier", description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, metavar="RUN_DIR")
    parser.add_argument("program", type=Path, metavar="PYTHON")
    parser.add_argument("--name", default="d83d3f1", help="what to call the earlier state")
    parser.add_argument("--minutes", type=float, default=math.inf, help="ask nothing more after so long")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--report", type=Path, help="the JSON; RUN_DIR/earlier.json without")
    chosen = parser.parse_args(None if words is None else list(words))
    last = time.monotonic() + 60 * chosen.minutes
    results = [one for one in opened(chosen.folder) if laid(chosen.folder, one["name"])]

    def ask(result: Told) -> dict[str, Any] | None:
        if time.monotonic() > last and not (chosen.folder / "earlier" / f"{result['name']}.json").exists():
            return None
        answer = asked(chosen.folder, chosen.program.absolute(), result["name"])
        print(f"{result['name']}: {answer['cpu_s']:.0f} s, {answer['complaint'] or 'answered'}", flush=True)
        return answer

    with ThreadPoolExecutor(chosen.processes) as askers:
        answers = list(askers.map(ask, results))
    both = [(result, answer) for result, answer in zip(results, answers, strict=True) if answer]
    command = "python -m tests.bench.earlier"
    table = table_of([one for one, _ in both], [one for _, one in both], chosen.name, command)
    write_text(chosen.report or chosen.folder / "earlier.json", json.dumps(table, indent=1) + "\n")
    for row in table["rows"]:
        reached = "no case" if row["value"] is None else f"{row['value']:.3g}"
        print(f"{row['what']:86} {reached} ({row['count']})")
    return 0


if __name__ == "__main__":
    sys.exit(main())

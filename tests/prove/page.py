"""The result of a proof as a folder: README.md, figures, and the JSON that every number comes from."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path

from dlwpredict import __version__
from dlwpredict.files.atomic import write_text
from tests.prove import figures
from tests.prove.judge import CONCEALMENTS
from tests.prove.linear import LIMIT_Z
from tests.prove.structures import FINE_ENOUGH_UM, HALF, PITCHES_UM, WHOLE
from tests.prove.table import Row, limits, rows, wrong_form

OPENED = """, but that the first {} were
opened when time had ended, and the others asked afterwards, of the same state of the program"""

HEAD = """# Proof on concealed effects

{all} cases, made by the virtual printer and microscope in `tests/press` (which share no code with `dlwpredict`), were
sealed: targets and recordings under opaque names, and the SHA-256 of what is concealed in them
([`seal.json`](seal.json)). Then `dlwpredict diagnose` was run on each as a command of its own; only after the last
answer were the seals opened and the answers judged{opened}. Run: `{command}` (seed {seed}).
{count} cases were asked ({kinds}){rest}.
One to three random structures per case (CIN of 60 to 80 um, AIR of 80 to 100, lens, stairs, posts and pads of 40 to
60, at a pitch of {whole} um, in every fifth case; half as large, at {half} um, in the others); random process, noise
level, kind and length of correlation. A further structure is printed too and kept from the program. Half of the cases
are recorded raw: on a field larger than the part, on the microscope's own pixels, turned, shifted and tilted;
`dlwpredict align` lays them on their targets first. A
quarter has noise of rows besides, and of these, where raw, every second one a fast axis that is off by 0.05 to 0.2 um
along its way. In half of the cases the press's process differs mildly in form from the seven's
model (focus with tails, conversion that follows the dose, layers that the base holds, cross-linking with tails).

The *detection limit* of a case: the strength at which the change of its recordings, beside everything that the seven
parameters, levelling and registration may take of it, stands {limit:g} standard deviations out of the (true) noise, on
the targets' own pixels or on {coarse:g} um, whichever are wider. Strengths are 0.3 to 5 times that, as far as the
effect's range reaches, errors of form beside other things 0.3 to 3 times. Half of the effects that have one are printed
by the press's longer physics instead of the library's formula.

Every number below stands in [`summary.json`](summary.json) with the names of the cases that it counts, and every case,
with truth and answer, in [`cases.json`](cases.json). Median CPU time of a diagnosis: {seconds:.0f} s; program
under test: dlwpredict {version}, SHA-256 `{code}`.
"""

CONCEALED = """An effect may be concealed in several ways at once: *name hidden* (nothing else hides it), *absorbed by
calibration* (the seven parameters take more than half of its energy, or the case was built so), *hidden behind another
effect* (two at once), *removed by levelling or registration* (they take more than half), *near the noise* (less than
1.5 times its detection limit)."""

METHODS = """On {count} of the {all} cases, one in {every} of each kind. All but `diagnose` are told the true noise."""

TITLES = {
    "all": "Cases",
    "null": "Nothing concealed",
    "form": "Nothing concealed, and a process of another form",
    "single": "One effect of the library",
    "size": "Sizes",
    "pair": "Two effects",
    "outside": "Physics that the library does not have",
    "absorbed": "Absorbed by calibration",
    "measurement": "Effects of the measurement, and their doubles",
    "work": "Work",
    "unseen": "What was not shown to the program (cases heard, from the limit on)",
}


def publish(folder: Path, results: Sequence[Mapping], seal: Mapping, *, command: str, every: int) -> None:
    """Write the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = rows(results)
    figures.save(folder, results)
    machine = f"{platform.system()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    about = {"version": __version__, "command": command, "machine": machine, "date": f"{date.today()}"}
    found = {"about": about, "rows": [line.content() for line in lines], "limits": limits(results)}
    write_text(folder / "seal.json", json.dumps(seal, indent=1) + "\n")
    write_text(folder / "summary.json", json.dumps(_short(found), indent=1) + "\n")
    cases = ",\n".join(json.dumps(_short(r), separators=(",", ":")) for r in sorted(results, key=_place))
    write_text(folder / "cases.json", '{"cases": [\n' + cases + "\n]}\n")
    write_text(folder / "README.md", text(results, lines, seal, command=command, every=every))


def text(results: Sequence[Mapping], lines: Sequence[Row], seal: Mapping, *, command: str, every: int) -> str:
    """Return the README."""
    kinds = [r["truth"]["kind"] for r in results]
    counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(sorted(kinds)))
    seconds = sorted(r.get("cpu_s", r["seconds"]) for r in results)[len(results) // 2]
    every_case = len(seal["cases"])
    head = HEAD.format(
        all=every_case, count=len(results), kinds=counts, command=command, seed=seal["seed"], limit=LIMIT_Z,
        whole="{} to {}".format(*PITCHES_UM[WHOLE]), half="{} to {}".format(*PITCHES_UM[HALF]), coarse=FINE_ENOUGH_UM,
        seconds=seconds, version=__version__, code=seal["code"][:16],
        opened=OPENED.format(seal["opened_before"]) if seal.get("opened_before") else "",
        rest="; time ended before the others, in an order that the seal holds" * (len(results) < every_case),
    )  # fmt: skip
    parts = [head]
    for group, title in TITLES.items():
        parts.append(f"## {title}\n\n{_table([line for line in lines if line.group == group])}")
        if group == "single":
            parts += ["![detection.png](detection.png)", "![confusion.png](confusion.png)"]
        if group == "size":
            parts.append("![intervals.png](intervals.png)")
    parts.append("![unseen.png](unseen.png)")
    concealed = [line for line in lines if line.group.startswith("concealed")]
    parts.append(f"## How effects are concealed\n\n{CONCEALED}\n\n{_by_concealment(concealed)}")
    ways = [line for line in lines if line.group.startswith("way")]
    parts.append(f"## By way of recording and form of the process\n\n{_grid(ways, 'way')}")
    methods = [line for line in lines if line.group.startswith("method")]
    sample = sum(bool(r["baselines"]) for r in results)
    told = METHODS.format(count=sample, all=len(results), every=every)
    parts.append(f"## Beside other methods\n\n{told}\n\n{_grid(methods, 'method')}")
    parts.append(f"## Detection limits\n\n{_limits(results)}")
    parts.append(f"## Every case that was not answered rightly\n\n{_failures(results)}")
    return "\n\n".join(part.strip() for part in parts) + "\n"


def shown(line: Row) -> str:
    """Return a line's number in words."""
    if line.value is None:
        return "no case"
    if line.kind != "share":
        return f"{line.value:.2f} ({len(line.hits)} values)"
    low, high = line.content()["interval"]
    return f"{sum(line.hits)} of {len(line.hits)} = {line.value:.1%} ({low:.0%} to {high:.0%})"


def _table(lines: Sequence[Row]) -> str:
    body = [f"| {line.what} | {shown(line)} | {line.wanted} |" for line in lines]
    return "\n".join(["| | reached (95 % interval) | wanted |", "|---|---|---|", *body])


def _by_concealment(lines: Sequence[Row]) -> str:
    whats = list(dict.fromkeys(line.what for line in lines))
    table = [f"| concealment | {' | '.join(whats)} |", "|---" * (1 + len(whats)) + "|"]
    for label in CONCEALMENTS:
        own = {line.what: line for line in lines if line.group == f"concealed: {label}"}
        table.append(f"| {label} | {' | '.join(shown(own[what]) for what in whats)} |")
    return "\n".join(table)


def _grid(lines: Sequence[Row], what: str) -> str:
    whats = list(dict.fromkeys(line.what for line in lines))
    table = [f"| {what} | {' | '.join(whats)} |", "|---" * (1 + len(whats)) + "|"]
    for group in dict.fromkeys(line.group for line in lines):
        own = {line.what: line for line in lines if line.group == group}
        cells = [shown(own[one]) if one in own else "names nothing" for one in whats]
        table.append(f"| {group.removeprefix(f'{what}: ')} | {' | '.join(cells)} |")
    return "\n".join(table)


def _limits(results: Sequence[Mapping]) -> str:
    body = [f"| {name} | {one['limit']:.3g} | {one['change_nm']:.1f} | {len(one['cases'])} |"
            for name, one in limits(results).items()]  # fmt: skip
    return "\n".join(
        ["| effect | limit, in its unit | change of the recordings, nm rms | cases |", "|---" * 4 + "|", *body]
    )


def right(result: Mapping) -> bool:
    """Tell whether a case was answered as well as it can be: everything from the limit on named, nothing else.

    Where nothing but the form of the process is wrong, the right answer is no name.
    """
    kind, effects = result["truth"]["kind"], result["truth"]["effects"]
    if result["verdict"] == "failed":
        return False
    if kind in ("null", "form") and wrong_form(result):
        return not result.get("findings") and (kind == "null" or result["verdict"] != "none" or wrong_form(result) < 1)
    if kind == "outside":
        return result["verdict"] == "unexplained" or (result["verdict"] == "none" and effects[0]["times"] < 1)
    due = [e["name"] for e in effects if e["times"] >= 1 and e["name"] != "misregistration"]
    said = [f["effects"] for f in result["findings"]]
    known = [e["name"] for e in effects]
    named = all(any(name in names for names in said) for name in due)
    alone = len(result["truth"]["structures"]) == 1
    only = all(any(name in names for name in known) for names in said)
    return (named or alone) and only and (result["verdict"] != "unexplained")


def _failures(results: Sequence[Mapping]) -> str:
    table = ["| case | kind | concealed (times its limit) | said | findings |", "|---" * 5 + "|"]
    for r in sorted(results, key=_place):
        if not right(r):
            truth = (
                ", ".join(f"{e['name']}.{e['switch']} ({e['times']:.1f})" for e in r["truth"]["effects"]) or "nothing"
            )
            if form := r["truth"].get("form"):
                truth += f", form ({form['times']:.1f})"
            said = "; ".join(" or ".join(f["effects"]) for f in r["findings"]) or r.get("complaint", "")
            table.append(f"| `{r['name']}` | {r['truth']['kind']} | {truth} | {r['verdict']} | {said} |")
    return "\n".join(table)


def _place(result: Mapping) -> tuple:
    return result["truth"]["kind"], result["truth"]["index"]


def _short(value):
    """Return plain values with five significant digits."""
    if isinstance(value, dict):
        return {key: _short(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_short(one) for one in value]
    return float(f"{value:.5g}") if isinstance(value, float) else value

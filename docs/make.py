"""Write the pages that are made: commands from the command line, effects from the library, evidence from JSON."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

from dlwpredict.effects import library
from dlwpredict.effects.base import Effect
from dlwpredict.parameters import Declaration, declarations

DOCS = Path(__file__).parent
PROOF = DOCS.parent / "sample_data" / "proof"
BESIDE, MISSES = (DOCS / "evidence" / f"{name}.json" for name in ("competitors", "misses"))
HEAD = "<!-- Made by `make docs` with typer {typer}; not to be edited. -->\n\n"
_EXAMPLE = re.compile(r"^\$ (dlwpredict .*)$", re.MULTILINE)


def commands() -> str:
    """Return the reference of all commands as Markdown, each example in a block of its own."""
    words = ["-m", "typer", "dlwpredict.cli.app", "utils", "docs", "--name", "dlwpredict", "--title", "Commands"]
    said = subprocess.run([sys.executable, *words], capture_output=True, encoding="utf-8", check=True).stdout
    blocks = said.split("```")  # every second one is code already
    blocks[::2] = [_EXAMPLE.sub(r"```sh\n\1\n```", text) for text in blocks[::2]]
    return HEAD.format(typer=metadata.version("typer")) + "```".join(blocks).rstrip() + "\n"


EVIDENCE = """<!-- Made by `make docs` from docs/evidence/*.json and sample_data/proof; not to be edited. -->

# Evidence

What was measured, what was wanted, and first of all what was missed. Shares stand with their 95 % interval (Wilson).

"""


def evidence() -> str:
    """Return the page of evidence as Markdown: what was missed, then every table."""
    others = [path for path in sorted((DOCS / "evidence").glob("*.json")) if path not in (BESIDE, MISSES)]
    tables = [_of_proof(), *(json.loads(path.read_text("utf-8")) for path in others)]
    missed = [(table, row) for table in tables for row in table["rows"] if met(row["value"], row["wanted"]) is False]
    parts = [
        EVIDENCE + "## Missed\n\n" + _table([{**row, "what": f"{t['title']}: {row['what']}"} for t, row in missed])
    ]
    sections = [_section(table, _table(table["rows"])) for table in tables]
    traced = json.loads(MISSES.read_text("utf-8"))
    parts += [sections[0], _section(traced, one_by_one(traced["cases"])), *sections[1:]]
    if BESIDE.exists():
        table = json.loads(BESIDE.read_text("utf-8"))
        parts.append(_section(table, beside(table)))
    return "\n".join(parts)


def one_by_one(cases: list[dict]) -> str:
    """Return a list of cases: what was true, what was said, and why."""
    return "".join(f"- `{c['name']}`. True: {c['true']}. Said: {c['said']}. {c['why']}\n" for c in cases)


def beside(table: dict) -> str:
    """Return the table of several methods on the same cases (`tests.bench.competitors`), a line for each."""
    columns = table["columns"]
    lines = ["| method | " + " | ".join(columns.values()) + " | processor time, median |"]
    lines.append("|---" * (len(columns) + 2) + "|")
    for one in table["methods"]:
        cells = [one["method"], *(_reached({"value": one[key]["count"] or None, **one[key]}) for key in columns)]
        lines.append(f"| {' | '.join(cells)} | {_reached({'value': one['seconds'], 'unit': 's'})} |")
    return "\n".join(lines) + "\n"


def _section(table: dict, body: str) -> str:
    about = [f"Version {table['version']}"] + [table[key] for key in ("command", "machine", "date") if key in table]
    return f"## {table['title']}\n\n{'; '.join(about)}. {table['text']}\n\n{body}"


def met(value: float | None, wanted: str) -> bool | None:
    """Tell whether a share or a number is what was wanted; None where nothing was.

    >>> met(0.99, ">= 95 %"), met(0.79, "90 to 98 %"), met(1.2, "<= 1.1"), met(0.5, "")
    (True, False, False, None)
    """
    numbers = [float(number) for number in re.findall(r"\d+\.?\d*", wanted)]
    if wanted == "all" and value is not None:
        return value == 1
    if value is None or not numbers:
        return None
    scale = 100 if "%" in wanted else 1
    if wanted.startswith("<="):
        return scale * value <= numbers[0]
    if wanted.startswith("within"):
        return abs(scale * value) <= numbers[0]
    if wanted.startswith(">="):
        return scale * value >= numbers[0]
    return numbers[0] <= scale * value <= numbers[-1]


def _of_proof() -> dict:
    proof = json.loads((PROOF / "summary.json").read_text("utf-8"))
    rows = [row for row in proof["rows"] if not row["group"].startswith(("concealed", "method"))]
    title = {"all": "", "null": "nothing in it, ", "single": "one effect, ", "size": "sizes, ", "pair": "two effects, "}
    rows = [{**row, "what": title.get(row["group"], f"{row['group']}, ") + row["what"].lstrip(". ")} for row in rows]
    text = "Made by the virtual press and sealed before the program was asked: [how](../sample_data/proof/README.md)."
    return {"title": "Sealed cases", "rows": rows, "text": text} | proof["about"]


def _table(rows: list[dict]) -> str:
    lines = ["| what | reached | wanted |", "|---|---|---|"]
    return "\n".join([*lines, *(f"| {row['what']} | {_reached(row)} | {row['wanted']} |" for row in rows)]) + "\n"


def _reached(row: dict) -> str:
    if row["value"] is None:
        return "no case"
    if "hit" in row:
        low, high = (100 * end for end in row["interval"])
        return f"{row['hit']} of {row['count']} ({low:.0f} to {high:.0f} %)"
    return f"{row['value']:.3g}{' ' + row['unit'] if 'unit' in row else ''}"


EFFECTS = """<!-- Made by `make docs` from the library; not to be edited. -->

# Effects

Physics of printers, resins and instruments that the seven parameters do not have. A parameter file names them under
`effects:`; `diagnose` looks for all of them. Each picture shows how the print of a chirp (10 ± 1 µm high, 50 × 50 µm)
changes, in nm, where one parameter has its typical size.

"""


def effects() -> str:
    """Return the page of all effects as Markdown: what they are, what they look like, and what tells them apart."""
    parts = []
    for side, title in (("print", "Of the print"), ("measurement", "Of the measurement")):
        parts.append(f"## {title}\n")
        parts += [_effect(kind) for kind in library().values() if kind.side == side]
    return EFFECTS + "\n".join(parts)


def _effect(kind: type[Effect]) -> str:
    alike = ", ".join(f"[{name}](#{name})" for name in kind.confused_with) or "nothing else"
    lines = [f"### {kind.name}", "", f"{kind.meaning[0].upper()}{kind.meaning[1:]}.", ""]
    lines += [f"![What {kind.name} changes](signatures/{kind.name}.png)", ""]
    lines += [f"Looks like: {alike}. Told apart by: {kind.separated_by}.", "", f"Source: {kind.source}.", ""]
    lines += ["| parameter | off or usual | unit | allowed | typical | meaning |", "|---|---|---|---|---|---|"]
    lines += [_parameter(name, default, known) for name, (default, known) in declarations(kind).items()]
    return "\n".join(lines) + "\n"


def _parameter(name: str, default: float, known: Declaration) -> str:
    typical = "" if known.typical is None else f"{known.typical:g}"
    meaning = known.meaning.replace("|", "\\|")
    return f"| `{name}` | {default:g} | {known.unit} | {known.low:g} to {known.high:g} | {typical} | {meaning} |"


if __name__ == "__main__":
    (DOCS / "commands.md").write_text(commands(), encoding="utf-8")
    (DOCS / "effects.md").write_text(effects(), encoding="utf-8")
    (DOCS / "evidence.md").write_text(evidence(), encoding="utf-8")

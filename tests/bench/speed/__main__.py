"""Print the table, figure by figure, and keep it as JSON."""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import asdict
from importlib import metadata
from pathlib import Path

from tests.bench.speed.parts import LONG, PARTS, Figure

HEAD = f"{'figure':52s} {'value':>9s}    {'target':>9s} {'':7s} {'runs':>4s}  note"


def line(figure: Figure) -> str:
    """Return a figure as a line of the table."""
    target = "" if figure.target is None else f"{'>=' if figure.least else '<='} {figure.target:g}"
    return (f"{figure.name:52s} {figure.value:9.3g} {figure.unit:2s} {target:>9s} {figure.verdict:7s} "
            f"{figure.repeats:4d}  {figure.note}").rstrip()  # fmt: skip


def main() -> None:
    """Run the parts that were asked for."""
    parser = argparse.ArgumentParser(prog="make bench", description="Speed, as ratios measured side by side.")
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; all but {', '.join(LONG)}")
    parser.add_argument("--repeats", type=int, default=5, help="alternating runs; fewer where one takes minutes")
    parser.add_argument("--folder", type=Path, default=Path("runs/bench"), help="for the JSON, one file a part")
    asked = parser.parse_args()
    for name in asked.parts:
        if name not in PARTS:
            parser.error(f"no part {name}: {', '.join(PARTS)}")
    asked.folder.mkdir(parents=True, exist_ok=True)
    machine = {"cores": os.cpu_count(), **{name: metadata.version(name) for name in ("numpy", "scipy")}}
    print(f"load before: {os.getloadavg()[0]:.1f} on {machine['cores']} cores\n{HEAD}", flush=True)
    for name in asked.parts or [name for name in PARTS if name not in LONG]:
        kept = []
        for figure in PARTS[name](asked.repeats):
            print(line(figure), flush=True)
            kept.append(asdict(figure) | {"verdict": figure.verdict})
            text = json.dumps({"machine": machine, "load": os.getloadavg()[0], "figures": kept}, indent=2)
            (asked.folder / f"{name}.json").write_text(text + "\n")


if __name__ == "__main__":
    main()

"""A story as a folder to read: README.md, its pictures, and the figures that every number comes from."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from dlwpredict.files.atomic import write_text
from tests.stories.bench import FINER
from tests.stories.story import Told

STEPS = f"""Commands as they were called in this folder, and what they said. The YAML files of press and microscope lie
beside them; `NAME_fine.tif` is `NAME.tif` with every pixel written as {FINER} × {FINER}."""

FOOT = """Every number above comes from the run and stands in [`figures.json`](figures.json); all files are in this
folder. Small parts, printed and recorded by the virtual press and microscope of `tests/press`, which share no code with
`dlwpredict`. Again: `make stories STORIES={name}`."""


def publish(folder: Path, name: str, told: Told, steps: Sequence[Mapping[str, str]]) -> None:
    """Write the page and the figures of a story into its folder."""
    claims = [{"claim": one.words, "found": one.found, "holds": one.holds} for one in told.claims]
    content = {"concealed": told.concealed, "claims": claims, **told.figures}
    write_text(folder / "figures.json", json.dumps(content, indent=1) + "\n")
    write_text(folder / "README.md", text(name, told, steps))


def text(name: str, told: Told, steps: Sequence[Mapping[str, str]]) -> str:
    """Return the page of a story."""
    lines = ["| told | found | |", "|---|---|---|"]
    lines += [f"| {one.words} | {one.found} | {'holds' if one.holds else '**does not hold**'} |" for one in told.claims]
    shown = [f"![{file}]({file})\n\n*{caption}*" for file, caption in told.pictures.items()]
    said = [
        "```console",
        *(line for step in steps for line in (f"$ {step['command']}", *step["said"].splitlines())),
        "```",
    ]
    parts = [
        f"# {told.title}", f"*Concealed from the program:* {told.concealed}", told.text.strip(), "\n".join(lines),
        *shown, "## Step by step", STEPS,
        "\n".join(said), FOOT.format(name=name),
    ]  # fmt: skip
    return "\n\n".join(parts) + "\n"


def index(root: Path) -> None:
    """Write the list of all stories that stand in a folder."""
    lines = ["# Stories of concealed physics", "", "| story | as told |", "|---|---|"]
    for path in sorted(root.glob("*/figures.json")):
        title = path.with_name("README.md").read_text(encoding="utf-8").splitlines()[0].removeprefix("# ")
        holds = [one["holds"] for one in json.loads(path.read_text(encoding="utf-8"))["claims"]]
        lines.append(f"| [{title}]({path.parent.name}/README.md) | {sum(holds)} of {len(holds)} claims hold |")
    write_text(root / "README.md", "\n".join(lines) + "\n")

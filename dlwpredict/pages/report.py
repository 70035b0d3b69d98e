"""A run folder as one HTML page that asks for nothing outside itself; the same folder gives the same bytes."""

from __future__ import annotations

import base64
import hashlib
import math
import re
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from dlwpredict.errors import ResultError
from dlwpredict.files.atomic import write_text
from dlwpredict.heightmap import HeightMap
from dlwpredict.metrology.score import score
from dlwpredict.metrology.walls import WALL_PX, near_walls_or_rim
from dlwpredict.pages import words
from dlwpredict.pages.pictures import LARGEST_MAP, Picture
from dlwpredict.pages.relief import LARGEST_RELIEF, MOST_POINTS, relief, view
from dlwpredict.pages.report_pictures import lead, pictures, ranges, surfaces
from dlwpredict.pages.run_folder import MAPS, PRINTS, Run, Structure, unmatched
from dlwpredict.pages.templates import template
from dlwpredict.parameters import ParameterSet, Readings, declarations

MOST_PIXELS = 800_000
"""Pixels of all maps of a page together; at about four bytes each."""

AWAY = "away from walls and rim"
"""The region of every headline; the whole part stands in the table alone."""

RELATIVE = "relative"
"""Heights without a known zero, and the note of figures that hold a free offset."""

MOST_LEADS = 3
"""Structures that the page leads with; more are summed up in lines."""

MOST_LINES = 6
"""Structures that are summed up in a line each."""

MOST_COLUMNS = 4
"""Parameter files side by side in one table."""

_GENERATION_FOLDER = re.compile(r"(^|/)g(en(eration)?)?[-_]?\d+$", re.IGNORECASE)


@dataclass(frozen=True)
class Figures:
    """One line of the table of figures: what was compared with what, and the score, as the paper's Table 1 has it.

    ``values`` are those of the whole part, ``away`` those of what lies away from walls and the map's rim.
    """

    structure: str
    name: str
    reference: str
    values: dict[str, float | None]
    away: dict[str, float | None] = field(default_factory=dict)
    note: str = ""

    @property
    def predicted(self) -> bool:
        """Whether it is not printed yet."""
        return self.name.startswith(MAPS["next"])


def write_report(path: Path, run: Run) -> None:
    """Write the page whole or not at all.

    Raises
    ------
    InputError
        The folder is missing or not writable.
    """
    write_text(path, page(run))


def page(run: Run) -> str:
    """Return the page of a run."""
    maps = sum(1 + sum(2 * len(printed.maps) for printed in structure.prints) for structure in run.structures)
    pixels = min(LARGEST_MAP, MOST_PIXELS // max(maps, 1))
    rows = [row for structure in run.structures for row in figures(structure)]
    script = (Path(__file__).parent / "relief.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(f"\n{script}\n".encode()).digest()).decode("ascii")
    return template("report.html").render(
        run=run,
        structures=[_shown(structure, pixels) for structure in run.structures],
        title=title(run),
        missing=missing(run),
        leads=leads(run.structures, rows, pixels),
        summaries=summaries(run.structures, rows),
        rows=rows,
        wall_px=WALL_PX,
        reliefs=view(_reliefs(run.structures)),
        alignments=_facts(run, "alignment"),
        corrections=_facts(run, "correction"),
        parameters=parameter_tables(run.parameters),
        changed=changed_inputs(run),
        hint=unmatched(run.structures),
        commands=commands(run),
        script=Markup(f"\n{script}\n"),
        digest=digest,
    )


def title(run: Run) -> str:
    """Return what the page is about: the structures by name, as long as they are few; else how many.

    Examples
    --------
    >>> title(Run("runs", tuple(Structure(name, None, []) for name in ("air", "cin")), {}, {}, {}, (), ()))
    'air and cin: target, print, correction'
    """
    names = [structure.name for structure in run.structures]
    if not names:
        return f"Run {run.name}"
    if len(names) > MOST_LINES:
        return f"{len(names)} structures: targets, prints, corrections"
    listed = " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))
    return f"{listed}: target, print, correction"


def figures(structure: Structure) -> list[Figures]:
    """Return the figures of a structure: its target, every print against it, every print against its prediction."""
    target, rows = structure.target, []
    for printed in structure.prints:
        named = f" {printed.name}".rstrip()
        aligned = printed.maps.get("aligned")
        for role, name in zip(PRINTS, ("print", MAPS["next"], MAPS["reprinted"]), strict=True):
            if role in printed.maps and target is not None:
                rows.append(_compared(structure.name, f"{name}{named}", printed.maps[role], "target", target, target))
        if aligned is not None and "predicted" in printed.maps:
            name, predicted = f"predicted print{named}", printed.maps["predicted"]
            rows.append(_compared(structure.name, f"print{named}", aligned, name, predicted, target or predicted))
        if "score" in printed.facts and (aligned is None or target is None):
            stated = printed.facts["score"]
            against, test = _compared_files(stated) or ("not stated", f"print{named}")
            away = stated.get("away_from_walls") or {}
            rows.append(Figures(structure.name, test, against, stated, away, "as stated"))
    if rows and target is not None:
        sizes = ("sa_um", "sq_um", "sz_um")
        alone = _compared(structure.name, "target", target, "", target, target).values
        rows.insert(0, Figures(structure.name, "target", "", {key: alone[key] for key in sizes if key in alone}))
    return rows


def _compared_files(stated: dict[str, Any]) -> tuple[str, str] | None:
    """Return the names of reference and test of a comparison, in the order in which `score` read them."""
    provenance = stated.get("provenance")
    inputs = provenance.get("inputs") if isinstance(provenance, dict) else None
    if not isinstance(inputs, dict) or len(inputs) < 2:
        return None
    first, second = list(inputs)[:2]
    return Path(str(first)).name, Path(str(second)).name


def _compared(
    structure: str, name: str, test: HeightMap, against: str, reference: HeightMap, part: HeightMap
) -> Figures:
    """Return the score of a test map where the part stands above the substrate; why not, where there is none."""
    if not (test.same_grid(reference) and test.same_grid(part)):
        return Figures(structure, name, against, {}, note="not on the same grid")
    stands = part.heights_um > 0 if (part.heights_um > 0).any() else np.ones(part.shape, dtype=bool)
    try:
        scored = score(reference, test, left_out=~stands)
    except ResultError as error:
        return Figures(structure, name, against, {}, note=error.what)
    try:
        away = asdict(score(reference, test, left_out=~stands | near_walls_or_rim(part)))
    except ResultError:
        away = {}
    note = RELATIVE if scored.height_reference == RELATIVE else ""
    return Figures(structure, name, against, asdict(scored), away, note)


@dataclass(frozen=True)
class Lead:
    """What a structure comes to: pictures on one colour range, a sentence, and at most three numbers."""

    name: str
    sentence: str
    numbers: list[tuple[str, str]]
    pictures: list[Picture]


def leads(structures: tuple[Structure, ...], rows: list[Figures], pixels: int) -> list[Lead]:
    """Return the leads of structures that have a print, where they are not too many to lead."""
    shown = []
    for structure in structures:
        ends = _ends(structure.name, rows)
        if structure.target and ends:
            sentence = summary(structure.name, rows)
            shown.append(Lead(structure.name, sentence, numbers(ends), lead(structure, pixels)))
    return shown if len(shown) <= MOST_LEADS else []


def _ends(structure: str, rows: list[Figures]) -> list[Figures]:
    """Return the figures of a structure's first print and of its last, if that is another one; a prediction is none."""
    own = [row for row in rows if row.structure == structure and row.reference == "target" and row.values]
    prints = [row for row in own if not row.predicted]
    return prints[:1] if len(prints) < 2 else [prints[0], prints[-1]]


def _error_um(row: Figures, values: dict[str, float | None]) -> float:
    """Return the rms error, about its mean where heights are relative: their zero is nobody's."""
    return _number(values["rmse_offset_free_um" if row.note == RELATIVE else "rmse_um"])


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def numbers(ends: list[Figures]) -> list[tuple[str, str]]:
    """Return how far the first and the last print are off the target, and how many times closer the last one is.

    All away from walls and rim, where anything lies there.
    """
    errors = [_error_um(row, row.away or row.values) for row in ends]
    named = zip(("print off target", "corrected print off target"), errors, strict=False)
    pairs = [(name, words.length(error)) for name, error in named]
    if len(errors) == 2 and errors[1] > 0:
        pairs.append(("times closer", f"{errors[0] / errors[1]:.3g}"))
    return pairs


def summary(structure: str, rows: list[Figures]) -> str:
    """Return how the error of a structure went from its first print to its last; nothing without a print."""
    ends = _ends(structure, rows)
    if not ends:
        return ""
    where = AWAY if all(row.away for row in ends) else "over the whole part"
    errors = [words.length(_error_um(row, row.away if where == AWAY else row.values)) for row in ends]
    free = ", mean difference taken off" if any(row.note == RELATIVE for row in ends) else ""
    said = f"{structure}: the print is {errors[0]} off its target (rms, {where}{free})"
    return said + (f"; printed again from the corrected design it is {errors[1]} off." if len(errors) == 2 else ".")


def missing(run: Run) -> str:
    """Return what the diagnoses of a run have found, in a line; nothing where there is none."""
    named = [
        f"{' or '.join(map(str, finding['effects']))} ({finding['side']} side)"
        for diagnosis in run.diagnoses.values()
        for finding in diagnosis.get("findings", [])
    ]
    return f"Missing in the model: {', '.join(dict.fromkeys(named))}." if named else ""


def summaries(structures: tuple[Structure, ...], rows: list[Figures]) -> list[str]:
    """Return one line for each structure, or one for all where there are many."""
    lines = [text for structure in structures if (text := summary(structure.name, rows))]
    if len(lines) <= MOST_LINES:
        return lines
    last = {row.structure: row for row in rows if row.reference == "target" and row.values}
    errors = [_number((row.away or row.values)["rmse_um"]) for row in last.values()]
    low, middle, high = (words.length(float(value)) for value in np.percentile(errors, (0, 50, 100)))
    where = AWAY if all(row.away for row in last.values()) else f"{AWAY} if possible"
    return [f"{len(last)} structures: rmse of the last print {where} {low} to {high}, median {middle}"]


def parameter_tables(files: dict[str, ParameterSet]) -> list[dict[str, Any]]:
    """Return the parameter files of each part side by side: their paths and, for every parameter, its values."""
    groups: dict[str, list[str]] = {}
    for path in files:
        groups.setdefault(_GENERATION_FOLDER.sub("", Path(path).parent.as_posix()), []).append(path)
    chunks = [paths[k : k + MOST_COLUMNS] for paths in groups.values() for k in range(0, len(paths), MOST_COLUMNS)]
    tables = []
    for paths in chunks:
        columns = [parameter_words(files[path]) for path in paths]
        names = dict.fromkeys(name for column in columns for name in column)
        tables.append({"paths": paths, "rows": [(name, [c.get(name, "") for c in columns]) for name in names]})
    return tables


def parameter_words(parameters: ParameterSet) -> dict[str, str]:
    """Return every parameter of a set by its dotted name: value, 95 % interval where known, unit."""
    texts = {}
    owners = [("", parameters.paper), *((f"{effect.name}.", effect) for effect in parameters.effects)]
    for prefix, owner in owners:
        for name, (_, declared) in declarations(type(owner)).items():
            low, high = parameters.intervals.get(prefix + name, (None, None))
            value = {"value": getattr(owner, name), "low": low, "high": high, "unit": declared.unit}
            texts[prefix + name] = words.estimate(value)
            if low is not None and not low <= value["value"] <= high:
                texts[prefix + name] = (
                    f"{words.significant(value['value'])}, outside its interval {low:.3g} to {high:.3g}"
                )
    texts |= {f"writing.{name}": str(value) for name, value in asdict(parameters.writing).items()}
    if parameters.readings != Readings():
        texts |= {f"readings.{name}": str(value) for name, value in asdict(parameters.readings).items()}
    return texts


def changed_inputs(run: Run) -> list[tuple[str, str]]:
    """Return (result, input) wherever an input within the run is no longer what the result was made from."""
    known = {entry.path: entry.sha256 for entry in run.entries}
    changed = []
    for entry in run.entries:
        inputs = entry.provenance.get("inputs")
        for name, digest in inputs.items() if isinstance(inputs, dict) else ():
            beside = (Path(entry.path).parent / str(name)).as_posix()
            inside = [path for path in known if f"/{name}".endswith(f"/{run.name}/{path}") or path in (name, beside)]
            if inside and digest not in [known[path] for path in inside]:
                changed.append((entry.path, str(name)))
    return changed


def commands(run: Run) -> list[tuple[str, list[str]]]:
    """Return every command that the files state, with the files that it made."""
    made: dict[str, list[str]] = {}
    for entry in run.entries:
        if command := entry.provenance.get("command"):
            made.setdefault(str(command), []).append(entry.path)
    return list(made.items())


def _shown(structure: Structure, pixels: int) -> dict[str, Any]:
    groups, profiles = pictures(structure, pixels)
    return {"name": structure.name, "groups": groups, "profiles": profiles}


def _reliefs(structures: tuple[Structure, ...]) -> list[dict[str, Any]]:
    shown = [(structure, surface) for structure in structures for surface in surfaces(structure)]
    points = min(LARGEST_RELIEF, MOST_POINTS // max(len(shown), 1))
    shared = {structure.name: ranges(structure) for structure in structures}
    return [
        relief(structure.name, surface.name, surface.height_map, surface.limits(shared[structure.name]), points)
        for structure, surface in shown
    ]


def _facts(run: Run, kind: str) -> list[tuple[str, dict]]:
    """Return the figures of one kind, with the name of structure and print."""
    return [
        (f"{structure.name} {printed.name}".strip(), printed.facts[kind])
        for structure in run.structures
        for printed in structure.prints
        if kind in printed.facts
    ]

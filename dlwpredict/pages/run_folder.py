"""A run folder, read for its report: files are known by their names and by what they hold.

Height maps are known by name: ``target.tif``, ``written.tif``, ``recording.tif``, ``aligned.tif``, ``predicted.tif``,
``corrected.tif``, ``next.tif``, ``reprinted.tif``, ``unreachable.tif``, alone or after ``PART_``. YAML and JSON files
are known by their content. A folder that holds more than a target is one print; folders ``g0, g1, ...`` are generations
of the part in the folder above, and a folder ``PART--NOTE`` is another print of the part in the folder ``PART``.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dlwpredict.errors import InputError
from dlwpredict.files import read_height_map
from dlwpredict.files.provenance import sha256, stated_by
from dlwpredict.heightmap import HeightMap
from dlwpredict.pages.records import TITLES, read_record
from dlwpredict.parameters import ParameterSet

MAPS = {
    "target": "target",
    "written": "design written for this print",
    "recording": "recording",
    "aligned": "print, aligned recording",
    "predicted": "predicted print",
    "corrected": "corrected design",
    "next": "predicted print of the corrected design",
    "reprinted": "print of the corrected design",
    "unreachable": "height missing where no correction reaches",
}
"""Names of height maps, and what they are."""

PRINTS = "aligned", "next", "reprinted"
"""What is compared with the target: the print, and that of the corrected design, predicted and recorded."""

DESIGNS = "written", "corrected"
"""What was or is to be written, which is not what the print shall be."""

MOST_FILES = 5000
"""Files in a folder that is taken for one run."""

_OF_A_PRINT = ("alignment", "correction", "score")
_GENERATION = re.compile(r"g(en(eration)?)?[-_]?(\d+)", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class Print:
    """One print of a structure: its maps by name, its figures by kind.

    Parameters
    ----------
    name : str
        Tells the prints of a structure apart; may be empty.
    maps : dict of str to HeightMap
    facts : dict of str to dict
        "alignment", "correction", "score".
    """

    name: str
    maps: dict[str, HeightMap]
    facts: dict[str, dict]


@dataclass(frozen=True, eq=False)
class Structure:
    """A part: its target, if there, and its prints in order."""

    name: str
    target: HeightMap | None
    prints: tuple[Print, ...]


@dataclass(frozen=True)
class Entry:
    """A file that the report shows: path within the run, what it is, SHA-256, and its provenance, if it states one."""

    path: str
    what: str
    sha256: str
    provenance: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Run:
    """All that a report shows.

    Parameters
    ----------
    name : str
        Of the folder.
    structures : tuple of Structure
    parameters : dict of str to ParameterSet
        By path within the run; so are the following.
    calibrations, diagnoses : dict of str to dict
    entries : tuple of Entry
    others : tuple of str
        Files that are not shown.
    damaged : tuple of str
        What is wrong with each file that should be shown and could not be read.
    """

    name: str
    structures: tuple[Structure, ...]
    parameters: dict[str, ParameterSet]
    calibrations: dict[str, dict]
    diagnoses: dict[str, dict]
    entries: tuple[Entry, ...]
    others: tuple[str, ...]
    damaged: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Place:
    """Where a file belongs: its folder within the run, and the part that its name starts with."""

    folder: str
    part: str


def read_run(folder: Path, leave_out: tuple[Path, ...] = ()) -> Run:
    """Read a run folder and all folders in it.

    Parameters
    ----------
    folder : pathlib.Path
    leave_out : tuple of pathlib.Path
        Files that are not of the run, such as an earlier report.

    Raises
    ------
    InputError
        No folder, too many files, or nothing in it that a report shows; its first damaged file, if it has one.
    """
    files = [path for path in _files(folder) if path.resolve() not in {left.resolve() for left in leave_out}]
    maps: dict[_Place, dict[str, HeightMap]] = {}
    facts: dict[_Place, dict[str, dict]] = {}
    records: dict[str, dict[str, Any]] = {kind: {} for kind in ("parameters", "calibration", "diagnosis")}
    entries, others, damaged = [], [], []
    content: Any  # a height map, a parameter set or a mapping, by its kind
    for path in files:
        name, part_role = path.relative_to(folder).as_posix(), _named(path)
        try:
            kind, content = ("map", read_height_map(path)) if part_role else read_record(path)
        except InputError as error:
            damaged.append(error)
            continue
        if not kind:
            others.append(name)
            continue
        above = Path(name).parent.as_posix()
        if part_role:
            part, role = part_role
            maps.setdefault(_Place(above, part), {})[role] = content
        elif kind in _OF_A_PRINT:
            facts.setdefault(_Place(above, _part_of_record(path, kind)), {})[kind] = content
        else:
            records[kind][name] = content
        entries.append(
            Entry(name, MAPS[part_role[1]] if part_role else TITLES[kind], sha256(path), stated_by(path) or {})
        )
    if not entries and damaged:
        raise damaged[0]
    if not entries:
        allowed = f"allowed: {', '.join(f'{role}.tif' for role in MAPS)}, parameter files, figures"
        raise InputError("holds nothing that a report shows", where=folder, key="run", allowed=allowed)
    return Run(
        folder.resolve().name,
        _structures(maps, facts, folder.resolve().name),
        records["parameters"],
        _once(records["calibration"]),
        _once(records["diagnosis"]),
        tuple(entries),
        tuple(name for name in others if not name.endswith(".provenance.yaml")),
        tuple(map(str, damaged)),
    )


def _once(records: dict[str, dict]) -> dict[str, dict]:
    """Leave out what a command wrote with ``--json`` beside the same figures in YAML."""

    def command(name: str) -> Any:
        stated = records[name].get("provenance")
        return stated.get("command") if isinstance(stated, dict) else None

    told = {command(name) for name in records if not name.endswith(".json")} - {None}
    return {name: record for name, record in records.items() if not name.endswith(".json") or command(name) not in told}


def _files(folder: Path) -> list[Path]:
    """Return all files, hidden ones left out, in the order of their names, numbers counted."""
    if not folder.is_dir():
        what = "is a file" if folder.is_file() else "no such folder"
        raise InputError(what, where=folder, key="run", allowed="give the folder of a run")
    paths: list[Path] = []

    def refuse(error: OSError) -> None:
        raise InputError(f"cannot read ({error.strerror})", where=error.filename, key="run") from None

    for root, folders, files in os.walk(folder, onerror=refuse):
        folders[:] = [name for name in folders if not name.startswith(".")]
        paths += [Path(root) / name for name in files if not name.startswith(".")]
        if len(paths) > MOST_FILES:
            allowed = f"allowed: at most {MOST_FILES} files; give the folder of one run"
            raise InputError(f"holds {len(paths)} files and more", where=folder, key="run", allowed=allowed)
    return sorted(paths, key=lambda path: [_counted(part) for part in path.parts])


def _counted(text: str) -> list[tuple[int, int, str]]:
    """Return a key by which g2 comes before g10."""
    return [(0, int(bit), "") if bit.isdigit() else (1, 0, bit) for bit in re.split(r"(\d+)", text) if bit]


def _named(path: Path) -> tuple[str, str] | None:
    """Return part and role of a height map by its name; None for any other file.

    >>> _named(Path("cin_aligned.tif")), _named(Path("target.tif")), _named(Path("default.tif"))
    (('cin', 'aligned'), ('', 'target'), None)
    """
    if path.suffix.lower() not in (".tif", ".tiff"):
        return None
    match = re.fullmatch(rf"(?:(.*)[_-])?({'|'.join(MAPS)})", path.stem)
    return (match[1] or "", match[2]) if match else None


def _part_of_record(path: Path, kind: str) -> str:
    """Return the part that a name such as ``cin_align.yaml`` starts with; a comparison of another name is its own."""
    if kind == "score" and not re.fullmatch(r"(.*[_-])?score", path.stem):
        return path.stem
    match = re.fullmatch(r"(.*)[_-](align\w*|pre\w*|correct\w*|score)", path.stem)
    return match[1] if match else ""


def _structures(maps: dict[_Place, dict], facts: dict[_Place, dict], run: str) -> tuple[Structure, ...]:
    """Return the parts: every place that holds maps or figures, generations and notes put under their part."""
    prints: dict[_Place, list[Print]] = {}
    for place in dict.fromkeys((*maps, *facts)):
        print_maps = dict(maps.get(place, {}))
        print_maps.pop("target", None)
        if print_maps or place in facts:
            home, name = _home(place, maps)
            prints.setdefault(home, []).append(Print(name, print_maps, facts.get(place, {})))
    homes = dict.fromkeys(list(prints) + [place for place in maps if "target" in maps[place]])
    return tuple(
        Structure(_title(home, run), maps.get(home, {}).get("target"), tuple(prints.get(home, ()))) for home in homes
    )


def unmatched(structures: tuple[Structure, ...]) -> str:
    """Return a hint where one part has only a target and another only prints without one; else nothing.

    >>> grid = HeightMap([[0, 1], [1, 0]], 1, 1)
    >>> unmatched((Structure("fov", grid, ()), Structure("afm", None, (Print("", {"aligned": grid}, {}),))))
    'fov has a target and no print, afm a print and no target: if they are one part, let their names start alike'
    """
    bare = [structure.name for structure in structures if structure.target is not None and not structure.prints]
    lost = [
        structure.name
        for structure in structures
        if structure.target is None and any("aligned" in p.maps for p in structure.prints)
    ]
    if not (bare and lost):
        return ""
    both = f"{', '.join(bare)} has a target and no print, {', '.join(lost)} a print and no target"
    return f"{both}: if they are one part, let their names start alike"


def _home(place: _Place, maps: dict[_Place, dict]) -> tuple[_Place, str]:
    """Return the part that a print belongs to, and what the print is called there."""
    folder = Path(place.folder)
    above = _Place(folder.parent.as_posix(), place.part)
    if _GENERATION.fullmatch(folder.name) and "target" not in maps.get(place, {}):
        return above, folder.name
    part, note = folder.name.partition("--")[::2]
    if note and "target" not in maps.get(place, {}):
        return _Place((folder.parent / part).as_posix(), place.part), note
    return place, ""


def _title(place: _Place, run: str) -> str:
    folder = "" if place.folder == "." else place.folder
    return "/".join(part for part in (folder, place.part) if part) or run

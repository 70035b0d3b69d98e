"""A run folder, read for its report: files are known by their names and by what they hold.

Height maps are known by name: ``target.tif``, ``written.tif``, ``recording.tif``, ``aligned.tif``, ``predicted.tif``,
``corrected.tif``, ``reprinted.tif``, alone or after ``PART_``. YAML and JSON files are known by their content. A folder
that holds more than a target is one print; folders ``g0, g1, ...`` are generations of the part in the folder above,
and a folder ``PART--NOTE`` is another print of the part in the folder ``PART``.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dlwpredict.errors import InputError, blaming
from dlwpredict.files import read_height_map
from dlwpredict.files.parameters_yaml import FORMAT as PARAMETERS
from dlwpredict.files.parameters_yaml import parameters_from
from dlwpredict.files.provenance import sha256, stated_by
from dlwpredict.files.yaml_text import read_yaml
from dlwpredict.heightmap import HeightMap
from dlwpredict.pages import words
from dlwpredict.pages.require import FLAG, LIST, MAPPING, NUMBER, RANGE, TEXT, require
from dlwpredict.parameters import ParameterSet

MAPS = {
    "target": "target",
    "written": "design written for this print",
    "recording": "recording",
    "aligned": "print, aligned recording",
    "predicted": "predicted print",
    "corrected": "corrected design",
    "reprinted": "print of the corrected design",
}
"""Names of height maps, and what they are."""

DESIGNS = "written", "corrected"
"""What was or is to be written, which is not what the print shall be."""

MOST_FILES = 5000
"""Files in a folder that is taken for one run."""

_BEFORE_AFTER = {"rmse_um.before": NUMBER, "rmse_um.after": NUMBER}
_ERRORS = "rmse_um", "holdout_rmse_um"
_MODEL = {"rmse_um": NUMBER, "holdout_rmse_um": f"{NUMBER}?", "parameters": MAPPING}
NEEDS: dict[str, dict[str, str]] = {
    "parameters": {},
    "calibration": {**_BEFORE_AFTER, "holdout.rmse_um": f"{NUMBER}?", "parameters": MAPPING, "warnings": LIST},
    "diagnosis": {
        "verdict": TEXT,
        "noise_um": NUMBER,
        **{f"{model}.{key}": kind for model in ("baseline", "extended") for key, kind in _MODEL.items()},
        "locations[].pair": NUMBER,
        "locations[].where": TEXT,
        "locations[].share": NUMBER,
        "locations[].x_um": RANGE,
        "locations[].y_um": RANGE,
        "findings[].effects": LIST,
        "findings[].side": TEXT,
        "findings[].statement": TEXT,
        "findings[].parameters{}{}.value": f"{NUMBER}?",
        **{
            f"findings[].parameters{{}}{{}}.{key}?": kind
            for key, kind in (("low", NUMBER), ("high", NUMBER), ("unit", TEXT))
        },
        "findings[].alternatives?[].name": TEXT,
        "findings[].alternatives?[].loss": NUMBER,
        "sentence?": TEXT,
        "findings[].p_value": f"{NUMBER}?",
        **{f"findings[].{key}?.{when}": f"{NUMBER}?" for key in _ERRORS for when in ("before", "after")},
        "remainder.significant": FLAG,
        "remainder.rms_um": f"{NUMBER}?",
        "remainder.p_value": f"{NUMBER}?",
        "remainder.description": f"{TEXT}?",
        "not_testable": LIST,
        "tested": LIST,
    },
    "alignment": {
        **dict.fromkeys(("shift_um", "scale", "tilt_mrad"), RANGE),
        **{f"uncertainty.{key}": RANGE for key in ("shift_um", "scale", "tilt_mrad")},
        **dict.fromkeys(("rotation_deg", "cc", "missing_fraction", "filled_points"), NUMBER),
        "uncertainty.rotation_deg": NUMBER,
        "mirrored": FLAG,
        "height_reference": TEXT,
    },
    "correction": {
        **_BEFORE_AFTER,
        "predictions": NUMBER,
        "reachable.fraction": NUMBER,
        "reachable.largest_um": NUMBER,
        "unreachable.points": NUMBER,
    },
    "score": {
        **dict.fromkeys(("rmse_um", "rmse_offset_free_um", "sa_um", "sq_um", "sz_um"), NUMBER),
        **dict.fromkeys(("cc", "alpha_z", "l_z_um"), f"{NUMBER}?"),
    },
}
"""What is read of each kind of file."""

_FORMATS = {PARAMETERS: "parameters", "dlwpredict-calibration/1": "calibration", "dlwpredict-diagnosis/1": "diagnosis"}
_KEYS = {"alignment": "rotation_deg", "correction": "unreachable", "score": "rmse_offset_free_um"}
_TITLES = {
    "parameters": "parameters",
    "calibration": "figures of a calibration",
    "diagnosis": "diagnosis",
    "alignment": "figures of an alignment",
    "correction": "figures of a correction",
    "score": "figures of a comparison",
}
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
    """

    name: str
    structures: tuple[Structure, ...]
    parameters: dict[str, ParameterSet]
    calibrations: dict[str, dict]
    diagnoses: dict[str, dict]
    entries: tuple[Entry, ...]
    others: tuple[str, ...]


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
        No folder, nothing in it that a report shows, too many files, or a file of a known name that is not readable.
    """
    files = [path for path in _files(folder) if path.resolve() not in {one.resolve() for one in leave_out}]
    maps: dict[_Place, dict[str, HeightMap]] = {}
    facts: dict[_Place, dict[str, dict]] = {}
    records: dict[str, dict[str, Any]] = {kind: {} for kind in ("parameters", "calibration", "diagnosis")}
    entries, others = [], []
    for path in files:
        name, kind, content = path.relative_to(folder).as_posix(), "", None
        if part_role := _named(path):
            part, role = part_role
            maps.setdefault(_Place(Path(name).parent.as_posix(), part), {})[role] = read_height_map(path)
            what = MAPS[role]
        else:
            kind, content = _record(path)
            if not kind:
                others.append(name)
                continue
            what = _TITLES[kind]
            if kind in _OF_A_PRINT:
                facts.setdefault(_Place(Path(name).parent.as_posix(), _part_of_record(path)), {})[kind] = content
            else:
                records[kind][name] = content
        entries.append(Entry(name, what, sha256(path), stated_by(path) or {}))
    if not entries:
        allowed = f"allowed: {', '.join(f'{one}.tif' for one in MAPS)}, parameter files, figures"
        raise InputError("holds nothing that a report shows", where=folder, key="run", allowed=allowed)
    return Run(
        folder.resolve().name,
        _structures(maps, facts, folder.resolve().name),
        records["parameters"],
        records["calibration"],
        records["diagnosis"],
        tuple(entries),
        tuple(name for name in others if not name.endswith(".provenance.yaml")),
    )


def _files(folder: Path) -> list[Path]:
    """Return all files, hidden ones left out, in the order of their names, numbers counted."""
    if not folder.is_dir():
        what = "is a file" if folder.is_file() else "no such folder"
        raise InputError(what, where=folder, key="run", allowed="give the folder of a run")
    found: list[Path] = []

    def refuse(error: OSError) -> None:
        raise InputError(f"cannot read ({error.strerror})", where=error.filename, key="run") from None

    for root, folders, files in os.walk(folder, onerror=refuse):
        folders[:] = [name for name in folders if not name.startswith(".")]
        found += [Path(root) / name for name in files if not name.startswith(".")]
        if len(found) > MOST_FILES:
            allowed = f"allowed: at most {MOST_FILES} files; give the folder of one run"
            raise InputError(f"holds {len(found)} files and more", where=folder, key="run", allowed=allowed)
    return sorted(found, key=lambda path: [_counted(part) for part in path.parts])


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


def _part_of_record(path: Path) -> str:
    """Return the part that a name such as ``cin_align.yaml`` starts with."""
    match = re.fullmatch(r"(.*)[_-](align\w*|pre\w*|correct\w*|score)", path.stem)
    return match[1] if match else ""


def _record(path: Path) -> tuple[str, Any]:
    """Return kind and content of a YAML or JSON file; no kind for what is not ours."""
    readers: Mapping[str, Callable[[Path], Any]] = {".yaml": read_yaml, ".yml": read_yaml, ".json": _read_json}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        return "", None
    try:
        content = reader(path)
    except InputError:
        if re.search(r"^\W*format\W+dlwpredict-", path.read_text("utf-8", errors="ignore"), re.MULTILINE):
            raise
        return "", None
    if not isinstance(content, dict):
        return "", None
    found = _FORMATS.get(str(content.get("format")), "")
    if not found and "format" not in content:
        found = next((kind for kind, key in _KEYS.items() if key in content), "")
    if found:
        with blaming(path):
            require(content, NEEDS[found])
            if found == "diagnosis":
                _check_verdict(content)
            content = parameters_from(content) if found == "parameters" else content
    return found, content


def _check_verdict(content: dict) -> None:
    """Refuse a verdict that is none, or that names an effect where none was found."""
    verdict = content["verdict"]
    if verdict not in words.VERDICTS:
        raise InputError(f"found {verdict!r}", key="verdict", allowed=f"allowed: {', '.join(words.VERDICTS)}")
    if verdict in ("identified", "ambiguous") and not all(
        [content["findings"], *(f["effects"] for f in content["findings"])]
    ):
        raise InputError("names no effect", key="findings", allowed=f"at least one where the verdict is {verdict}")


def _read_json(path: Path) -> Any:
    try:
        return json.loads(path.read_text("utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"not JSON ({type(error).__name__})", where=path, key="file") from None


def _structures(maps: dict[_Place, dict], facts: dict[_Place, dict], run: str) -> tuple[Structure, ...]:
    """Return the parts: every place that holds maps or figures, generations and notes put under their part."""
    prints: dict[_Place, list[Print]] = {}
    for place in dict.fromkeys((*maps, *facts)):
        own = dict(maps.get(place, {}))
        own.pop("target", None)
        if own or place in facts:
            home, name = _home(place, maps)
            prints.setdefault(home, []).append(Print(name, own, facts.get(place, {})))
    homes = dict.fromkeys(list(prints) + [place for place in maps if "target" in maps[place]])
    return tuple(
        Structure(_title(home, run), maps.get(home, {}).get("target"), tuple(prints.get(home, ()))) for home in homes
    )


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

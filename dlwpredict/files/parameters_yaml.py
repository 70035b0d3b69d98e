"""Parameter files: YAML in and out, every key and value checked by name."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, get_args

import numpy as np

from dlwpredict.effects import library
from dlwpredict.effects.base import Effect, settings
from dlwpredict.errors import InputError, blaming
from dlwpredict.files.atomic import write_text
from dlwpredict.files.provenance import note_input
from dlwpredict.files.yaml_text import read_yaml, yaml_text
from dlwpredict.parameters import Paper, ParameterSet, Process, Readings, Side, Undecided, Writing, declarations

FORMAT = "dlwpredict-parameters/1"
_SEVEN = tuple(f.name for f in fields(Paper))
_SECTIONS = ("writing", "readings", "effects", "undecided", "bounds", "intervals", "provenance")


def read_parameters(path: Path | str | None) -> ParameterSet:
    """Read a parameter file; no file means the paper's defaults.

    Raises
    ------
    InputError
        Not readable, not plain YAML, wrong format, unknown or missing key, wrong type, value out of range.
    """
    if path is None:
        return ParameterSet()
    with blaming(path):
        content = read_yaml(path)
        note_input(Path(path))
        return parameters_from(content)


def write_parameters(path: Path | str, parameters: ParameterSet) -> None:
    """Write a parameter file whole or not at all."""
    write_text(path, yaml_text(parameters_as_dict(parameters)))


def parameters_from(content: Any) -> ParameterSet:
    """Build the parameter set from a parsed file, refusing what is not understood."""
    if not isinstance(content, dict):
        raise InputError("no keys found", allowed=f"a mapping that starts with format: {FORMAT}")
    if content.get("format") != FORMAT:
        raise InputError(f"found {content.get('format')}", key="format", allowed=f"allowed: {FORMAT}")
    _refuse_unknown(content, ("format", *_SEVEN, *_SECTIONS))
    effects = _effects(content.get("effects") or [], "effects")
    return ParameterSet(
        paper=_paper(content),
        writing=_writing(_mapping(content, "writing")),
        readings=_readings(_mapping(content, "readings")),
        effects=effects,
        bounds=_ranges(_mapping(content, "bounds"), "bounds"),
        intervals=_ranges(_mapping(content, "intervals"), "intervals"),
        provenance=_mapping(content, "provenance"),
        undecided=_undecided(_mapping(content, "undecided"), [effect.name for effect in effects]),
    )


def parameters_as_dict(parameters: ParameterSet) -> dict[str, Any]:
    """Return the file's content as plain numbers, strings, lists and mappings; empty sections are left out."""
    content: dict[str, Any] = {
        "format": FORMAT,
        **asdict(parameters.paper),
        "writing": asdict(parameters.writing),
    }
    if parameters.readings != Readings():
        content["readings"] = asdict(parameters.readings)
    content["effects"] = _named(parameters.effects)
    if parameters.undecided:
        content["undecided"] = {"effects": list(parameters.undecided.effects)} | {
            side: {**asdict(process.paper), "effects": _named(process.effects)}
            for side, process in ((side, getattr(parameters.undecided, side)) for side in get_args(Side))
        }
    for section in ("bounds", "intervals"):
        if ranges := getattr(parameters, section):
            content[section] = {name: [float(low), float(high)] for name, (low, high) in ranges.items()}
    if parameters.provenance:
        content["provenance"] = parameters.provenance
    return content


def _named(effects: tuple) -> list[dict[str, Any]]:
    return [{"name": effect.name, **settings(effect)} for effect in effects]


def _refuse_unknown(content: dict, known: tuple[str, ...], section: str = "") -> None:
    for key in content:
        if key not in known:
            raise InputError("unknown key", key=f"{section}{key}", allowed=f"allowed: {', '.join(known)}")


def _number(value: Any, key: str) -> float:
    """Return a float; YAML hands 1e-1 over as text, but no other number."""
    try:
        if isinstance(value, bool) or (isinstance(value, str) and "e" not in value.lower()):
            raise TypeError
        return float(value)
    except (TypeError, ValueError):
        raise InputError(f"found {value!r}", key=key, allowed="allowed: a number") from None


def _paper(content: dict, section: str = "") -> Paper:
    for name in _SEVEN:
        if name not in content:
            raise InputError(
                "missing", key=f"{section}{name}", allowed="all seven parameters of the process must be given"
            )
    return Paper(**{name: _number(content[name], f"{section}{name}") for name in _SEVEN})


def _mapping(content: dict, section: str) -> dict:
    value = {} if content.get(section) is None else content[section]
    if not isinstance(value, dict):
        raise InputError(f"found {value!r}", key=section, allowed="allowed: a mapping of keys to values")
    return value


def _writing(content: dict) -> Writing:
    _refuse_unknown(content, tuple(f.name for f in fields(Writing)), "writing.")
    numbers = {name: _number(content[name], f"writing.{name}") for name in declarations(Writing) if name in content}
    return Writing(**numbers, fast_axis=content.get("fast_axis", "y"))


def _readings(content: dict) -> Readings:
    _refuse_unknown(content, tuple(f.name for f in fields(Readings)), "readings.")
    return Readings(**content)


def _effects(entries: Any, section: str) -> tuple:
    if not isinstance(entries, list):
        raise InputError(f"found {entries!r}", key=section, allowed="allowed: a list of {name: ..., parameters}")
    built: list[Effect] = []
    for entry in entries:
        if not isinstance(entry, dict) or entry.get("name") not in list(library()):
            name = entry.get("name") if isinstance(entry, dict) else entry
            raise InputError(
                f"found {name!r}", key=f"{section}.name", allowed=f"allowed: {', '.join(library()) or 'none'}"
            )
        kind = library()[entry["name"]]
        if any(isinstance(effect, kind) for effect in built):
            raise InputError("named twice", key=f"{section}.{kind.name}", allowed="each effect once")
        given = {key: value for key, value in entry.items() if key != "name"}
        _refuse_unknown(given, tuple(declarations(kind)), f"{kind.name}.")
        built.append(kind(**{key: _number(value, f"{kind.name}.{key}") for key, value in given.items()}))
    return tuple(built)


def _undecided(content: dict, present: list[str]) -> Undecided | None:
    """Read the effects whose side is open, and either process; `present` are the names of the effects listed."""
    if not content:
        return None
    sides = get_args(Side)
    _refuse_unknown(content, ("effects", *sides), "undecided.")
    names = content.get("effects")
    if not isinstance(names, list) or not names or not all(name in present for name in names):
        listed = ", ".join(present) or "none is listed"
        raise InputError(f"found {names!r}", key="undecided.effects", allowed=f"allowed: a list of {listed}")
    return Undecided(tuple(names), **{side: _process(content, side) for side in sides})


def _process(content: dict, side: str) -> Process:
    section = f"undecided.{side}"
    process = _mapping({section: content.get(side)}, section)
    try:
        _refuse_unknown(process, (*_SEVEN, "effects"))
        return Process(_paper(process), _effects(process.get("effects") or [], "effects"))
    except InputError as error:
        raise InputError(error.what, key=f"{section}.{error.key}", allowed=error.allowed) from None


def _ranges(content: dict, section: str) -> dict[str, tuple[float, float]]:
    known = list(declarations(Paper))
    known += [f"{name}.{key}" for name, kind in library().items() for key in declarations(kind)]
    _refuse_unknown(content, tuple(known), f"{section}.")
    ranges = {}
    for name, pair in content.items():
        key = f"{section}.{name}"
        if not isinstance(pair, list) or len(pair) != 2:
            raise InputError(f"found {pair!r}", key=key, allowed="allowed: [low, high]")
        low, high = (_number(value, key) for value in pair)
        if np.isnan([low, high]).any() or low > high:
            raise InputError(f"found [{low:g}, {high:g}]", key=key, allowed="allowed: low up to high")
        ranges[name] = (low, high)
    return ranges

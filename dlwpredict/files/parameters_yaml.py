"""Parameter files: YAML in and out, every key and value checked by name."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from dlwpredict.effects import library
from dlwpredict.effects.base import settings
from dlwpredict.errors import InputError, blaming
from dlwpredict.files.atomic import write_text
from dlwpredict.files.provenance import note_input
from dlwpredict.files.yaml_text import read_yaml, yaml_text
from dlwpredict.parameters import Paper, ParameterSet, Readings, Undecided, Writing, declarations

FORMAT = "dlwpredict-parameters/1"
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
    seven = [f.name for f in fields(Paper)]
    _refuse_unknown(content, ("format", *seven, *_SECTIONS))
    for name in seven:
        if name not in content:
            raise InputError("missing", key=name, allowed="all seven parameters of the process must be given")
    effects = _effects(content.get("effects") or [], "effects")
    return ParameterSet(
        paper=Paper(**{name: _number(content[name], name) for name in seven}),
        writing=_writing(_mapping(content, "writing")),
        readings=_readings(_mapping(content, "readings")),
        effects=effects,
        bounds=_ranges(_mapping(content, "bounds"), "bounds"),
        intervals=_ranges(_mapping(content, "intervals"), "intervals"),
        provenance=_mapping(content, "provenance"),
        undecided=_undecided(content.get("undecided") or [], [effect.name for effect in effects]),
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
        content["undecided"] = [{"effect": u.effect, "instead": _named(u.instead)} for u in parameters.undecided]
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
    """Return a float; YAML hands 1e-1 over as text."""
    try:
        if isinstance(value, bool):
            raise TypeError
        return float(value)
    except (TypeError, ValueError):
        raise InputError(f"found {value!r}", key=key, allowed="allowed: a number") from None


def _mapping(content: dict, section: str) -> dict:
    value = content.get(section) or {}
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
    built = []
    for entry in entries:
        if not isinstance(entry, dict) or entry.get("name") not in list(library()):
            found = entry.get("name") if isinstance(entry, dict) else entry
            raise InputError(
                f"found {found!r}", key=f"{section}.name", allowed=f"allowed: {', '.join(library()) or 'none'}"
            )
        kind = library()[entry["name"]]
        if any(isinstance(other, kind) for other in built):
            raise InputError("named twice", key=f"{section}.{kind.name}", allowed="each effect once")
        given = {key: value for key, value in entry.items() if key != "name"}
        _refuse_unknown(given, tuple(declarations(kind)), f"{kind.name}.")
        built.append(kind(**{key: _number(value, f"{kind.name}.{key}") for key, value in given.items()}))
    return tuple(built)


def _undecided(entries: Any, present: list[str]) -> tuple[Undecided, ...]:
    """Read the places that several effects may take; `present` are the names of the effects listed."""
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise InputError(
            f"found {entries!r}", key="undecided", allowed="allowed: a list of {effect: ..., instead: [...]}"
        )
    found: list[Undecided] = []
    for entry in entries:
        _refuse_unknown(entry, ("effect", "instead"), "undecided.")
        name = entry.get("effect")
        if name not in present:
            listed = ", ".join(present) or "none is listed"
            raise InputError(f"found {name!r}", key="undecided.effect", allowed=f"allowed: {listed} (under effects)")
        if name in [other.effect for other in found]:
            raise InputError("named twice", key=f"undecided.{name}", allowed="each effect once")
        instead = _effects(entry.get("instead"), "undecided.instead")
        if not instead:
            raise InputError("found []", key="undecided.instead", allowed="at least one effect")
        for effect in instead:
            if effect.name in present:
                raise InputError(
                    "listed under effects", key=f"undecided.instead.{effect.name}", allowed="effects not listed there"
                )
        found.append(Undecided(name, instead))
    return tuple(found)


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

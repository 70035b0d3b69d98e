"""A diagnosis as one HTML page: no script, nothing outside the file; the same input gives the same bytes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dlwpredict.files.atomic import write_text
from dlwpredict.pages import words
from dlwpredict.pages.pictures import LARGEST_MAP, MOST_PIXELS, PairMaps, coarser, pictures
from dlwpredict.pages.spectra import spectra
from dlwpredict.pages.templates import template

__all__ = ["Evidence", "PairMaps", "write_page"]

MOST_EVIDENCE = 15
"""Rows of evidence shown; the rest is counted."""

WHOLE = 0.8
"""Share of the field along x and along y from which a place is called all over it."""


@dataclass(frozen=True)
class Evidence:
    """What the recordings say about one parameter of one named effect, taken alone.

    Parameters
    ----------
    name : str
        effect.parameter
    score : float
        Standard deviations of noise.
    threshold : float
        Score that noise alone rarely reaches anywhere.
    strength : str
        Estimate, with its unit.
    visible : float
        Score that the typical size would give.
    """

    name: str
    score: float
    threshold: float
    strength: str
    visible: float


@dataclass(frozen=True)
class ParameterRow:
    """A parameter in both models; empty where a model lacks it."""

    name: str
    before: str
    after: str


def write_page(
    path: Path, content: dict, maps: Sequence[PairMaps], *, command: str, evidence: Sequence[Evidence]
) -> None:
    """Write the page whole or not at all.

    Parameters
    ----------
    path : pathlib.Path
    content : dict
        As written to diagnosis.yaml. Also shown where present: ``sentence``; ``noise_from``; ``noise``, a list of
        {white_um, correlated_um, length_um, scars, ...}, one per recording; ``holdout_by``, how data were left out;
        ``tests``, a list of {name, p_value, statement}; ``alternatives`` of a finding, a list of {name, loss}.
    maps : sequence of PairMaps
        In the order of the pairs.
    command : str
        Repeats the diagnosis.
    evidence : sequence of Evidence

    Raises
    ------
    InputError
        The folder is missing or not writable.
    """
    write_text(path, page(content, maps, command=command, evidence=evidence))


def page(content: dict, maps: Sequence[PairMaps], *, command: str, evidence: Sequence[Evidence]) -> str:
    """Return the page; parameters as for `write_page`."""
    ranked = sorted(evidence, key=lambda row: -abs(row.score))
    return template("diagnosis.html").render(
        content=content,
        pairs=[_pair(index, pair, content, len(maps)) for index, pair in enumerate(maps)],
        names=[pair.name for pair in maps],
        numbers=_numbers(content["locations"], maps),
        parameters=parameter_rows(content["baseline"]["parameters"], content["extended"]["parameters"]),
        evidence=ranked[:MOST_EVIDENCE],
        hidden=len(ranked) - len(ranked[:MOST_EVIDENCE]),
        scale=max([abs(row.score) for row in ranked] + [row.threshold for row in ranked] + [1.0]) * 1.02,
        named={name for finding in content["findings"] for name in finding["effects"]},
        command=command,
    )


def parameter_rows(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[ParameterRow]:
    """Return every parameter of two models side by side; nested mappings and lists of effects become dotted names."""
    old, new = _flat(before), _flat(after)
    return [ParameterRow(name, old.get(name, ""), new.get(name, "")) for name in old | new]


def _flat(parameters: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    flat: dict[Any, Any] = {}
    for name, value in parameters.items():
        if isinstance(value, Mapping):
            if not {"value", "low", "high"} <= value.keys():
                flat |= _flat(value, f"{prefix}{name}.")
            else:
                flat[prefix + name] = words.estimate(value)
        elif name == "effects":
            for effect in value:
                settings = {key: entry for key, entry in effect.items() if key != "name"}
                flat |= _flat(settings, f"{effect['name']}.") or {effect["name"]: "on"}
        elif name != "format":
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            flat[prefix + name] = words.significant(value) if number else str(value)
    return flat


def _pair(index: int, pair: PairMaps, content: dict, pairs: int) -> dict[str, Any]:
    """Return what the template shows of one pair."""
    places = [place for place in content["locations"] if place["pair"] == index and not _everywhere(place, pair)]
    pixels = min(LARGEST_MAP, MOST_PIXELS // (4 * pairs))
    named = bool(content["findings"])
    maps, profiles = pictures(pair, places, noise_um=content["noise_um"], pixels=pixels, named=named)
    shown = coarser(pair.target, pair.residual_um, pixels).shape
    figures = {"maps": maps, "profiles": profiles, "spectra": spectra(pair)}
    return {"name": pair.name, "shape": pair.target.shape, "shown": shown, **figures}


def _numbers(locations: Sequence[Mapping[str, Any]], maps: Sequence[PairMaps]) -> list[int | None]:
    """Return the number of every place within its pair, from 1, as on the maps; none for what is all over the field."""
    counts: dict[int, int] = {}
    numbers: list[int | None] = []
    for place in locations:
        pair = place["pair"]
        if _everywhere(place, maps[pair]):
            numbers.append(None)
        else:
            counts[pair] = counts.get(pair, 0) + 1
            numbers.append(counts[pair])
    return numbers


def _everywhere(place: Mapping[str, Any], pair: PairMaps) -> bool:
    """Tell whether a place's box is as good as the whole field: then no frame says where it is."""
    sizes = [high - low for low, high in (place["x_um"], place["y_um"])]
    return all(size >= WHOLE * field for size, field in zip(sizes, pair.target.size_um, strict=True))

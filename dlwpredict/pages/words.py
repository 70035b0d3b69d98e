"""Numbers as a reader at the bench wants them: rounded to what is known, with a unit, a dash where there is none."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import PurePath
from typing import Any, TypeGuard

NONE = "–"
"""Stands where there is no number."""

NO_HOLDOUT = "no error on left-out data: the maps are too small to leave blocks of them out"

VERDICTS = {
    "identified": "one effect is named",
    "ambiguous": "several effects would do",
    "unexplained": "no named effect explains it",
    "none": "nothing beyond noise",
}


def verdict(content: Mapping[str, Any]) -> str:
    """Return what a verdict means; effects may be named though much has no name, or no other data speak for them.

    Examples
    --------
    >>> verdict({"verdict": "unexplained", "findings": [1]}), verdict({"verdict": "unexplained", "findings": []})
    ('effects are named, but none for certain', 'no named effect explains it')
    """
    if content["verdict"] == "unexplained" and content["findings"]:
        return "effects are named, but none for certain"
    return VERDICTS[content["verdict"]]


def recording(content: Mapping[str, Any], pair: int) -> str:
    """Return what a pair's recording is called: its file name, its path where others have that name too.

    Its number in diagnosis.yaml where the names are not known.

    Examples
    --------
    >>> recording({"recordings": ["scans/air.tif"]}, 0), recording({}, 0)
    ('air.tif', 'pair 0')
    >>> recording({"recordings": ["a/aligned.tif", "b/aligned.tif"]}, 1)
    'b/aligned.tif'
    """
    names = content.get("recordings")
    if not (isinstance(names, list) and 0 <= pair < len(names)):
        return f"pair {pair}"
    short = PurePath(str(names[pair])).name
    alike = sum(PurePath(str(name)).name == short for name in names)
    return short if alike == 1 else str(names[pair])


def left_out(rmse_um: Mapping[str, float | None]) -> str:
    """Return the error on data left out, before → after, or why there is none.

    Examples
    --------
    >>> left_out({"before": 0.084, "after": 0.0312})
    'on left-out data 84.0 nm → 31.2 nm'
    """
    errors = change(rmse_um)
    return NO_HOLDOUT if errors == NONE else f"on left-out data {errors}"


def length(value_um: float | None) -> str:
    """Return a small length with its unit: nm below 1 µm.

    Examples
    --------
    >>> length(0.02134), length(1.5), length(None)
    ('21.3 nm', '1.50 µm', '–')
    """
    if not _known(value_um):
        return NONE
    return f"{significant(1e3 * value_um)} nm" if abs(value_um) < 0.9995 else f"{significant(value_um)} µm"


def significant(value: float | None, digits: int = 3) -> str:
    """Return a number with so many significant digits, trailing zeros kept, no exponent between 1e-4 and 1e6.

    Examples
    --------
    >>> significant(0.1), significant(1234.5), significant(-2e-7), significant(0)
    ('0.100', '1234', '-2.00e-07', '0')
    """
    if not _known(value):
        return NONE
    if value == 0:
        return "0"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    power = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if not -5 < power < 6:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{max(digits - 1 - power, 0)}f}"


def probability(value: float | None) -> str:
    r"""Return a p-value; below 0.0001 only that.

    Examples
    --------
    >>> probability(0.0312), probability(1e-9)
    ('0.031', '<\xa00.0001')
    """
    if not _known(value):
        return NONE
    return "<\xa00.0001" if value < 1e-4 else significant(value, 2)


def percent(share: float | None) -> str:
    """Return a share of 1 in per cent.

    Examples
    --------
    >>> percent(0.614)
    '61 %'
    """
    return f"{100 * share:.0f} %" if _known(share) else NONE


def chance(share: float | None) -> str:
    r"""Return a probability in per cent; what is nearly sure or nearly impossible is called no more than that.

    Examples
    --------
    >>> chance(0.614), chance(0.99996), chance(0.0002)
    ('61 %', '>\xa099.9 %', '<\xa00.1 %')
    """
    if not _known(share):
        return NONE
    if not 0.001 <= share <= 0.999:
        return ">\xa099.9 %" if share > 0.5 else "<\xa00.1 %"
    return f"{100 * share:.0f} %" if 0.01 <= share <= 0.99 else f"{100 * share:.1f} %"


def sureness(finding: Mapping[str, Any]) -> str:
    """Return how sure a finding is: of something of its class, of each member, of either side; empty if not known.

    Examples
    --------
    >>> sureness({"effects": ["curl"], "side": "print", "probability": 0.98, "members": {"curl": 1.0}})
    'probability 98 %'
    >>> sides = {"print": 0.7, "measurement": 0.3}
    >>> sureness({"side": "undecided", "probability": 0.98, "members": {"a": 0.7, "b": 0.3}, "side_probability": sides})
    'probability 98 %: a 70 %, b 30 %; print 70 %, measurement 30 %'
    """
    if not _known(finding.get("probability")):
        return ""
    said = f"probability {chance(finding['probability'])}"
    members = finding.get("members") or {}
    if len(members) > 1:
        said += ": " + ", ".join(f"{name} {chance(share)}" for name, share in members.items())
    if finding["side"] == "undecided":
        either = finding.get("side_probability") or {}
        said += "".join(
            f"{', ' if k else '; '}{name} {chance(share)}" for k, (name, share) in enumerate(either.items())
        )
    return said


def work(content: Mapping[str, Any]) -> str:
    """Return how many predictions a diagnosis took, and on which pixels; empty where it does not say.

    Examples
    --------
    >>> work({"work": {"predictions": 327.4}, "working_pitch_um": [0.4, 0.25]})
    '327 predictions, pixels of 0.4 and 0.25 µm'
    """
    spent, pitches = content.get("work") or {}, content.get("working_pitch_um")
    said = []
    if _known(spent.get("predictions")):
        said.append(f"{spent['predictions']:.0f} predictions")
    if pitches:
        every = pitches if isinstance(pitches, list) else [pitches]
        said.append(f"pixels of {' and '.join(f'{pitch:g}' for pitch in dict.fromkeys(every))} µm")
    return ", ".join(said)


def estimate(parameter: Mapping[str, Any]) -> str:
    """Return value, 95 % interval and unit of an estimated parameter; its keys are value, low, high, unit.

    Examples
    --------
    >>> estimate({"value": 0.10213, "low": 0.0911, "high": 0.1131, "unit": "1"})
    '0.102 (0.091 to 0.113)'
    >>> estimate({"value": 8.21, "low": 5.0, "high": 11.3, "unit": "µm"})
    '8.2 (5.0 to 11.3) µm'
    """
    value, low, high = (parameter.get(key) for key in ("value", "low", "high"))
    unit = "" if parameter.get("unit", "1") == "1" else f" {parameter['unit']}"
    if not (_known(low) and _known(high) and 0 < high - low < math.inf):
        return significant(value) + unit
    places = max(0, 1 - math.floor(math.log10((high - low) / 2)))
    return f"{value:.{places}f} ({low:.{places}f} to {high:.{places}f}){unit}"


def change(rmse_um: Mapping[str, float | None] | None) -> str:
    """Return an error before → after; a dash where there is none.

    Examples
    --------
    >>> change({"before": 0.084, "after": 0.0312})
    '84.0 nm → 31.2 nm'
    """
    if not rmse_um or not any(_known(rmse_um.get(key)) for key in ("before", "after")):
        return NONE
    return f"{length(rmse_um.get('before'))} → {length(rmse_um.get('after'))}"


def side(finding: Mapping[str, Any]) -> str:
    """Return on which side a finding lies.

    Examples
    --------
    >>> side({"side": "print"}), side({"side": "undecided"})
    ('print side', 'side undecided')
    """
    return "side undecided" if finding["side"] == "undecided" else f"{finding['side']} side"


def separation(finding: Mapping[str, Any]) -> tuple[str, str]:
    """Return what would tell the members of a class apart, and the command for it; each may be empty.

    ``separate_by`` is a text, a mapping with ``sentence`` (or ``statement``) and ``command``, or nothing; the command
    may also stand beside it as ``separate_command``.
    """
    advice = finding.get("separate_by") or ""
    if not isinstance(advice, Mapping):
        advice = {"sentence": str(advice), "command": finding.get("separate_command")}
    return advice.get("sentence") or advice.get("statement") or "", advice.get("command") or ""


def sentence(content: Mapping[str, Any]) -> str:
    """Return the verdict of a diagnosis in one sentence: its own where it has one."""
    if said := content.get("sentence"):
        return said
    before, after = (content[model]["rmse_um"] for model in ("baseline", "extended"))
    error = f"the error falls from {length(before)} to {length(after)}"
    named = [finding["effects"] for finding in content["findings"]]
    if content["verdict"] == "none":
        return f"Nothing beyond the noise of {length(content['noise_um'])} is missing from the model."
    if content["verdict"] == "unexplained":
        return "The recordings differ from the prediction beyond noise, and no named effect explains most of it."
    if content["verdict"] == "ambiguous":
        return f"The model lacks one of {', '.join(named[0])}: {error}, and these recordings cannot tell which."
    return f"The model lacks {' and '.join(effects[0] for effects in named)}: {error}."


def _known(value: float | None) -> TypeGuard[float]:
    return value is not None and not math.isnan(value)

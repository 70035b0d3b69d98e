"""A diagnosis in a few lines for the terminal; what does not fit is in the report."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

from dlwpredict.pages import words

WIDTH, MOST_LINES = 100, 25
MOST_FINDINGS = MOST_PLACES = 3
MOST_COMMAND_LINES = 3
"""A command is shown whole or not at all."""


def lines(content: Mapping[str, Any]) -> list[str]:
    """Return at most 25 lines of at most 100 characters.

    Parameters
    ----------
    content : mapping
        As written to diagnosis.yaml.
    """
    said = _wrapped(f"{content['verdict'].upper()}: {words.sentence(content)}", most=2)
    said += _wrapped(
        f"rmse {_change(content, 'rmse_um')}, {words.left_out(_errors(content, 'holdout_rmse_um'))}; "
        f"noise {words.length(content['noise_um'])}{_scars(content)}",
        most=2,
    )
    for number, finding in enumerate(content["findings"][:MOST_FINDINGS], start=1):
        said += _finding(number, finding)
    for place in content["locations"][:MOST_PLACES]:
        share = words.percent(place["share"])
        said += _wrapped(f"where: {share} in {words.recording(content, place['pair'])}, {place['where']}", most=1)
    remainder = content["remainder"]
    state = "unexplained structure" if remainder["significant"] else "no more than noise"
    size = f"{words.length(remainder['rms_um'])}, {_p(remainder['p_value'])}"
    said += _wrapped(f"remainder: {state} ({size}). {remainder['description'] or ''}", most=2)
    said += _progress(content)
    return said + _listed("not testable: ", content["not_testable"], most=1 if "complete" in content else 2)


def _scars(content: Mapping[str, Any]) -> str:
    """Return how many lines of the scans were left out, if any."""
    count = sum(one.get("scars") or 0 for one in content.get("noise") or [])
    return f"; {count} line{'s' if count > 1 else ''} of the scan left out for scars" if count else ""


def _progress(content: Mapping[str, Any]) -> list[str]:
    """Return one line on how far the search has come, and what that took."""
    took, spent = (content.get("work") or {}).get("cpu_s"), words.work(content)
    spent += f", {took:.0f} s of processor time" if spent and took is not None else ""
    if content.get("complete") is not False:
        return _wrapped(f"complete: {spent}", most=1) if spent and "complete" in content else []
    missing = content.get("not_tried") or []
    head = f"not complete ({spent}); " if spent else "not complete; "
    return _listed(f"{head}not tried: ", missing, most=1) if missing else _wrapped(head.rstrip("; "), most=1)


def _change(content: Mapping[str, Any], key: str) -> str:
    return words.change(_errors(content, key))


def _errors(content: Mapping[str, Any], key: str) -> dict[str, float | None]:
    return {"before": content["baseline"][key], "after": content["extended"][key]}


def _p(value: float | None) -> str:
    said = words.probability(value)
    return f"p {said}" if said.startswith("<") else f"p = {said}"


def _finding(number: int, finding: Mapping[str, Any]) -> list[str]:
    """Return the lines of one finding; the first has room for more."""
    first, indent = number == 1, "   "
    estimates = [
        f"{effect}.{name} {words.estimate(parameter)}"
        for effect, parameters in finding["parameters"].items()
        for name, parameter in parameters.items()
    ]
    head = f"{number}. {' or '.join(finding['effects'])} ({words.side(finding)}{_sureness(finding)})"
    said = _wrapped(head, most=2 if first and _sureness(finding) else 1)
    said += _listed(indent, estimates, most=3 - len(said) if first else 1)
    errors = [f"without it → with it: rmse {words.change(finding['rmse_um'])}"]
    if (outside := words.change(finding["holdout_rmse_um"])) != words.NONE:
        errors.append(f"left-out {outside}")
    said += _wrapped(f"{indent}{', '.join(errors)}, {_p(finding['p_value'])}", most=1)
    by, command = words.separation(finding)
    if first and by:
        said += _wrapped(f"{indent}to tell apart: {by}", most=2)
        said += _command(command, indent)
    return said


def _sureness(finding: Mapping[str, Any]) -> str:
    said = words.sureness(finding)
    return f", {said}" if said else ""


def _command(command: str, indent: str) -> list[str]:
    """Return a command on lines that a shell joins; a quoted one is not broken."""
    if len(indent + command) <= WIDTH and "\n" not in command:
        return [indent + command] if command else []
    room = WIDTH - len(indent) - len("   \\")
    parts = textwrap.wrap(command, room, break_long_words=False, break_on_hyphens=False)
    quoted = any(sign in command for sign in "\n'\"\\")
    if quoted or len(parts) > MOST_COMMAND_LINES or max(map(len, parts)) > room:
        return [f"{indent}(its command is in the diagnosis)"]
    return [indent + part for part in " \\\n  ".join(parts).split("\n")]


def _listed(head: str, names: Sequence[str], *, most: int) -> list[str]:
    """Return names separated by commas, as many as fit, and how many do not."""
    for count in range(len(names), 0, -1):
        more = f" and {len(names) - count} more" if count < len(names) else ""
        said = _wrapped(head + ", ".join(names[:count]) + more)
        if len(said) <= most:
            return said
    return _wrapped(head + ", ".join(names), most=most) if names else []


def _wrapped(text: str, *, most: int | None = None) -> list[str]:
    """Return the lines of a text, those after the first indented by three more, shortened to so many."""
    indent = " " * (len(text) - len(text.lstrip()) + 3)
    return textwrap.wrap(
        text, WIDTH, subsequent_indent=indent, max_lines=most, placeholder=" …", break_on_hyphens=False
    )  # fmt: skip

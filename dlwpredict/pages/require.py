"""What a page needs of a file, checked at the door: the first key that is missing or of a wrong kind is named."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from dlwpredict.errors import InputError

_STEP = re.compile(r"(\w+)(\??)((?:\[\]|\{\})*)")

NUMBER, TEXT, FLAG, LIST, MAPPING, RANGE = "a number", "text", "true or false", "a list", "a mapping", "two numbers"


def require(content: Any, needs: Mapping[str, str]) -> None:
    """Refuse content that lacks what is needed.

    Parameters
    ----------
    content : object
        As parsed from YAML or JSON.
    needs : mapping
        Dotted key to kind. After a key, ``[]`` stands for every entry of its list, ``{}`` of its mapping, and ``?``
        lets it be absent or null; ``?`` after a kind allows null.

    Raises
    ------
    InputError
        Names the key, what was found, and what is allowed.

    Examples
    --------
    >>> require({"findings": [{"p_value": 0.1}]}, {"findings[].p_value": NUMBER})
    >>> require({"findings": [{"p_value": "low"}]}, {"findings[].p_value": NUMBER})
    Traceback (most recent call last):
    dlwpredict.errors.InputError: findings[0].p_value: found 'low', allowed: a number
    """
    for path, kind in needs.items():
        for key, value in _values(content, path):
            if not _is(value, kind.rstrip("?")) and not (value is None and kind.endswith("?")):
                raise InputError(f"found {_short(value)}", key=key, allowed=f"allowed: {kind.rstrip('?')}")


def _values(content: Any, path: str, at: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every value under a path, with its key."""
    step, _, deeper = path.partition(".")
    if not (match := _STEP.fullmatch(step)):
        raise ValueError(f"{step!r} is no step of a path of keys")
    name, optional, every = match.groups()
    key = f"{at}.{name}" if at else name
    if not isinstance(content, Mapping):
        raise InputError(f"found {_short(content)}", key=at or "file", allowed=f"allowed: {MAPPING}")
    if optional and content.get(name) is None:
        return
    if name not in content:
        raise InputError("missing", key=key)
    values = [(key, content[name])]
    for kind in re.findall(r"\[\]|\{\}", every):
        values = [entry for key, value in values for entry in _entries(key, value, kind)]
    for key, value in values:
        yield from _values(value, deeper, key) if deeper else [(key, value)]


def _entries(key: str, value: Any, kind: str) -> list[tuple[str, Any]]:
    """Return the entries of a list, ``[]``, or of a mapping, ``{}``, with their keys."""
    if kind == "[]" and isinstance(value, list):
        return [(f"{key}[{k}]", entry) for k, entry in enumerate(value)]
    if kind == "{}" and isinstance(value, Mapping):
        return [(f"{key}.{name}", entry) for name, entry in value.items()]
    raise InputError(f"found {_short(value)}", key=key, allowed=f"allowed: {LIST if kind == '[]' else MAPPING}")


def _is(value: Any, kind: str) -> bool:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return {
        NUMBER: number,
        TEXT: isinstance(value, str),
        FLAG: isinstance(value, bool),
        LIST: isinstance(value, list),
        MAPPING: isinstance(value, Mapping),
        RANGE: isinstance(value, list) and len(value) == 2 and all(_is(end, NUMBER) for end in value),
    }[kind]


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."

"""Plain YAML: read without tags or repeated keys, written so that every float reads back as a float."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dlwpredict.errors import InputError

LARGEST_BYTES = 2**23
_LARGEST_INTEGER = 10**300  # what a float can hold


class _PlainLoader(yaml.SafeLoader):
    """Refuse repeated keys, which YAML parsers otherwise resolve silently, and aliases, which can multiply a file."""

    def compose_node(self, parent: Any, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise InputError(f"found the alias *{self.peek_event().anchor}", key="file", allowed="no aliases")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        seen = set()
        for key in (self.construct_object(key, deep=True) for key, _ in node.value):
            if key in seen:
                raise InputError("given twice", key=str(key), allowed="each key once")
            seen.add(key)
        return super().construct_mapping(node, deep)


def _integer(loader: _PlainLoader, node: yaml.ScalarNode) -> int:
    value = loader.construct_yaml_int(node)
    if abs(value) > _LARGEST_INTEGER:
        raise InputError(f"found an integer of {len(node.value)} digits", key="file", allowed="up to 1e300")
    return value


_PlainLoader.add_constructor("tag:yaml.org,2002:int", _integer)


class _PlainDumper(yaml.SafeDumper):
    """Write floats with a point, short lists in one line."""


def _float(dumper: yaml.SafeDumper, value: float) -> yaml.ScalarNode:
    text = repr(float(value))
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e")
    text = {"inf": ".inf", "-inf": "-.inf", "nan": ".nan"}.get(text, text)
    return dumper.represent_scalar("tag:yaml.org,2002:float", text)


def _list(dumper: yaml.SafeDumper, value: list) -> yaml.SequenceNode:
    plain = all(isinstance(item, (int, float, str)) for item in value)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", value, flow_style=plain)


for real in (float, np.float64, np.float32):
    _PlainDumper.add_representer(real, _float)
for sequence in (list, tuple):
    _PlainDumper.add_representer(sequence, _list)
_PlainDumper.add_multi_representer(np.integer, lambda dumper, value: dumper.represent_int(int(value)))
_PlainDumper.add_multi_representer(np.bool_, lambda dumper, value: dumper.represent_bool(bool(value)))
_PlainDumper.ignore_aliases = lambda self, data: True


def read_yaml(path: Path | str) -> Any:
    """Read a YAML file of plain values.

    Raises
    ------
    InputError
        Not readable, too large, not YAML, with tags (such as Python objects), aliases, or a key given twice.
    """
    try:
        if (size := Path(path).stat().st_size) > LARGEST_BYTES:
            raise InputError(f"{size} bytes", where=path, key="file", allowed=f"at most {LARGEST_BYTES}")
        text = Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot read ({error.strerror})", where=path, key="file") from None
    except UnicodeDecodeError:
        raise InputError("not a text file", where=path, key="file", allowed="YAML in UTF-8") from None
    try:
        return yaml.load(text, Loader=_PlainLoader)
    except InputError as error:
        raise error.at(path) from None
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        line = f" in line {mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or type(error).__name__
        raise InputError(f"not plain YAML{line} ({problem})", where=path, key="file", allowed="no tags") from None


def yaml_text(content: Any) -> str:
    """Return the YAML text of plain values, keys in the given order."""
    return yaml.dump(content, Dumper=_PlainDumper, sort_keys=False, allow_unicode=True, width=110)

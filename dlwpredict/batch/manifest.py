"""The manifest of a batch: structures, and the command lines that each of them goes through.

    format: dlwpredict-batch/1
    structures: targets/*.tif
    commands:
      - predict {target} -p process.yaml -o predicted/{name}.tif

Paths count from the manifest's folder. ``{target}`` stands for a structure's file, ``{name}`` for its name; a structure
may have words of its own: ``{target: lens.tif, recording: scans/lens_3.txt}``.
"""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dlwpredict.errors import InputError, blaming
from dlwpredict.files.yaml_text import read_yaml

FORMAT = "dlwpredict-batch/1"
_KEYS = ("format", "structures", "commands")
_WORD = re.compile(r"\{(\w+)\}")


@dataclass(frozen=True)
class Structure:
    """One structure and its command lines, each a tuple of words with every ``{word}`` filled in."""

    name: str
    lines: tuple[tuple[str, ...], ...]


def read_manifest(path: Path) -> list[Structure]:
    """Read a manifest.

    Raises
    ------
    InputError
        Not plain YAML, an unknown or missing key, a wrong type, no such structure, two of one name, or a ``{word}``
        that a structure does not have.
    """
    with blaming(path):
        content = read_yaml(path)
        if not isinstance(content, dict):
            raise InputError("no keys found", allowed=f"a mapping that starts with format: {FORMAT}")
        if content.get("format") != FORMAT:
            raise InputError(f"found {content.get('format')}", key="format", allowed=f"allowed: {FORMAT}")
        for key in content:
            if key not in _KEYS:
                raise InputError("unknown key", key=str(key), allowed=f"allowed: {', '.join(_KEYS)}")
        lines = _lines(content.get("commands"))
        structures = _structures(content.get("structures"), path.parent)
        _check_words(structures, lines)
        return [
            Structure(words["name"], tuple(tuple(_filled(word, words) for word in line) for line in lines))
            for words in structures
        ]


def _lines(commands: Any) -> list[list[str]]:
    if not isinstance(commands, list) or not commands or not all(isinstance(line, str) for line in commands):
        raise InputError(
            f"found {commands!r}",
            key="commands",
            allowed="allowed: a list of command lines, as predict {target} -o ...",
        )
    lines = []
    for number, text in enumerate(commands):
        try:
            lines.append(shlex.split(text))
        except ValueError as error:
            raise InputError(f"{error} in {text!r}", key=f"commands[{number}]", allowed="quotes in pairs") from None
        if not lines[-1]:
            raise InputError("empty", key=f"commands[{number}]", allowed="a command line")
    return lines


def _structures(entries: Any, folder: Path) -> list[dict[str, str]]:
    """Return the words of every structure, in the order of the manifest; patterns stand for the files they match."""
    entries = [entries] if isinstance(entries, str) else entries
    if not isinstance(entries, list) or not entries:
        raise InputError(f"found {entries!r}", key="structures", allowed="allowed: files and patterns as targets/*.tif")
    structures: list[dict[str, str]] = []
    for number, entry in enumerate(entries):
        key = f"structures[{number}]"
        given = {"target": entry} if isinstance(entry, str) else entry
        if not isinstance(given, dict) or not isinstance(given.get("target"), str):
            raise InputError(f"found {entry!r}", key=key, allowed="allowed: a file, or {target: file, word: value}")
        targets = _matching(given["target"], folder)
        if not targets:
            raise InputError(f"no file {given['target']}", key=key, allowed=f"files in {folder.resolve()}")
        for target in targets:
            words = {"name": Path(target).stem, **{str(k): str(v) for k, v in given.items()}, "target": target}
            twin = next((earlier["target"] for earlier in structures if earlier["name"] == words["name"]), None)
            if twin is not None:
                raise InputError(
                    f"{twin} and {target} are both called {words['name']}", key=key, allowed="{target: ..., name: ...}"
                )
            structures.append(words)
    return structures


COMPANIONS = ".provenance.yaml", ".part", ".tiles"
"""Endings of what the program itself lays beside a height map: no pattern means these."""


def _matching(pattern: str, folder: Path) -> list[str]:
    """Return the files that a pattern stands for, from the folder, in alphabetical order."""
    if (folder / pattern).is_file():
        return [pattern]
    if Path(pattern).is_absolute():
        raise InputError(f"no file {pattern}", key="structures", allowed="patterns count from the manifest's folder")
    files = [file for file in folder.glob(pattern) if file.is_file() and not file.name.endswith(COMPANIONS)]
    return sorted(str(file.relative_to(folder)) for file in files)


def _check_words(structures: list[dict[str, str]], lines: list[list[str]]) -> None:
    """Refuse a ``{word}`` that a structure lacks, and a word of a structure that no command uses."""
    used: dict[Any, Any] = {}
    for number, line in enumerate(lines):
        for word in _WORD.findall(" ".join(line)):
            used.setdefault(word, number)
    for words in structures:
        for word, number in used.items():
            if word not in words:
                allowed = ", ".join(f"{{{known}}}" for known in words)
                raise InputError(
                    f"{{{word}}} is not known for {words['name']}",
                    key=f"commands[{number}]",
                    allowed=f"allowed: {allowed}",
                )
        for word in words:
            if word not in ("target", "name") and word not in used:
                raise InputError(
                    f"{word} is used by no command",
                    key=f"structures.{words['name']}",
                    allowed=f"write {{{word}}} there",
                )


def _filled(text: str, words: dict[str, str]) -> str:
    return _WORD.sub(lambda match: words[match[1]], text)

"""What a worker does for one structure: its commands one after the other, those finished already left out."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from dlwpredict.batch.records import Record, hashes, read_record, record_path, write_record

State = Literal["done", "finished before", "failed", "not run"]


@dataclass(frozen=True)
class Said:
    """How a command ended: 0 and its warnings, or another code and the error."""

    code: int
    warnings: tuple[str, ...] = ()
    error: str = ""


@dataclass(frozen=True)
class Command:
    """One command line.

    Parameters
    ----------
    words : tuple of str
        Its paths count from the manifest's folder.
    inputs, outputs : tuple of Path
        The files it reads and writes, main output first.
    overwrite : bool
        Whether outputs that are not its own may be replaced.
    """

    words: tuple[str, ...]
    inputs: tuple[Path, ...]
    outputs: tuple[Path, ...]
    overwrite: bool = False


@dataclass(frozen=True)
class Chain:
    """The commands of one structure.

    Parameters
    ----------
    name : str
    folder : Path
        Of the manifest.
    commands : tuple of Command
    program : callable
        Runs words in a folder; of a module, so that other processes find it.
    """

    name: str
    folder: Path
    commands: tuple[Command, ...]
    program: Callable[[tuple[str, ...], Path], Said]


@dataclass(frozen=True)
class Step:
    """What became of one command of a chain."""

    command: str
    state: State
    said: tuple[str, ...] = ()
    seconds: float = 0.0


def perform(chain: Chain) -> list[Step]:
    """Run the commands of one structure in turn; after one that fails, the rest is not run."""
    steps: list[Step] = []
    for command in chain.commands:
        if steps and steps[-1].state in ("failed", "not run"):
            steps.append(Step(command.words[0], "not run"))
        else:
            steps.append(_step(chain, command))
    return steps


def _step(chain: Chain, command: Command) -> Step:
    """Run one command unless its outputs are there, made by it from the same inputs.

    The record is written twice: before, so that what a killed run leaves is known to be ours, and after. What stood
    there before a run that was killed or failed is an older result: it is not replaced without being asked to.
    """
    folder, name = chain.folder, command.words[0]
    place = record_path(folder, command.outputs)
    before, inputs = read_record(place), hashes(folder, command.inputs)
    present = hashes(folder, command.outputs)
    if before and before.made_from(command.words, inputs) and before.outputs == present:
        return Step(name, "finished before", before.warnings)
    older = present if before is None or before.outputs else _kept(before.standing, present)
    if not command.overwrite:
        for path, sha256 in present.items():
            if before is None or before.outputs.get(path, sha256) != sha256 or (not before.outputs and path in older):
                return Step(name, "failed", (f"{path}: output: exists already, allowed with --overwrite",))
        if before and before.outputs and present:
            why = "has changed inputs" if before.words == command.words else "was made by another command"
            return Step(name, "failed", (f"{next(iter(present))}: output: {why}, allowed with --overwrite",))
    for output in command.outputs:
        (folder / output).parent.mkdir(parents=True, exist_ok=True)
    write_record(place, Record(command.words, inputs, {}, standing=older))
    start = time.perf_counter()
    said = chain.program((*command.words, "--overwrite"), folder)
    seconds = time.perf_counter() - start
    if said.code:
        if before and before.outputs and hashes(folder, command.outputs) == present:
            write_record(place, before)  # nothing was touched: what is there is still what it was
        return Step(name, "failed", (said.error,), seconds)
    write_record(place, Record(command.words, inputs, hashes(folder, command.outputs), said.warnings))
    return Step(name, "done", said.warnings, seconds)


def _kept(standing: dict[str, str], present: dict[str, str]) -> dict[str, str]:
    """Return the files that are still as they stood."""
    return {path: sha256 for path, sha256 in present.items() if standing.get(path) == sha256}

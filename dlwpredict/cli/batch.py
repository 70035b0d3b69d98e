"""``dlwpredict batch``: many structures through the same commands, on the local cores or on a Dask cluster."""

from __future__ import annotations

import contextlib
import io
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dlwpredict.batch.chain import Chain, Command, Said, Step, perform
from dlwpredict.batch.manifest import Structure, read_manifest
from dlwpredict.batch.workers import work
from dlwpredict.cli import options
from dlwpredict.cli.commands import imported
from dlwpredict.cli.console import counted, say, warn
from dlwpredict.cli.large import Scheduler
from dlwpredict.cli.streams import STANDARD, tell
from dlwpredict.errors import InputError, InterruptionError, blaming
from dlwpredict.numerics.parallel import cores

if TYPE_CHECKING:
    from typer._click.exceptions import UsageError
else:
    UsageError = typer.BadParameter.__base__  # typer does not give it a name

COMMAND = "batch"
FIGURES = True

COMMANDS = ("align", "calibrate", "convert", "diagnose", "export-stl", "precompensate", "predict", "score")
_alone = threading.Lock()


def run(
    manifest: Annotated[Path, typer.Argument(help="Structures and commands (YAML).", show_default=False)],
    scheduler: Scheduler = None,
    jobs: Annotated[
        int | None,
        typer.Option("--jobs", help="Structures at once on this machine; as many as cores if absent.", min=1),
    ] = None,
    overwrite: options.Overwrite = False,
) -> None:
    """Put many structures through the same commands; what is finished, from the same inputs, is not done again.

    $ dlwpredict batch manifest.yaml
    """
    folder = manifest.resolve().parent
    chains = chains_of(manifest, folder, overwrite=overwrite)
    done: dict[str, list[Step]] = {}
    try:
        with counted("batch", "structures", len(chains)) as show:
            for chain, result in work(perform, chains, processes=jobs or cores(), scheduler=scheduler):
                done[chain.name] = _died(chain, result) if isinstance(result, Exception) else result
                show(len(done), len(chains))
    except KeyboardInterrupt:
        raise InterruptionError(
            f"interrupted after {len(done)} of {len(chains)} structures",
            where=manifest,
            allowed="the same command goes on",
        ) from None
    _tell(chains, done)
    if any(step.state == "failed" for steps in done.values() for step in steps):
        raise typer.Exit(1)


def chains_of(manifest: Path, folder: Path, *, overwrite: bool = False) -> list[Chain]:
    """Read a manifest and check every command line, before any work is done.

    Raises
    ------
    InputError
        What `read_manifest` refuses, a wrong command line, or a file that would be written twice or over an input.
    """
    structures = read_manifest(manifest)
    with blaming(manifest):
        chains = [
            Chain(
                structure.name,
                folder,
                tuple(command_of(line, n, overwrite) for n, line in enumerate(structure.lines)),
                call,
            )
            for structure in structures
        ]
        _check_files(chains, structures, folder)
    return chains


def command_of(words: tuple[str, ...], number: int, overwrite: bool) -> Command:
    """Return a command line with the files that it reads and writes.

    Raises
    ------
    InputError
        Not a command for a batch, a wrong call, or one that leaves no file.
    """
    key = f"commands[{number}]"
    if words[0] not in COMMANDS:
        raise InputError(f"found {words[0]}", key=key, allowed=f"allowed: {', '.join(COMMANDS)}")
    try:
        values = _parsed(words)
    except UsageError as error:
        raise InputError(f"{words[0]}: {error.format_message().rstrip('.')}", key=key) from None
    given = {name: paths for name, value in values.items() if (paths := options.paths_of(value))}
    written = ("target", *options.OUTPUTS) if words[0] == "convert" else options.OUTPUTS
    outputs = [path for name in sorted(given, key=_rank) if name in written for path in given[name]]
    inputs = [path for name in given if name not in written for path in given[name]]
    if not outputs or Path(STANDARD) in outputs:
        raise InputError(f"{words[0]} leaves no file", key=key, allowed="name an output (score: --json FILE)")
    return Command(words, tuple(inputs), tuple(outputs), overwrite)


def _rank(name: str) -> int:
    return options.OUTPUTS.index(name) if name in options.OUTPUTS else 0


def _parsed(words: tuple[str, ...]) -> dict[str, Any]:
    """Return the values of a command line by the name of their parameter."""
    # the program collects its commands, this one among them
    from dlwpredict.cli.app import app

    around = typer.main.get_command(app).make_context("dlwpredict", [words[0]])
    try:
        values = imported(words[0]).make_context(words[0], options.joined_pairs(list(words[1:])), parent=around).params
    except typer.Exit:
        raise typer.BadParameter("--help is no work") from None
    return values


def _check_files(chains: list[Chain], structures: list[Structure], folder: Path) -> None:
    """Refuse two commands that write one file, and a command that writes over what was given."""
    writers: dict[Path, str] = {}
    given: set[Path] = set()
    for chain in chains:
        for number, command in enumerate(chain.commands):
            given |= {path for name in command.inputs if (path := (folder / name).resolve()) not in writers}
            for name in command.outputs:
                path, key = (folder / name).resolve(), f"commands[{number}]"
                if path in writers:
                    raise InputError(
                        f"{name} would be written for {writers[path]} and for {chain.name}",
                        key=key,
                        allowed="outputs with {name} in them, each once",
                    )
                writers[path] = chain.name
    for chain in chains:
        for number, command in enumerate(chain.commands):
            for name in command.outputs:
                if (folder / name).resolve() in given:
                    raise InputError(
                        f"{name} is read too, for {chain.name}", key=f"commands[{number}]", allowed="another name"
                    )


def call(words: tuple[str, ...], folder: Path) -> Said:
    """Run the program in a folder, in this process; one call at a time: folder and streams are the process's."""
    from dlwpredict.cli.app import app

    errors = io.StringIO()
    with (
        _alone,
        contextlib.chdir(folder),
        contextlib.redirect_stderr(errors),
        contextlib.redirect_stdout(io.StringIO()),
    ):
        try:
            code = typer.main.get_command(app).main(list(words), prog_name="dlwpredict", standalone_mode=False) or 0
        except UsageError as error:
            code, errors = 2, io.StringIO(f"error: {error.format_message()}\n")
        except Exception as error:  # a fault of the program must not stop the other structures
            code, errors = 1, io.StringIO(f"error: fault of the program: {type(error).__name__}: {error}\n")
    if code == InterruptionError.exit_code:
        raise KeyboardInterrupt
    said = errors.getvalue().splitlines()
    warnings = tuple(line.removeprefix("warning: ") for line in said if line.startswith("warning: "))
    faults = [line.removeprefix("error: ") for line in said if line.startswith("error: ")]
    return Said(code, warnings, faults[-1] if faults else f"ended with code {code}" if code else "")


def _died(chain: Chain, error: Exception) -> list[Step]:
    first = Step(chain.commands[0].words[0], "failed", (str(error),))
    return [first, *(Step(command.words[0], "not run") for command in chain.commands[1:])]


def _tell(chains: list[Chain], done: dict[str, list[Step]]) -> None:
    """Print the table, the warnings and the errors, in the order of the manifest."""
    rows = [["structure", *(command.words[0] for command in chains[0].commands)]]
    for chain in chains:
        rows.append([chain.name, *(step.state for step in done[chain.name])])
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    for row in rows:
        say("  ".join(f"{text:<{width}}" for text, width in zip(row, widths, strict=True)).rstrip())
    for chain in chains:
        for step in done[chain.name]:
            for text in step.said:
                if step.state == "failed":
                    typer.echo(f"error: {chain.name}: {step.command}: {text}", err=True)
                else:
                    warn(f"{chain.name}: {step.command}: {text}")
    failed = sum(any(step.state == "failed" for step in steps) for steps in done.values())
    before = sum(all(step.state == "finished before" for step in steps) for steps in done.values())
    counts = {"done": len(chains) - failed - before, "finished before": before, "failed": failed}
    states = {
        chain.name: [{"command": step.command, "state": step.state, "said": step.said} for step in done[chain.name]]
        for chain in chains
    }
    tell({"structures": states, **{key.replace(" ", "_"): count for key, count in counts.items()}})
    say(f"{len(chains)} structures: {', '.join(f'{count} {key}' for key, count in counts.items())}")

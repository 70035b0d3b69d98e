"""``dlwpredict diagnose``: what the model lacks, where it shows, and whether the data can know."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from dlwpredict.cli import options
from dlwpredict.cli.anytime import LIMIT, TIME, ending
from dlwpredict.cli.console import warn
from dlwpredict.cli.plotting import Plot, check_plot
from dlwpredict.cli.session import Inputs, Outputs, Session, is_unfinished
from dlwpredict.diagnosis.answer.halves import require_enough
from dlwpredict.errors import InputError, InterruptionError
from dlwpredict.metrology.walls import WALL_PX
from dlwpredict.numerics.parallel import cores_for_workers, end_workers

COMMAND = "diagnose"
CLASS = options.PairCommand
STREAMS = {"output": ".yaml"}
FIGURES = True


def run(
    pair: options.Pairs,
    output: options.Output,
    parameters: options.Parameters = None,
    params_out: Annotated[Path | None, typer.Option(help="Parameter file with the effects found.")] = None,
    maps: Annotated[Path | None, typer.Option(help="Folder for the maps of every pair.")] = None,
    report: Annotated[Path | None, typer.Option(help="The diagnosis as one HTML page.")] = None,
    plot: Plot = None,
    holdout: options.Holdouts = None,
    repeat: options.Repeats = None,
    advice: Annotated[
        bool, typer.Option("--advice/--no-advice", help="Simulate the recordings that would tell look-alikes apart.")
    ] = True,
    reproducible: Annotated[
        bool,
        typer.Option("--reproducible", help="Diagnose ten halves of four or more recordings: do they agree?"),
    ] = False,
    wall_px: Annotated[int, typer.Option(help="Points this near to walls do not count.", min=0, max=10_000)] = WALL_PX,
    working_pitch_um: Annotated[
        float | None,
        typer.Option(help="Average pixels to about this pitch; if absent, what the focus allows.", **options.LENGTH),
    ] = None,
    time_limit: Annotated[
        float | None, typer.Option(help="End after this time with the best answer so far: 90s, 5m, 1.5h.", **TIME)
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from where an interrupted run has ended.")] = False,
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
    overwrite: options.Overwrite = False,
) -> None:
    """Say what physics the model lacks, where it shows, and how much better the prediction gets with it.

    $ dlwpredict diagnose --pair cin.tif cin_aligned.tif --pair air.tif air_aligned.tif -o diagnosis.yaml

    Ctrl-C ends it in good order with the best answer so far, --resume goes on from there.
    """
    if working_pitch_um is not None and not working_pitch_um > 0:
        raise InputError(f"found {working_pitch_um:g}", key="--working-pitch-um", allowed="allowed: above 0")
    if reproducible:
        require_enough(len(pair) // 2)
    outputs, session = Outputs(output, params_out, maps, report, plot), None
    with ending(time_limit) as end:
        end.waits = True
        try:
            replaced = overwrite or (resume and is_unfinished(output))
            options.check_outputs(output, params_out, report, plot, overwrite=replaced)
            check_plot(plot)
            _check_maps(maps, overwrite=replaced)
            inputs = Inputs(
                options.pairs_of(pair),
                options.pairs_of(holdout or [], "--holdout"),
                options.pairs_of(repeat or [], "--repeat"),
                parameters,
                wall_px,
                working_pitch_um,
            )
            session = Session.of(inputs, outputs, seed=seed)
            session.begin(jobs or cores_for_workers(), resume=resume)
            end.waits, session.work.stop = False, end.stop
            end.stop()
            session.search(advice=advice, reproducible=reproducible)
        except KeyboardInterrupt:
            end_workers()
        end.closed = True
        if session:
            session.close(end.cause)
        else:
            warn(f"ended by {end.cause} before all files were read: nothing is written")
    if end.cause not in ("", LIMIT):
        raise typer.Exit(InterruptionError.exit_code)
    if session:
        session.require_outputs()


def _check_maps(maps: Path | None, *, overwrite: bool) -> None:
    """Refuse a folder for maps that cannot be made or written to, or holds anything."""
    if maps and maps.parent.is_dir() and not os.access(maps if maps.is_dir() else maps.parent, os.W_OK | os.X_OK):
        raise InputError("folder cannot be written to", where=maps, key="--maps", allowed="another folder")
    if maps and not maps.parent.is_dir():
        raise InputError("folder does not exist", where=maps, key="--maps", allowed=f"create {maps.parent} first")
    if maps and maps.exists() and not (maps.is_dir() and (overwrite or not any(maps.iterdir()))):
        raise InputError("exists already", where=maps, key="--maps", allowed="an empty or new folder, or --overwrite")

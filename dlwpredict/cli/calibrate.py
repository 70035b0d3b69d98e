"""``dlwpredict calibrate``: the process parameters from pairs of target and recording."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from dlwpredict.api.calibrate import calibrate
from dlwpredict.calibration.report import report_of
from dlwpredict.calibration.words import cautions_of
from dlwpredict.cli import options
from dlwpredict.cli.console import detail, progress_shown, say, warn
from dlwpredict.cli.pairs import read_pair
from dlwpredict.cli.plotting import Plot, check_plot, draw
from dlwpredict.cli.streams import tell
from dlwpredict.errors import InputError, InterruptionError, blaming
from dlwpredict.files.atomic import write_text
from dlwpredict.files.parameters_yaml import read_parameters, write_parameters
from dlwpredict.files.provenance import with_cautions
from dlwpredict.files.yaml_text import yaml_text
from dlwpredict.infer.free import choose
from dlwpredict.infer.objective import Fit, Work
from dlwpredict.metrology.walls import WALL_PX
from dlwpredict.pairing import Pair
from dlwpredict.parameters import ParameterSet

COMMAND = "calibrate"
CLASS = options.PairCommand
STREAMS = {"output": ".yaml", "report": ".yaml"}
FIGURES = True


class Method(StrEnum):
    """How to descend."""

    fast = "fast"
    simplex = "simplex"


class LossKind(StrEnum):
    """What a residual costs."""

    robust = "robust"
    square = "square"


def run(
    pair: options.Pairs,
    output: options.Output,
    parameters: options.Parameters = None,
    method: Annotated[
        Method, typer.Option(help="Most likely parameters, or the paper's: lowest rmse by Downhill Simplex.")
    ] = Method.fast,
    loss: Annotated[LossKind, typer.Option(help="Leave out spikes, or none.")] = LossKind.robust,
    fix: Annotated[
        list[str] | None, typer.Option(help="Hold this parameter at its start value.", metavar="NAME")
    ] = None,
    free: Annotated[
        list[str] | None, typer.Option(help="Fit this parameter, and only those freed.", metavar="NAME")
    ] = None,
    free_shift: Annotated[
        bool,
        typer.Option("--free-shift/--fixed-shift", help="Let recordings be free to lie a little off."),
    ] = True,
    priors: Annotated[
        bool,
        typer.Option("--priors/--no-priors", help="Use what is known beforehand, or data alone."),
    ] = True,
    wall_px: Annotated[int, typer.Option(help="Points this near to walls do not count.", min=0, max=10_000)] = WALL_PX,
    working_pitch_um: Annotated[
        float | None,
        typer.Option(
            help="Pixels that the fit works on; chosen by what focus and noise allow if absent.", **options.LENGTH
        ),
    ] = None,
    profile: Annotated[
        bool, typer.Option("--profile", help="Likelihood profile for every weakly known parameter, not just the worst.")
    ] = False,
    report: Annotated[Path | None, typer.Option(help="All figures (.yaml or .json).")] = None,
    plot: Plot = None,
    seed: options.Seed = 0,
    overwrite: options.Overwrite = False,
) -> None:
    """Fit one set of process parameters to all recordings, with 95 % intervals and what the data leave open.

    $ dlwpredict calibrate --pair cin.tif cin_aligned.tif --pair air.tif air_aligned.tif -o process.yaml
    """
    options.check_outputs(output, report, plot, overwrite=overwrite)
    check_plot(plot)
    if report and report.suffix not in (".yaml", ".yml", ".json"):
        raise InputError(
            f"found {report.suffix or 'no ending'}", where=report, key="--report", allowed="allowed: .yaml, .json"
        )
    pairs = options.pairs_of(pair)
    start = read_parameters(parameters)
    chosen: dict[str, Any] = {"fix": fix or (), "free": free or ()}
    with blaming(parameters or "calibrate"):
        choose(start, **chosen)
    if working_pitch_um is not None and not working_pitch_um > 0:
        raise InputError(f"found {working_pitch_um:g}", key="--working-pitch-um", allowed="allowed: above 0")
    pixels_um = working_pitch_um if method is Method.fast else 0.0
    reading = {"wall_px": wall_px, "free_shift": free_shift, "working_pitch_um": pixels_um, "large_px": math.inf}
    recorded = [_read(files, start, **reading) for files in pairs]
    with _progress() as show, _rescued(output) as watch:

        def seen(fit: Fit) -> None:
            watch(fit)
            show(fit)

        calibration = calibrate(
            recorded,
            start,
            **chosen,
            method=method.value,
            robust=loss is LossKind.robust,
            priors=priors,
            profile=True if profile else None,
            seed=seed,
            work=Work(seen=seen),
        )
    stated = with_cautions(cautions_of([pair.native for pair in recorded]))  # that of the start is not its own
    write_parameters(output, replace(calibration.parameters, provenance=stated))
    figures = report_of(calibration)
    if report:
        write_text(report, json.dumps(figures, ensure_ascii=False) if report.suffix == ".json" else yaml_text(figures))
    errors = f"rmse {calibration.start.rmse_um():.4f} → {calibration.end.rmse_um():.4f} µm"
    rows = [(one.name, one.target, *calibration.maps(k)) for k, one in enumerate(calibration.recordings)]
    draw(plot, lambda plots: plots.calibration(rows, caption=errors))
    say(f"{output}: {calibration.summary()}")
    for text in calibration.warnings:
        warn(text)
    tell(figures)


def _read(files: tuple[Path, Path], start: ParameterSet, **settings: Any) -> Pair:
    pair = read_pair(files, start, **settings)
    measured = pair.native.measured
    detail(f"{files[1]}: {pair.native.points} of {measured.heights_um.size} points count ({measured.height_reference})")
    return pair


@contextmanager
def _progress() -> Iterator[Callable[[Fit], None]]:
    """Show predictions and rmse while the fit runs, on a terminal only."""
    if not progress_shown():
        yield lambda fit: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = TextColumn("calibrating"), BarColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task, lowest = bar.add_task("", total=None), [float("inf")]

        def show(fit: Fit) -> None:
            lowest[0] = min(lowest[0], fit.rmse_um())
            bar.update(task, description=f"rmse {lowest[0]:.4f} µm")

        yield show


@contextmanager
def _rescued(output: Path) -> Iterator[Callable[[Fit], None]]:
    """Keep the best point so far; on Ctrl-C write it beside the output under a ``.partial`` name."""
    best: list[tuple[float, Fit]] = []

    def watch(fit: Fit) -> None:
        rmse_um = fit.rmse_um()
        if not best or rmse_um < best[0][0]:
            best[:] = [(rmse_um, fit)]

    try:
        yield watch
    except KeyboardInterrupt:
        if not best:
            raise InterruptionError("interrupted before the first prediction", where=output) from None
        partial = output.with_name(f"{output.stem}.partial{output.suffix}")
        write_parameters(partial, best[0][1].parameters)
        raise InterruptionError("interrupted", where=output, allowed=f"best so far is in {partial}") from None

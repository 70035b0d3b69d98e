"""``dlwpredict precompensate``: what to write so that the print has the target's heights."""

from __future__ import annotations

from enum import StrEnum
from functools import partial
from math import inf
from pathlib import Path
from typing import Annotated

import typer

from dlwpredict.api.precompensate import precompensate
from dlwpredict.cli import options
from dlwpredict.cli.console import detail, say, warn
from dlwpredict.cli.plotting import Plot, check_plot, draw
from dlwpredict.cli.streams import tell
from dlwpredict.correction.limits import HIGHEST, Limits
from dlwpredict.correction.precompensate import LAST, Precompensation, steps_um
from dlwpredict.correction.printable import Printable
from dlwpredict.correction.sides import Stake, stakes
from dlwpredict.correction.surround import doubt_of_edges
from dlwpredict.errors import InputError, blaming
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.atomic import write_text
from dlwpredict.files.formats import format_of
from dlwpredict.files.parameters_yaml import read_parameters
from dlwpredict.files.plausibility import unusual_height
from dlwpredict.files.provenance import cautions_of
from dlwpredict.files.yaml_text import yaml_text
from dlwpredict.process import check_target

COMMAND = "precompensate"
STREAMS = {"report": ".yaml"}
FIGURES = True


LARGE = 0.05
"""Share of the first error above which what is left within reach is worth a warning."""


class Loop(StrEnum):
    """How steps are chosen."""

    accelerated = "accelerated"
    paper = "paper"


class Side(StrEnum):
    """Where an effect that could be either happens."""

    print = "print"
    measurement = "measurement"


def run(
    target: Annotated[Path, typer.Argument(help="Height map that the print shall have.", show_default=False)],
    output: options.Output,
    parameters: options.Parameters = None,
    report: Annotated[Path | None, typer.Option(help="Figures of the correction (YAML).")] = None,
    unreachable: Annotated[
        Path | None, typer.Option(help="Map of the height missing where no correction reaches, µm.")
    ] = None,
    method: Annotated[Loop, typer.Option(help="Accelerated loop, or the paper's plain one.")] = Loop.accelerated,
    maximum_um: Annotated[
        float | None,
        typer.Option(
            help=f"Highest height that may be written; {HIGHEST:g} times the target's if absent.", **options.LENGTH
        ),
    ] = None,
    surround: options.SurroundOption = None,
    smooth_um: Annotated[
        float, typer.Option(help="Smooth the correction by a Gaussian of this FWHM; 0 = not.", **options.LENGTH)
    ] = 0.0,
    max_slope: Annotated[
        float | None,
        typer.Option(help="Steepest slope to be written, µm/µm, where the target is no steeper itself.", min=1e-3),
    ] = None,
    smallest_feature_um: Annotated[
        float,
        typer.Option(help="Leave out hills and pits of the correction that are narrower; 0 = none.", **options.LENGTH),
    ] = 0.0,
    slicing_um: Annotated[
        float | None,
        typer.Option(
            help="Round to multiples of this; the parameter file's slicing if absent, 0 = no rounding.",
            **options.LENGTH,
        ),
    ] = None,
    predictions: Annotated[int, typer.Option(help="Predictions allowed in the search.", min=2)] = 10,
    undecided: Annotated[
        Side | None,
        typer.Option(help="Where effects happen that the parameter file cannot place: only the print's are corrected."),
    ] = None,
    plot: Plot = None,
    overwrite: options.Overwrite = False,
) -> None:
    """Correct a target so that its print has the target's heights; print effects only, never measurement effects.

    $ dlwpredict precompensate target.tif -p process.yaml -o corrected.tif --report pre.yaml
    """
    options.check_outputs(output, report, unreachable, plot, overwrite=overwrite)
    check_plot(plot)
    with blaming(output):
        format_of(output, "write")
    process = read_parameters(parameters)
    for caution in cautions_of(process.provenance):
        warn(f"{parameters}: {caution}")
    part = read_height_map(target)
    for doubt in unusual_height(part):
        warn(f"{target}: {doubt}")
    with blaming(target):
        check_target(part)
    slicing = process.writing.slicing_um if slicing_um is None else slicing_um
    shape = Printable(smooth_um, inf if max_slope is None else max_slope, smallest_feature_um)
    limits = Limits.about(part, maximum_um, slicing_um=slicing, printable=shape)
    corrected = partial(
        precompensate,
        limits=limits,
        continued=surround is options.Surround.continued,
        most_predictions=predictions,
        memory=5 if method is Loop.accelerated else 0,
        on_step=lambda count, rmse: detail(f"prediction {count}: rmse {rmse:.4f} µm"),
    )
    with blaming(target):
        if process.undecided and undecided is None:
            for stake in stakes(part, process, corrected):
                say(_told(stake))
            raise InputError(
                f"print or measurement is open for {', '.join(process.undecided.effects)}",
                where=parameters,
                key="undecided",
                allowed="allowed: --undecided print or --undecided measurement",
            )
        correction = corrected(part, process if undecided is None else process.decided(undecided.value))
    figures = correction.as_dict()
    if process.undecided and undecided is not None:
        figures["undecided"] = undecided.value
    if unreachable:
        write_height_map(unreachable, part.with_heights(correction.missing_um))
    if report:
        write_text(report, yaml_text(figures))
    write_height_map(output, correction.corrected)
    errors = " → ".join(f"{figures['rmse_um'][when]:.4f}" for when in ("before", "after"))
    shown = part, correction.corrected, correction.predicted, correction.reachable
    draw(plot, lambda plots: plots.correction(*shown, caption=f"rmse {errors} µm"))
    tell(figures)
    say(f"{output}: {correction.summary()}")
    for doubt in doubt_of_edges(part) if surround is None else ():
        warn(f"{target}: {doubt}")
    if maximum_um is None and correction.capped_points:
        warn(
            f"{output}: {correction.capped_points} points stand at {limits.maximum_um:.4g} µm, {HIGHEST:g} times the "
            "target's height, the most that is written: --maximum-um allows more"
        )
    if not smooth_um and (step := steps_um(part)):
        warn(
            f"{target}: the design comes in steps of {step:g} µm: --smooth-um keeps the correction from following "
            "each as a wall"
        )
    if (left := figures["reachable"]["largest_to_initial"]) > LARGE:
        warn(f"stopped at {100 * left:.0f} % of the first error: {why(correction)}")


def why(correction: Precompensation) -> str:
    """Say what leaves an error where the target is within reach."""
    if correction.largest_unrounded_um <= LARGE * correction.history[0]["largest_um"]:
        return f"heights are rounded to slices of {correction.limits.slicing_um:g} µm (--slicing-um)"
    if correction.still_falling:
        return "allow more --predictions"
    return f"the last {LAST} of {correction.predictions} predictions gained nothing, more will not"


def _told(stake: Stake) -> str:
    """Say what a choice of side would correct, and how the print would come out if it is wrong."""
    return (
        f"--undecided {stake.side}: rmse {stake.rmse_um:.4f} µm, {stake.wrong_um:.4f} µm if it is {stake.other}; "
        f"corrected target up to {stake.apart_um:.4f} µm (rms {stake.apart_rms_um:.4f} µm) from the other"
    )

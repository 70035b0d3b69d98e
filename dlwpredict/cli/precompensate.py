"""``dlwpredict precompensate``: what to write so that the print has the target's heights."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from dlwpredict.cli import options
from dlwpredict.cli.console import detail, say, warn
from dlwpredict.errors import blaming
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.atomic import write_text
from dlwpredict.files.parameters_yaml import read_parameters
from dlwpredict.files.yaml_text import yaml_text
from dlwpredict.precompensate import Limits, precompensate
from dlwpredict.process import predict

COMMAND = "precompensate"


class Loop(StrEnum):
    """How steps are chosen."""

    accelerated = "accelerated"
    paper = "paper"


def run(
    target: Annotated[Path, typer.Argument(help="Height map that the print shall have.", show_default=False)],
    output: options.Output,
    parameters: options.Parameters = None,
    report: Annotated[Path | None, typer.Option(help="Figures of the correction (YAML).")] = None,
    unreachable: Annotated[
        Path | None, typer.Option(help="Map of the height missing where no correction reaches, µm.")
    ] = None,
    method: Annotated[Loop, typer.Option(help="Accelerated loop, or the paper's plain one.")] = Loop.accelerated,
    maximum_um: Annotated[float, typer.Option(help="Highest height that may be written, µm.")] = np.inf,
    slicing_um: Annotated[
        float | None,
        typer.Option(help="Round to multiples of this; the parameter file's slicing if absent, 0 = no rounding."),
    ] = None,
    predictions: Annotated[int, typer.Option(help="Predictions allowed in the search.", min=2)] = 10,
    overwrite: options.Overwrite = False,
) -> None:
    """Correct a target so that its print has the target's heights; print effects only, never measurement effects.

    $ dlwpredict precompensate target.tif -p process.yaml -o corrected.tif --report pre.yaml
    """
    options.check_outputs(output, report, unreachable, overwrite=overwrite)
    process = read_parameters(parameters)
    part = read_height_map(target)
    limits = Limits(maximum_um, process.writing.slicing_um if slicing_um is None else slicing_um)
    with blaming(target):
        found = precompensate(
            part,
            lambda written: predict(written, process),
            limits=limits,
            most_predictions=predictions,
            memory=5 if method is Loop.accelerated else 0,
            on_step=lambda count, rmse: detail(f"prediction {count}: rmse {rmse:.4f} µm"),
        )
    figures = found.summary()
    if unreachable:
        write_height_map(unreachable, part.with_heights(np.where(found.reachable, 0.0, found.error_um)))
    if report:
        write_text(report, yaml_text(figures))
    write_height_map(output, found.corrected)
    reached, missed = figures["reachable"], figures["unreachable"]
    say(
        f"{output}: rmse {figures['rmse_um']['before']:.4f} -> {figures['rmse_um']['after']:.4f} µm in "
        f"{found.predictions} predictions; where reachable ({100 * reached['fraction']:.1f} % of the part) at most "
        f"{reached['largest_um']:.4f} µm"
    )
    if missed["points"]:
        say(
            f"out of reach: {missed['points']} points at walls or finer than the focus, rmse {missed['rmse_um']:.3f} µm"
        )
    if reached["largest_to_initial"] > 0.05:
        warn(f"stopped at {100 * reached['largest_to_initial']:.0f} % of the first error; allow more --predictions")

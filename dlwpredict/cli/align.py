"""``align``: bring a recording onto its target's grid."""

from __future__ import annotations

from collections.abc import Mapping
from math import hypot
from pathlib import Path
from typing import Annotated, Literal

import typer
import yaml

from dlwpredict.alignment.choose import ODDS, odds
from dlwpredict.api.align import align
from dlwpredict.cli.console import detail, say, warn
from dlwpredict.cli.options import FastAxis, InstrumentKind, Output, Overwrite, check_outputs, recorded_by
from dlwpredict.cli.plotting import Plot, check_plot, draw
from dlwpredict.cli.streams import tell
from dlwpredict.errors import InputError
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.atomic import write_text
from dlwpredict.infer.priors import CERTIFIED

COMMAND = "align"
STREAMS = {"report": ".yaml"}
FIGURES = True

WRONG_PITCH = 0.05
"""No part that its base holds and no calibrated instrument differs from the target by this share sideways."""

SURELY = 3.0
"""Standard deviations beyond what the certificate of a pixel pitch leaves open that are said."""


def run(
    recording: Annotated[Path, typer.Argument(help="Recording: a height map from the microscope.")],
    target: Annotated[Path, typer.Argument(help="Target: the height map that was to be printed.")],
    output: Output,
    report: Annotated[Path | None, typer.Option("--report", help="Figures and uncertainties (YAML).")] = None,
    distortion: Annotated[
        Literal["auto", "rigid", "affine", "bow", "cubic"],
        typer.Option("--distortion", help="Lateral mapping; auto: as much as a test finds."),
    ] = "auto",
    allow_mirror: Annotated[
        bool, typer.Option("--allow-mirror", help="Turn a mirrored recording back instead of refusing it.")
    ] = False,
    keep_missing: Annotated[
        bool, typer.Option("--keep-missing", help="Leave points that were not measured empty (NaN).")
    ] = False,
    known_part: Annotated[
        bool, typer.Option("--known-part", help="Take the best pose also where nothing proves that this is the part.")
    ] = False,
    instrument: InstrumentKind = None,
    fast_axis_deg: FastAxis = None,
    plot: Plot = None,
    overwrite: Overwrite = False,
) -> None:
    """Find the target in a recording, resample it onto the target's grid and level it.

    $ dlwpredict align recording.tif target.tif -o aligned.tif --report align.yaml
    """
    check_outputs(output, report, plot, overwrite=overwrite)
    check_plot(plot)
    seen = recorded_by(read_height_map(recording), instrument, fast_axis_deg)
    maps = seen, read_height_map(target)
    try:
        alignment = align(
            *maps,
            distortion=distortion,
            allow_mirror=allow_mirror,
            keep_missing=keep_missing,
            known_part=known_part,
        )
    except InputError as error:
        files = {"target": str(target), "recording": str(recording)}
        raise type(error)(
            error.what, where=files.get(error.where, error.where), key=error.key, allowed=error.allowed
        ) from None
    write_height_map(output, alignment.aligned)
    if report is not None:
        write_text(report, yaml.safe_dump(alignment.as_dict(), sort_keys=False))
    names = "target", "aligned recording"
    draw(plot, lambda plots: plots.comparison(maps[1], alignment.aligned, names=names, caption=alignment.summary()))
    strain = max(abs(scale - 1) for scale in alignment.pose.scale)
    if strain > WRONG_PITCH:
        warn(f"{recording}: scale off by {100 * strain:.0f} %: is its pixel pitch right (convert --pitch-um)?")
    else:
        scales = zip("xy", alignment.pose.scale, alignment.uncertainty["scale"], strict=True)
        off = {axis: scale for axis, scale, sd in scales if abs(scale - 1) > SURELY * hypot(CERTIFIED, sd)}
        for axis, scale in off.items():
            said = f"{abs(100 * (scale - 1)):.2g} % {'narrower' if scale < 1 else 'wider'}"
            leaves = "more than a certified pitch leaves open; it is taken out here"
            warn(f"{recording}: {said} than the target along {axis}, {leaves}")
        if 1 - alignment.aligned.instrument.scale > CERTIFIED:
            left = "diagnose leaves that open; where the microscope's scale is known, use --distortion rigid"
            warn(f"{recording}: a print that shrinks sideways is so too: {left}")
    for name, test in alignment.distortion_test.items():
        if test["untold"]:
            said = f"{test['untold_px']:.2g} pixels at the rim may be the print's own form as well, and stay in it"
            warn(f"{recording}: {name}: {said}; --distortion {name} takes them out")
    if alignment.symmetry.endswith("fold"):
        warn(f"{target}: {alignment.symmetry} symmetry: of the equal rotations the smallest was taken")
    if alignment.symmetry == "round":
        warn(f"{target}: round: the rotation is open and was left at 0")
    if alignment.quality["match_log_odds"] < ODDS:
        said = odds(alignment.quality["match_log_odds"])
        warn(f"{recording}: nothing proves that it shows {target} (odds {said}): taken as known (--known-part)")
    if alignment.aligned.height_reference == "relative":
        warn(f"{output}: no substrate in view, heights are relative")
    say(f"{output}: {alignment.summary()}")
    tell(alignment.as_dict())
    for name, test in alignment.distortion_test.items():
        detail(f"{name}: {_listed(test)}")
    detail(f"quality: {_listed(alignment.quality)}")


def _listed(figures: Mapping[str, float | bool]) -> str:
    """Return figures in words, numbers to four digits."""
    said = {
        name: {True: "yes", False: "no"}[value] if isinstance(value, bool) else f"{value:.4g}"
        for name, value in figures.items()
    }
    return ", ".join(f"{name} {value}" for name, value in said.items())

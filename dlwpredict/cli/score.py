"""``dlwpredict score``: how alike two surfaces are."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from dlwpredict.cli import options
from dlwpredict.cli.console import say, warn
from dlwpredict.errors import InputError, blaming
from dlwpredict.files import read_height_map
from dlwpredict.files.atomic import write_text
from dlwpredict.heightmap import require_same_grid
from dlwpredict.score import MATERIAL_RATIO_RANGE, Score, score
from dlwpredict.transfer import HALF, Transfer, transfer

COMMAND = "score"
STREAMS = {"json_file": ".json"}


def run(
    reference: Annotated[Path, typer.Argument(help="Height map to compare with.", show_default=False)],
    test: Annotated[Path, typer.Argument(help="Height map to judge, on the same grid.", show_default=False)],
    json_file: Annotated[
        Path | None, typer.Option("--json", "-o", "--output", help="Write all figures as JSON.", show_default=False)
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option("--plot", help="Draw maps, difference and profiles (.png, .pdf, .svg).", show_default=False),
    ] = None,
    material_ratio: Annotated[
        tuple[float, float], typer.Option(help="Material ratios between which alpha_z and l_z are taken.")
    ] = MATERIAL_RATIO_RANGE,
    part_only: Annotated[
        bool, typer.Option("--part-only", help="Leave out bare substrate: points where the reference is 0 or less.")
    ] = False,
    include_filled: Annotated[
        bool, typer.Option("--include-filled", help="Let filled (interpolated) points enter as well.")
    ] = False,
    transfer_function: Annotated[
        bool, typer.Option("--transfer", help="Amplitude transfer against period; the reference is a cin target.")
    ] = False,
    transfer_plot: Annotated[
        Path | None, typer.Option(help="Draw the transfer (.png, .pdf, .svg).", show_default=False)
    ] = None,
    overwrite: options.Overwrite = False,
) -> None:
    """Compare a height map with its reference: deviations, correlation, roughness, height response.

    Points that are not measured, or were filled, in either map are left out.

    $ dlwpredict score target.tif aligned.tif --part-only --json score.json --plot score.png
    """
    options.check_outputs(json_file, plot, transfer_plot, overwrite=overwrite)
    for option, picture in (("--plot", plot), ("--transfer-plot", transfer_plot)):
        if picture is not None and picture.suffix.lower() not in (".png", ".pdf", ".svg"):
            raise InputError(
                f"ends in {picture.suffix or 'nothing'}", where=picture, key=option, allowed="allowed .png .pdf .svg"
            )
    maps = read_height_map(reference), read_height_map(test)
    require_same_grid(*maps, names=(str(reference), str(test)))
    with blaming(test):
        result = score(*maps, material_ratio_range=material_ratio, part_only=part_only, include_filled=include_filled)
    figures: dict[str, Any] = asdict(result)
    found: dict[str, Transfer] = {}
    if transfer_function or transfer_plot:
        with blaming(reference):
            found = transfer(*maps, include_filled=include_filled)
        figures["transfer"] = {axis: asdict(one) for axis, one in found.items()}
    if transfer_plot is not None:
        from dlwpredict.plots import save
        from dlwpredict.transfer_plot import transfer_curves

        save(transfer_plot, transfer_curves(found, title=f"{test.stem} against {reference.stem}"))
    if plot is not None:
        from dlwpredict import plots

        figure = plots.comparison(*maps, names=(reference.stem, test.stem), caption=caption(result))
        plots.save(plot, figure)
    if json_file is not None:
        write_text(json_file, json.dumps(figures, indent=2, allow_nan=False) + "\n")
    say(table(result))
    if found:
        say("\n" + transfer_table(found))
    if result.height_reference == "relative":
        warn(f"{test}: heights are relative (no substrate in view); mean_difference_um and rmse_um hold a free offset")


def table(result: Score) -> str:
    """Return all figures as aligned lines."""
    low, high = result.material_ratio_range
    rows = [
        ("rmse", µm(result.rmse_um), f"offset-free {µm(result.rmse_offset_free_um)}"),
        ("mean difference", µm(result.mean_difference_um), "test - reference"),
        ("CC", plain(result.cc), "corr2"),
        ("Sa, Sq, Sz of test", ", ".join(map(µm, (result.sa_um, result.sq_um, result.sz_um))), ""),
        (f"alpha_z, l_z {low:g}-{high:g}", f"{plain(result.alpha_z)}, {µm(result.l_z_um)}", "material ratio"),
        ("alpha_z, l_z 0-1", f"{plain(result.alpha_z_full)}, {µm(result.l_z_full_um)}", "full range"),
        ("points", str(result.points), points_note(result)),
    ]
    first, second = (max(len(row[i]) for row in rows) for i in (0, 1))
    return "\n".join(f"{name:<{first}}  {value:<{second}}  {note}".rstrip() for name, value, note in rows)


def transfer_table(found: dict[str, Transfer]) -> str:
    """Return transfer against period along both axes, and the period at 50 %, as aligned lines."""
    lines = ["transfer  period/µm      T  ± (half the difference of opposite sides)"]
    for axis, one in found.items():
        rows = zip(one.period_um, one.transfer, one.half_difference, strict=True)
        lines += [f"  along {axis}  {period:8.3f}  {value:.3f}  {spread:.3f}" for period, value, spread in rows]
    return "\n".join([*lines, *(f"50 % along {axis}: {half_note(one)}" for axis, one in found.items())])


def half_note(found: Transfer) -> str:
    """Say the period at which half of the amplitude is left, or on which side of the periods it lies."""
    if found.half_period_um is not None:
        return f"{found.half_period_um:.3f} µm"
    if found.transfer[-1] < HALF:
        return f"above {found.period_um[-1]:.3f} µm, the longest period"
    return f"below {found.period_um[0]:.3f} µm, the shortest period"


def points_note(result: Score) -> str:
    """Say which points entered."""
    note = f"{100 * result.valid_fraction:.4g} % of the {result.region}"
    if result.filled_points:
        note += f"; {result.filled_points} filled points {'entered' if result.filled_points_entered else 'left out'}"
    if 0 < result.substrate_fraction < 1:
        note += f"; {100 * result.substrate_fraction:.3g} % bare substrate, which governs Sa to l_z (see --part-only)"
    return note


def caption(result: Score) -> str:
    """Return the main figures in one line."""
    rmse = f"rmse {µm(result.rmse_um)} (offset-free {µm(result.rmse_offset_free_um)})"
    return f"{rmse}     CC {plain(result.cc)}     α$_z$ {plain(result.alpha_z)}     l$_z$ {µm(result.l_z_um)}"


def µm(value: float | None) -> str:
    """Write a length in µm to a tenth of a nanometre."""
    return "undefined" if value is None else f"{value:.4f} µm"


def plain(value: float | None) -> str:
    """Write a number without unit."""
    return "undefined" if value is None else f"{value:.4f}"

"""``dlwpredict convert``: a height map from one file format to another."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from dlwpredict.cli import options
from dlwpredict.cli.console import say, warn
from dlwpredict.cli.plotting import Plot, check_plot, draw
from dlwpredict.cli.streams import figures_of, tell
from dlwpredict.errors import InputError, blaming
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.formats import format_of
from dlwpredict.files.plausibility import plausibility, plausibility_of_pitch, tilt_mrad
from dlwpredict.heightmap import HeightMap
from dlwpredict.metrology.missing import fill_missing
from dlwpredict.metrology.regrid import cropped, resampled, smoothed, widened

COMMAND = "convert"
STREAMS = {"target": ".txt", "output": ".txt"}
FIGURES = True


def run(
    source: Annotated[Path, typer.Argument(metavar="IN", help="Height map to read.", show_default=False)],
    target: Annotated[Path | None, typer.Argument(metavar="OUT", help="Height map to write.")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="OUT, given as an option.")] = None,
    pitch_um: options.PitchUm = None,
    z_scale: options.ZScale = None,
    z_range: options.ZRange = None,
    crop_um: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(
            "--crop",
            metavar="X0 Y0 X1 Y1",
            help="Keep the rectangle between these corners, µm from the centre of the map, y upwards.",
        ),
    ] = None,
    margin_um: Annotated[
        float | None,
        typer.Option(help="Lay bare substrate, height 0, at least so wide around the map.", **options.LENGTH),
    ] = None,
    smooth_um: Annotated[
        float | None,
        typer.Option(help="Smooth by a Gaussian of this FWHM; what was not measured has no say.", **options.LENGTH),
    ] = None,
    resample_um: Annotated[
        float | None,
        typer.Option(help="Pitch of coarser square pixels, each the mean over its area.", **options.LENGTH),
    ] = None,
    fill: options.Fill = None,
    channel: Annotated[
        str | None, typer.Option("--channel", metavar="TITLE|NUMBER", help="Which channel, if IN has several.")
    ] = None,
    instrument: options.InstrumentKind = None,
    fast_axis_deg: options.FastAxis = None,
    plot: Plot = None,
    overwrite: options.Overwrite = False,
) -> None:
    """Convert a height map; the endings decide the formats. --z-range belongs to IN if that is a PNG, else to OUT.

    It is cut first, then given a margin, then smoothed, then resampled.

    $ dlwpredict convert scan.txt scan.tif --pitch-um 0.1 --z-scale 1e6
    """
    named = [path for path in (target, output) if path is not None]
    if len(named) != 1:
        raise typer.BadParameter("give OUT once: as second argument or with -o")
    target = named[0]
    options.check_outputs(target, plot, overwrite=overwrite)
    check_plot(plot)
    with blaming(target):
        writer = format_of(target, "write")
    asked, knobs = _range_where_it_belongs(source, target, z_range)
    height_map = read_height_map(
        source, pitch_um=options.pitch(pitch_um), z_scale=z_scale, z_range_um=asked, channel=channel
    )
    if pitch_um is not None:
        for doubt in _doubts_of_pitch(
            source, height_map, {"z_scale": z_scale, "z_range_um": asked, "channel": channel}
        ):
            warn(f"{source}: {doubt}")
    height_map = options.recorded_by(height_map, instrument, fast_axis_deg)
    tilt = " x ".join(f"{round(slope, 2) + 0:g}" for slope in tilt_mrad(height_map))
    say(f"{source}: {height_map.summary()}, tilt {tilt} mrad")
    for warning in plausibility(height_map):
        warn(f"{source}: {warning}")
    before = height_map
    with blaming(source):
        if crop_um is not None:
            height_map = cropped(height_map, crop_um[::2], crop_um[1::2])
        if margin_um is not None:
            height_map = widened(height_map, margin_um)
        if smooth_um is not None:
            height_map = smoothed(height_map, smooth_um)
        if resample_um is not None:
            height_map = resampled(height_map, resample_um)
    if height_map is not before:
        say(f"worked on: {height_map.summary()}")
    if fill is not None:
        height_map = fill_missing(height_map, fill)
    remarks = write_height_map(target, height_map, **knobs)
    grey = levels(height_map, knobs.get("z_range_um")) if target.suffix.lower() == ".png" else None
    say(f"{target}: {writer.name} written{grey_words(grey)}")
    tell(figures_of(height_map) | ({"grey_levels": grey} if grey else {}))
    name, caption = target.stem, height_map.summary()
    draw(plot, lambda plots: plots.overview(height_map, name=name, caption=caption))
    for remark in remarks:
        warn(f"{target}: {remark}")


def _doubts_of_pitch(source: Path, height_map: HeightMap, settings: dict[str, Any]) -> list[str]:
    """Return a warning where the pitch that was given is not the file's own; none where it says none."""
    try:
        stated = read_height_map(source, **settings)
    except InputError:
        return []
    return plausibility_of_pitch((stated.dx_um, stated.dy_um), (height_map.dx_um, height_map.dy_um))


def levels(height_map: HeightMap, z_range_um: tuple[float, float] | None) -> dict[str, Any]:
    """Return what a grey-scale writer must be told: heights of the lowest and highest level, and one level's, µm."""
    low, high = z_range_um or (float(height_map.heights_um.min()), float(height_map.heights_um.max()))
    return {"level_0_um": low, "level_65535_um": high, "level_um": (high - low) / 65535}


def grey_words(grey: dict[str, Any] | None) -> str:
    """Say the heights of grey levels."""
    if grey is None:
        return ""
    step = 1e3 * grey["level_um"]
    return f", level 0 = {grey['level_0_um']:.6g} µm, 65535 = {grey['level_65535_um']:.6g} µm, {step:.3g} nm each"


def _range_where_it_belongs(source: Path, target: Path, z_range: Any) -> tuple[Any, dict[str, Any]]:
    """Return the range for reading, and what the writer is told."""
    if z_range is None or source.suffix.lower() == ".png":
        return z_range, {}
    if target.suffix.lower() != ".png":
        raise InputError("neither file is a PNG", where=source, key="--z-range", allowed="allowed for .png only")
    return None, {"z_range_um": z_range}

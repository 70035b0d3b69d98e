"""``dlwpredict report``: a run folder as one page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dlwpredict.cli import options
from dlwpredict.cli.console import say, warn
from dlwpredict.errors import InputError

COMMAND = "report"


def run(
    folder: Annotated[Path, typer.Argument(metavar="RUN_DIR", help="Folder of a run.", show_default=False)],
    output: options.Output,
    overwrite: options.Overwrite = False,
) -> None:
    """Show a run folder as one HTML page: maps, profiles, figures, parameters, diagnosis, where all of it comes from.

    The page works offline, holds surfaces that can be turned, and can be printed.

    $ dlwpredict report runs/demo -o report.html
    """
    options.check_outputs(output, overwrite=overwrite)
    if output.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"found {output.suffix or 'no ending'}", where=output, key="format", allowed="allowed: .html")
    from dlwpredict.pages.report import write_report  # matplotlib takes a second
    from dlwpredict.pages.run_folder import read_run, unmatched

    results = read_run(folder, leave_out=(output,))
    write_report(output, results)
    for text in results.damaged:
        warn(f"not shown: {text}")
    if hint := unmatched(results.structures):
        warn(f"{folder}: {hint}")
    prints = sum("aligned" in printed.maps for structure in results.structures for printed in structure.prints)
    say(
        f"{output}: {len(results.structures)} structures, {prints} aligned recordings, "
        f"{len(results.parameters)} parameter files, {len(results.diagnoses)} diagnoses; "
        f"{output.stat().st_size / 1e6:.1f} MB"
    )

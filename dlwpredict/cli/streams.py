"""Two habits of all commands: ``-`` for standard output, and ``--json`` for the figures that they say."""

from __future__ import annotations

import functools
import inspect
import io
import json
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from dlwpredict.cli.options import check_apart, check_outputs
from dlwpredict.cli.signatures import taking
from dlwpredict.errors import InputError
from dlwpredict.files.atomic import write_text
from dlwpredict.heightmap import HeightMap

STANDARD = "-"
Json = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write the figures as JSON; - for standard output.")
]

_told: dict[str, Any] = {}


def tell(figures: Mapping[str, Any]) -> None:
    """Give the figures of the present command, for ``--json``."""
    _told.clear()
    _told.update(figures)


def figures_of(height_map: HeightMap) -> dict[str, Any]:
    """Return what `HeightMap.summary` says as figures: shape, pitch, field and height range in µm, share missing."""
    known = height_map.heights_um[~np.isnan(height_map.heights_um)]
    return {
        "rows": height_map.shape[0],
        "cols": height_map.shape[1],
        "pitch_um": (height_map.dx_um, height_map.dy_um),
        "field_um": height_map.size_um,
        "z_um": (known.min(), known.max()) if known.size else None,
        "missing_fraction": height_map.missing_fraction,
        "height_reference": height_map.height_reference,
    }


def json_text(figures: Any) -> str:
    """Return figures as JSON; what is not finite becomes null.

    >>> json_text({"a": (np.float64(1.5), np.nan)}).split()
    ['{', '"a":', '[', '1.5,', 'null', ']', '}']
    """
    return json.dumps(_plain(figures), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value


def with_streams(
    run: Callable[..., None], *, streams: Mapping[str, str] | None = None, figures: bool = False
) -> Callable[..., None]:
    """Let some outputs of a command be ``-``, and give it ``--json``.

    Parameters
    ----------
    run : callable
        The command.
    streams : mapping of str to str
        Outputs that are text, by the name of the parameter, each with the ending of what goes to standard output.
    figures : bool
        Whether the command calls `tell` and is to have ``--json``.
    """
    endings = dict(streams or {}) | ({"json_file": ".json"} if figures else {})

    @functools.wraps(run)
    def wrapped(**given: Any) -> None:
        with _standard_output(given, endings) as options:
            path = options.pop("json_file", None) if figures else None
            if path is not None and path in options.values():
                raise InputError("named twice", where=path, key="--json", allowed="one file each")
            check_outputs(path, overwrite=options.get("overwrite", False))
            check_apart(options | ({"json_file": path} if path else {}))
            try:
                run(**options)
            except typer.Exit:  # it came to its end, and some of the work had failed
                _write(path)
                raise
            _write(path)

    parameters = list(inspect.signature(run, eval_str=True).parameters.values())
    if figures:
        parameters.append(inspect.Parameter("json_file", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=Json))
    return taking(wrapped, parameters)


def _write(path: Path | None) -> None:
    if path is not None:
        write_text(path, json_text(_told))


def _typed(name: str) -> str:
    """Return what the user calls a parameter."""
    return "--json" if name == "json_file" else name.replace("_", "-")


@contextmanager
def _standard_output(given: dict[str, Any], endings: Mapping[str, str]) -> Iterator[dict[str, Any]]:
    """Put a temporary file in the place of ``-``; print it at the end, and all else on standard error."""
    asked = [name for name, value in given.items() if isinstance(value, Path) and str(value) == STANDARD]
    for name in asked:
        if name not in endings:
            raise InputError("found -", key=_typed(name), allowed="allowed: a file name")
    if len(asked) > 1:
        raise InputError("found - for a second output", key=_typed(asked[1]), allowed="allowed for one only")
    if not asked:
        yield dict(given)
        return
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / f"output{endings[asked[0]]}"
        with redirect_stdout(io.StringIO()) as said:
            try:
                yield {**given, asked[0]: place}
            finally:
                sys.stderr.write(said.getvalue().replace(str(place), "standard output"))
        sys.stdout.write(place.read_text(encoding="utf-8").replace(str(place), STANDARD))

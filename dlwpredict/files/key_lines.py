"""The ``key=value`` lines that TIFF descriptions and text headers share: unit, pitch, height reference, instrument."""

from __future__ import annotations

import math
import re
from typing import Any

from dlwpredict.errors import InputError
from dlwpredict.heightmap import HeightMap, Instrument

_LINE = re.compile(r"^[#\s]*(\w+)\s*=\s*(.*?)\s*$")


def key_lines(height_map: HeightMap) -> dict[str, str]:
    """Return the lines that keep what the matrix alone does not: unit, pitch at full precision, reference."""
    lines = {"z_unit": "um", "pitch_x_um": repr(height_map.dx_um), "pitch_y_um": repr(height_map.dy_um)}
    if height_map.height_reference != "substrate":
        lines["height_reference"] = height_map.height_reference
    instrument = height_map.instrument
    if instrument.kind != "unknown":
        lines["instrument"] = instrument.kind
    if instrument.fast_axis_deg is not None:
        lines["instrument_fast_axis_deg"] = repr(instrument.fast_axis_deg)
    if instrument.pitch_um is not None:
        lines["instrument_pitch_um"] = repr(instrument.pitch_um)
    if instrument.scale != 1:
        lines["instrument_scale"] = repr(instrument.scale)
    return lines


def parse_lines(text: str) -> dict[str, str]:
    r"""Return every ``key=value`` line of a text; a leading ``#`` is ignored.

    >>> parse_lines("# pitch_x_um=0.1\nsomething else\nunit = um")
    {'pitch_x_um': '0.1', 'unit': 'um'}
    """
    return {match[1]: match[2] for line in text.splitlines() if (match := _LINE.match(line))}


def stored_facts(lines: dict[str, str]) -> dict[str, Any]:
    """Return what the lines state, as arguments of `Stored`.

    Raises
    ------
    InputError
        A pitch that is no positive number or given for one axis only, an unknown reference or instrument.
    """
    facts: dict[str, Any] = {}
    names = ("pitch_x_um", "pitch_y_um")
    if any(name in lines for name in names):
        facts["pitch_um"] = tuple(_positive(lines, name) for name in names)
    if "z_unit" in lines:
        facts["z_unit"] = lines["z_unit"]
    if "height_reference" in lines:
        if lines["height_reference"] not in ("substrate", "relative"):
            raise InputError(
                f"found {lines['height_reference']}", key="height_reference", allowed="allowed: substrate, relative"
            )
        facts["height_reference"] = lines["height_reference"]
    if {"instrument", "instrument_fast_axis_deg", "instrument_pitch_um", "instrument_scale"} & lines.keys():
        pitch_um = _positive(lines, "instrument_pitch_um") if "instrument_pitch_um" in lines else None
        scale = _positive(lines, "instrument_scale", "number") if "instrument_scale" in lines else 1.0
        facts["instrument"] = Instrument(lines.get("instrument", "unknown"), _angle(lines), pitch_um, scale)
    return facts


def _angle(lines: dict[str, str]) -> float | None:
    name = "instrument_fast_axis_deg"
    try:
        return float(lines[name]) if name in lines else None
    except ValueError:
        raise InputError(f"found {lines[name]}", key=name, allowed="allowed: degrees from x") from None


def _positive(lines: dict[str, str], name: str, unit: str = "number of µm") -> float:
    try:
        value = float(lines[name])
    except KeyError:
        raise InputError("missing", key=name, allowed="both pitches must be given") from None
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"found {lines[name]}", key=name, allowed=f"allowed: a positive {unit}")
    return value

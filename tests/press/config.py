"""The press' and the microscope's own YAML files, read into their dataclasses.

`format: press/1` holds the fields of `Press`; `format: microscope/1` those of `Microscope`, with `pose`, `noise`,
`dropouts` and `spikes` as sections. Unknown keys are refused by name.
"""

from dataclasses import fields
from pathlib import Path

import yaml

from tests.press.effect import build, make
from tests.press.microscope import Dropouts, Microscope, Noise, Pose, Spikes
from tests.press.printer import Press

SECTIONS = {"pose": Pose, "noise": Noise, "dropouts": Dropouts, "spikes": Spikes}


def _body(values, kind):
    """Return the keys without the format line, which must be right where it stands."""
    values = dict(values or {})
    found = values.pop("format", kind)
    if found != kind:
        raise ValueError(f"format: {found}, this program reads {kind}")
    return values


def press_from(values):
    """Build a press from a dict."""
    values = _body(values, "press/1")
    effects = tuple(make(entry) for entry in values.pop("effects", None) or ())
    plain = build(Press, values, "press")
    return type(plain)(**{**{item.name: getattr(plain, item.name) for item in fields(Press)}, "effects": effects})


def microscope_from(values):
    """Build a microscope from a dict."""
    values = _body(values, "microscope/1")
    built = {"effects": tuple(make(entry) for entry in values.pop("effects", None) or ())}
    for key, section in SECTIONS.items():
        built[key] = build(section, values.pop(key, None) or {}, key)
    for key in ("pitch_um", "field_um", "pixels"):
        if values.get(key) is not None:
            built[key] = _pair(values.pop(key), key)
    built["seed"] = int(values.pop("seed", 0))
    left = [key for key, value in values.items() if value is not None]
    if left:
        known = ", ".join(item.name for item in fields(Microscope))
        raise ValueError(f"microscope.{left[0]}: unknown, allowed are {known}")
    return Microscope(**built)


def _pair(value, key):
    """Read one number or two as a pair."""
    parts = value if isinstance(value, list | tuple) else [value, value]
    if len(parts) != 2 or any(float(part) <= 0 for part in parts):
        raise ValueError(f"microscope.{key}: {value!r}, wanted are one or two positive numbers")
    return tuple(float(part) for part in parts)


def load_press(path):
    """Read a press file."""
    return press_from(yaml.safe_load(Path(path).read_text()))


def load_microscope(path):
    """Read a microscope file."""
    return microscope_from(yaml.safe_load(Path(path).read_text()))

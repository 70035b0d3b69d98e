"""The YAML and JSON files that commands write, known by what they hold and checked for what a report reads of them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from dlwpredict.errors import InputError, blaming
from dlwpredict.files.parameters_yaml import FORMAT as PARAMETERS
from dlwpredict.files.parameters_yaml import parameters_from
from dlwpredict.files.yaml_text import read_yaml
from dlwpredict.pages import words
from dlwpredict.pages.require import FLAG, LIST, MAPPING, NUMBER, RANGE, TEXT, require

_BEFORE_AFTER = {"rmse_um.before": NUMBER, "rmse_um.after": NUMBER}
_ERRORS = "rmse_um", "holdout_rmse_um"
_MODEL = {"rmse_um": NUMBER, "holdout_rmse_um": f"{NUMBER}?", "parameters": MAPPING}
NEEDS: dict[str, dict[str, str]] = {
    "parameters": {},
    "calibration": {**_BEFORE_AFTER, "holdout.rmse_um": f"{NUMBER}?", "parameters": MAPPING, "warnings": LIST},
    "diagnosis": {
        "verdict": TEXT,
        "noise_um": NUMBER,
        **{f"{model}.{key}": kind for model in ("baseline", "extended") for key, kind in _MODEL.items()},
        "locations[].pair": NUMBER,
        "locations[].where": TEXT,
        "locations[].share": NUMBER,
        "locations[].x_um": RANGE,
        "locations[].y_um": RANGE,
        "findings[].effects": LIST,
        "findings[].side": TEXT,
        "findings[].statement": TEXT,
        "findings[].parameters{}{}.value": f"{NUMBER}?",
        **{
            f"findings[].parameters{{}}{{}}.{key}?": kind
            for key, kind in (("low", NUMBER), ("high", NUMBER), ("unit", TEXT))
        },
        "findings[].alternatives?[].name": TEXT,
        "findings[].alternatives?[].loss": NUMBER,
        "sentence?": TEXT,
        "noise?[].scars?": NUMBER,
        "complete?": FLAG,
        "not_tried?[]": TEXT,
        "work?.predictions?": NUMBER,
        "work?.cpu_s?": NUMBER,
        "findings[].probability?": NUMBER,
        "findings[].members?{}": NUMBER,
        "findings[].side_probability?{}": NUMBER,
        "findings[].p_value": f"{NUMBER}?",
        **{f"findings[].{key}?.{when}": f"{NUMBER}?" for key in _ERRORS for when in ("before", "after")},
        "remainder.significant": FLAG,
        "remainder.rms_um": f"{NUMBER}?",
        "remainder.p_value": f"{NUMBER}?",
        "remainder.description": f"{TEXT}?",
        "not_testable": LIST,
        "tested": LIST,
    },
    "alignment": {
        **dict.fromkeys(("shift_um", "scale", "tilt_mrad"), RANGE),
        **{f"uncertainty.{key}": RANGE for key in ("shift_um", "scale", "tilt_mrad")},
        **dict.fromkeys(("rotation_deg", "cc", "missing_fraction", "filled_points"), NUMBER),
        "uncertainty.rotation_deg": NUMBER,
        "mirrored": FLAG,
        "height_reference": TEXT,
    },
    "correction": {
        **_BEFORE_AFTER,
        "predictions": NUMBER,
        "reachable.fraction": NUMBER,
        "reachable.largest_um": NUMBER,
        "unreachable.points": NUMBER,
    },
    "score": {
        **dict.fromkeys(("rmse_um", "rmse_offset_free_um", "sa_um", "sq_um", "sz_um"), NUMBER),
        **dict.fromkeys(("cc", "alpha_z", "l_z_um"), f"{NUMBER}?"),
        **dict.fromkeys((f"away_from_walls?.{key}" for key in ("rmse_um", "rmse_offset_free_um", "cc")), f"{NUMBER}?"),
    },
}
"""What is read of each kind of file."""

_FORMATS = {PARAMETERS: "parameters", "dlwpredict-calibration/1": "calibration", "dlwpredict-diagnosis/1": "diagnosis"}
_KEYS = {"alignment": "rotation_deg", "correction": "unreachable", "score": "rmse_offset_free_um"}
TITLES = {
    "parameters": "parameters",
    "calibration": "figures of a calibration",
    "diagnosis": "diagnosis",
    "alignment": "figures of an alignment",
    "correction": "figures of a correction",
    "score": "figures of a comparison",
}
"""What the report calls them."""


def read_record(path: Path) -> tuple[str, Any]:
    """Return kind and content of a YAML or JSON file; no kind for what is not ours."""
    readers: Mapping[str, Callable[[Path], Any]] = {".yaml": read_yaml, ".yml": read_yaml, ".json": _read_json}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        return "", None
    try:
        content = reader(path)
    except InputError:
        if re.search(r"^\W*format\W+dlwpredict-", path.read_text("utf-8", errors="ignore"), re.MULTILINE):
            raise
        return "", None
    if not isinstance(content, dict):
        return "", None
    kind = _FORMATS.get(str(content.get("format")), "")
    if not kind and "format" not in content:
        kind = next((name for name, key in _KEYS.items() if key in content), "")
    if kind:
        with blaming(path):
            require(content, NEEDS[kind])
            if kind == "diagnosis":
                _check_verdict(content)
            content = parameters_from(content) if kind == "parameters" else content
    return kind, content


def _check_verdict(content: dict) -> None:
    """Refuse a verdict that is none, or that names an effect where none was found."""
    verdict = content["verdict"]
    if verdict not in words.VERDICTS:
        raise InputError(f"found {verdict!r}", key="verdict", allowed=f"allowed: {', '.join(words.VERDICTS)}")
    if verdict in ("identified", "ambiguous") and not all(
        [content["findings"], *(f["effects"] for f in content["findings"])]
    ):
        raise InputError("names no effect", key="findings", allowed=f"at least one where the verdict is {verdict}")


def _read_json(path: Path) -> Any:
    try:
        return json.loads(path.read_text("utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"not JSON ({type(error).__name__})", where=path, key="file") from None

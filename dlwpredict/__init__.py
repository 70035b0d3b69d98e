"""Predict, calibrate, correct and diagnose prints made by multi-photon lithography.

``import dlwpredict as dlw`` gives the names below; `dlwpredict.api` says what they do. Nothing is imported
before it is used.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.31.0"

_HOMES = {
    "HeightMap": "heightmap",
    "InputError": "errors",
    "ParameterSet": "parameters",
    "ResultError": "errors",
    "align": "api.align",
    "calibrate": "api.calibrate",
    "design": "api.maps",
    "diagnose": "api.diagnose",
    "effects": "effects",
    "plot": "api.maps",
    "precompensate": "api.precompensate",
    "predict": "api.predict",
    "read": "api.maps",
    "read_parameters": "files.parameters_yaml",
    "score": "metrology.score",
    "write": "api.maps",
    "write_parameters": "files.parameters_yaml",
}

__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'dlwpredict' has no attribute {name!r}")
    home = import_module(f"dlwpredict.{_HOMES[name]}")
    return home if name == "effects" else getattr(home, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

"""Predict, calibrate, correct and diagnose prints made by multi-photon lithography.

``import dlwpredict as dlw`` gives the names below; `dlwpredict.api` says what they do. Nothing is imported
before it is used.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.8.1"

__all__ = [
    "HeightMap",
    "InputError",
    "ParameterSet",
    "ResultError",
    "align",
    "calibrate",
    "design",
    "diagnose",
    "effects",
    "plot",
    "precompensate",
    "predict",
    "read",
    "read_parameters",
    "score",
    "write",
    "write_parameters",
]


def __getattr__(name: str) -> Any:
    if name == "effects":
        return import_module("dlwpredict.effects")
    if name not in __all__:
        raise AttributeError(f"module 'dlwpredict' has no attribute {name!r}")
    return getattr(import_module("dlwpredict.api"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

"""The library of effects: one file each; whatever lies in this folder is found and listed."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from functools import cache

from dlwpredict.effects.base import Effect


@cache
def library() -> dict[str, type[Effect]]:
    """Return every named effect of this folder: standard name to class, in alphabetical order."""
    effects: dict[str, type[Effect]] = {}
    for entry in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{entry.name}")
        for _, effect in inspect.getmembers(module, inspect.isclass):
            if effect.__module__ == module.__name__ and issubclass(effect, Effect) and hasattr(effect, "name"):
                if effect.name in effects:
                    raise RuntimeError(f"two effects are named {effect.name}")
                effects[effect.name] = effect
    return dict(sorted(effects.items()))

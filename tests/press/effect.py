"""What an effect may do, and the list of all that are there.

An effect is a frozen dataclass in a file of its own under `effects/` (the library's list) or `outside/` (physics that
the library does not have). It overrides the hooks where it acts; the hooks below do nothing.
"""

import importlib
import pkgutil
from dataclasses import dataclass, fields
from types import MappingProxyType

import numpy as np

from tests.press.grid import Grid

_REGISTRY = {}


@dataclass(frozen=True)
class Scene:
    """What is being written: heights and support on the padded grid (rows upwards), `fill` the share of each voxel."""

    grid: Grid
    heights: np.ndarray
    support: np.ndarray
    fill: np.ndarray

    @property
    def written(self):
        """The written share of each voxel of resin: `fill` above the substrate, nothing in the glass."""
        return np.where(self.grid.z[:, None, None] > 0, self.fill, np.float32(0))

    @property
    def reached(self):
        """Which voxels are written at their centre, layer by layer, the ghost layers in the glass included."""
        return self.fill >= 0.5


@dataclass(frozen=True)
class PrintEffect:
    """An effect of the print; every hook defaults to none.

    `at_focus` says that the dose is that of the focus positions, under the convolution (for what changes from line to
    line or layer to layer); else it multiplies the exposure of the point (right for what varies slowly).
    """

    at_focus = False

    def target(self, heights, support, grid):
        """Change the heights to be written and where anything is written (0 to 1)."""
        return heights, support

    def source(self, fill, grid):
        """Change the written voxels, before the focus smears them."""
        return fill

    def lobes(self, lobes):
        """Change the focus."""
        return lobes

    def dose(self, scene):
        """Return the relative focus intensity D, 1 = nominal, or None."""
        return None

    def threshold(self, scene):
        """Return the factor on the threshold, 1 = nominal, or None."""
        return None

    def curing(self, share):
        """Change the normalised cross-linking from which the shrinkage factor is interpolated."""
        return share

    def column(self, factor, heights, grid):
        """Change the shrinkage factor of each column (2-D)."""
        return factor

    def geometry(self, heights, grid):
        """Deform the printed surface."""
        return heights


@dataclass(frozen=True)
class MeasureEffect:
    """An effect of the measurement, in the instrument's frame; `stage` orders several of them."""

    stage = 0

    def place(self, x, y):
        """Return where the sample is looked at for the recorded point (x, y)."""
        return x, y

    def record(self, heights, grid):
        """Change the recorded heights."""
        return heights


def effect(name, package="effects"):
    """Register a class under its name; a name can be taken once."""

    def keep(cls):
        if name in _REGISTRY:
            raise ValueError(f"{name}: there are two effects of this name")
        cls.name, cls.inside_library = name, package == "effects"
        _REGISTRY[name] = cls
        return cls

    return keep


def registry():
    """Import every effect file once and return the classes by name."""
    for folder in ("effects", "outside"):
        package = importlib.import_module(f"tests.press.{folder}")
        for module in pkgutil.iter_modules(package.__path__):
            importlib.import_module(f"{package.__name__}.{module.name}")
    return MappingProxyType(_REGISTRY)


def names(*, side=None, inside_library=None):
    """Return the names of the effects, of one side (`print`, `measurement`) or one kind if wanted."""
    base = {"print": PrintEffect, "measurement": MeasureEffect}
    return sorted(
        name
        for name, cls in registry().items()
        if (side is None or issubclass(cls, base[side]))
        and (inside_library is None or cls.inside_library == inside_library)
    )


def make(entry):
    """Build an effect from `{"name": ..., parameter: value}`, or pass an effect through."""
    if isinstance(entry, PrintEffect | MeasureEffect):
        return entry
    entry = dict(entry)
    name = entry.pop("name", None)
    if name not in registry():
        raise ValueError(f"effects: {name}: no such effect, there are {', '.join(names())}")
    made = build(registry()[name], entry, name)
    if getattr(made, "model", None) not in (None, *getattr(made, "models", ())):
        raise ValueError(f"{name}.model: {made.model}, allowed are {', '.join(made.models)}")
    return made


def build(cls, values, where):
    """Fill a dataclass from a dict; unknown keys and wrong types are refused by name."""
    known = {field.name: field for field in fields(cls)}
    for key in values:
        if key not in known:
            raise ValueError(f"{where}.{key}: unknown, allowed are {', '.join(known)}")
    return cls(**{key: _typed(value, known[key], f"{where}.{key}") for key, value in values.items()})


def _typed(value, field, where):
    """Turn a YAML value into the type that the field's default has (YAML reads 1e-1 as text)."""
    default = field.default
    try:
        if default is None and value is not None:
            return float(value)
        if isinstance(default, bool):
            if not isinstance(value, bool):
                raise ValueError
            return value
        if isinstance(default, int) and value is not None:
            return int(value)
        if isinstance(default, float) and value is not None:
            return float(value)
        if isinstance(default, tuple):
            return tuple(float(part) for part in (value if isinstance(value, list | tuple) else [value]))
    except (TypeError, ValueError):
        raise ValueError(f"{where}: {value!r} is not like {default!r}") from None
    return value

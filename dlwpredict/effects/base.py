"""What every effect knows of itself, and the few ways in which an effect can act."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np

from dlwpredict.errors import InputError
from dlwpredict.heightmap import HeightMap
from dlwpredict.model.states import Crosslinked, Dose, Focus, PlaneAt
from dlwpredict.parameters import check_range, declarations, declare

Side = Literal["print", "measurement"]
Frame = Literal["printer", "sample", "instrument"]


@dataclass(frozen=True)
class Effect:
    """A piece of physics beside the paper's: a frozen step with declared parameters.

    Every parameter is declared on its field; at the defaults the effect is the identity. A subclass names itself in the
    class variables and is found by being a file in this folder.

    Parameters declared with a typical size switch the effect on: while all of them stand at their defaults it hands its
    state on untouched, whatever its other parameters say. `isotropic` says whether a turned or mirrored
    structure is changed alike (parameters named after an axis aside).
    """

    name: ClassVar[str]
    meaning: ClassVar[str]
    side: ClassVar[Side] = "print"
    frame: ClassVar[Frame]
    stage: ClassVar[str]
    source: ClassVar[str]
    confused_with: ClassVar[tuple[str, ...]] = ()
    separated_by: ClassVar[str]
    isotropic: ClassVar[bool] = True

    def __post_init__(self) -> None:
        for name, (_, declaration) in declarations(self).items():
            check_range(f"{self.name}.{name}", getattr(self, name), declaration)
        direction = getattr(self, "direction", 1.0)
        if direction not in (-1.0, 1.0):
            raise InputError(f"found {direction:g}", key=f"{self.name}.direction", allowed="allowed: 1 or -1")

    @classmethod
    def switches(cls) -> dict[str, float]:
        """Return the parameters that switch the effect on, each with a typical size."""
        return {name: d.typical for name, (_, d) in declarations(cls).items() if d.typical is not None}

    @property
    def off(self) -> bool:
        """Whether nothing switches the effect on."""
        return all(getattr(self, name) == declarations(self)[name][0] for name in self.switches())

    def elsewhere(self) -> Effect:
        """Return the same effect in other words, where a range ends that nature does not end: an angle, a phase.

        The effect itself anywhere else. A descent that comes to the end of such a range goes on from there.
        """
        return self

    def __call__(self, state: Any) -> Any:
        """Return the changed state; the same object while the effect is off."""
        return state if self.off else self.act(state)

    def act(self, state: Any) -> Any:
        """Return the changed state."""
        raise TypeError(f"{type(self).__name__} has no formula")


@dataclass(frozen=True)
class MapEffect(Effect):
    """An effect on a height map: of the target, of the printed surface, or of the recording."""

    def act(self, state: HeightMap) -> HeightMap:
        """Return the changed map."""
        return state.with_heights(self.heights(state))

    def heights(self, state: HeightMap) -> np.ndarray:
        """Return the changed heights, µm, shape (rows, cols)."""
        raise TypeError(f"{type(self).__name__} has no formula")


@dataclass(frozen=True)
class DoseEffect(Effect):
    """An effect on the local focus intensity, D(x, y, z); 1 = nominal.

    It acts through two channels: the threshold, as Dᴺ under the convolution with the focus, and, as far as the
    resin's η lets it, the degree of conversion.
    """

    stage: ClassVar[str] = "dose"
    conversion: float = declare(
        0.0, "1", 0.0, 1.0, "eta: share of the dose change that reaches cross-linking", shared=True
    )

    def act(self, state: Dose) -> Dose:
        """Return the dose with this intensity of the focus as one more factor."""
        return self.added(state, intensity=self.intensity)

    def added(self, state: Dose, *, intensity: PlaneAt | None = None, background: PlaneAt | None = None) -> Dose:
        """Return the dose with one more factor on the focus or on the background; η is the resin's, and shared."""
        return replace(
            state,
            intensity=(*state.intensity, intensity) if intensity else state.intensity,
            background=(*state.background, background) if background else state.background,
            conversion=max(state.conversion, self.conversion),
        )

    def intensity(self, written: HeightMap, z_um: float | np.ndarray) -> np.ndarray:
        """Return D while the layer at height z is written, on the whole plane, shape (rows, cols)."""
        raise TypeError(f"{type(self).__name__} has no formula")


@dataclass(frozen=True)
class ThresholdEffect(Effect):
    """An effect on the local polymerisation threshold."""

    stage: ClassVar[str] = "dose"

    def act(self, state: Dose) -> Dose:
        """Return the dose with one more factor on the threshold."""
        return replace(state, threshold_factor=(*state.threshold_factor, self.factor))

    def factor(self, written: HeightMap, z_um: float | np.ndarray) -> np.ndarray:
        """Return the factor on P of the resin at height z, shape (rows, cols)."""
        raise TypeError(f"{type(self).__name__} has no formula")


@dataclass(frozen=True)
class FocusEffect(Effect):
    """An effect on the shape of the focus."""

    stage: ClassVar[str] = "dose"

    def act(self, state: Dose) -> Dose:
        """Return the dose with every part of the focus reshaped."""
        return replace(state, focus=tuple(new for part in state.focus for new in self.reshape(part)))

    def reshape(self, part: Focus) -> tuple[Focus, ...]:
        """Return what becomes of one part of the focus; the weights keep their sum."""
        raise TypeError(f"{type(self).__name__} has no formula")


@dataclass(frozen=True)
class CurveEffect(Effect):
    """An effect on how shrinkage answers to cross-linking."""

    stage: ClassVar[str] = "crosslink"

    def act(self, state: Crosslinked) -> Crosslinked:
        """Return the state with one more curve."""
        return state.with_curve(self.curve)

    def curve(self, crosslinking: np.ndarray) -> np.ndarray:
        """Return u' for normalised cross-linking u in 0–1."""
        raise TypeError(f"{type(self).__name__} has no formula")


def settings(effect: Effect) -> dict[str, Any]:
    """Return the declared parameters of an effect and their values."""
    return {name: getattr(effect, name) for name in declarations(effect)}

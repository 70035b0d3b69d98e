"""``predict``: the printed surface of a target."""

from __future__ import annotations

from dlwpredict import process
from dlwpredict.correction.surround import Continued
from dlwpredict.heightmap import HeightMap
from dlwpredict.model.states import Numerics
from dlwpredict.parameters import ParameterSet


def predict(
    target: HeightMap,
    parameters: ParameterSet | None = None,
    *,
    as_measured: bool = False,
    continued: bool = False,
    numerics: Numerics | None = None,
) -> HeightMap:
    """Predict the print of a target, on the target's grid.

    Parameters
    ----------
    target : HeightMap
        Heights to be written, 0 and above; 0 is bare substrate.
    parameters : ParameterSet, optional
        Default: the paper's.
    as_measured : bool
        Add the effects of the instrument.
    continued : bool
        The part goes on beyond its map as its mirror image, instead of ending there.
    numerics : Numerics, optional
        `model.levels.Levels`, the default, or `model.voxels.Voxels`, the paper's chain taken literally.

    Raises
    ------
    InputError
        The target has points not measured, negative heights, or nothing written.
    """
    process.check_target(target)
    known = parameters or ParameterSet()
    view = Continued.of(target, known, continued=continued)
    return view.in_view(process.predict(view.whole, known, numerics=numerics, as_measured=as_measured))

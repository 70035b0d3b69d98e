"""Pictures of height maps for papers and reports.

`panels` draws into given axes, `sheets` and `transfer` make whole figures, `saving` writes them. Only the object
interface of matplotlib is used: no global state, no display.
"""

from dlwpredict.plots.saving import drawn, save
from dlwpredict.plots.sheets import calibration, comparison, correction, diagnosis, overview
from dlwpredict.plots.transfer import transfer_curves

__all__ = [
    "calibration",
    "comparison",
    "correction",
    "diagnosis",
    "drawn",
    "overview",
    "save",
    "transfer_curves",
]

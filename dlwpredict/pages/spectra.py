"""Pictures of what is left of a recording by frequency, beside what its noise model expects."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from dlwpredict.noise.spectrum import Spectrum
from dlwpredict.pages.pictures import PairMaps, Picture, page_style, uri
from dlwpredict.plots.panels import REFERENCE_LINE, TEST_LINE

INCHES = (4.7, 2.5)

NM2_UM = 1e6
"""nm²·µm in a µm³."""


def spectra(pair: PairMaps) -> list[Picture]:
    """Return the spectra of a pair along x and y, the fast axis of its scan first if known; none if not computed."""
    if pair.spectra is None:
        return []
    fast = pair.measured.instrument.fast_axis_deg
    shown = list(zip("xy", pair.spectra, strict=True))
    if fast is not None and abs(np.sin(np.deg2rad(fast))) > np.sqrt(0.5):
        shown.reverse()
    words = ("", "") if fast is None else (", the fast axis", ", the slow axis")
    with page_style():
        return [_picture(axis, said, spectrum) for (axis, spectrum), said in zip(shown, words, strict=True)]


def _picture(axis: str, words: str, spectrum: Spectrum) -> Picture:
    """Return one spectrum, both axes logarithmic."""
    figure = Figure(figsize=INCHES, layout="constrained")
    axes = figure.add_subplot()
    axes.loglog(spectrum.per_um, NM2_UM * spectrum.measured_um3, label="remainder", **REFERENCE_LINE)
    axes.loglog(spectrum.per_um, NM2_UM * spectrum.model_um3, label="noise model", **TEST_LINE)
    axes.set(xlabel=f"frequency along {axis} / (1/µm)", ylabel="spectral density / nm²·µm")
    for one in (axes.xaxis, axes.yaxis):
        one.set_major_locator(LogLocator(subs=(1, 2, 5)))
        one.set_major_formatter(StrMethodFormatter("{x:g}"))
        one.set_minor_formatter(NullFormatter())
    axes.margins(x=0)
    axes.grid(color="0.92", lw=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, ncols=2, loc="lower left", bbox_to_anchor=(0, 0.98), borderaxespad=0, fontsize=7)
    text = "of recording − extended prediction; above the model, structure is left or the noise is underestimated"
    return Picture(uri(figure), f"Spectrum along {axis}{words}", text)

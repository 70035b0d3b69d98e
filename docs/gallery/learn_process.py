"""
Learn a process from one print
==============================

``calibrate`` fits the seven parameters to a recording of a print. How well are they known after one
structure, and after two?

**The recordings are simulated**: predicted prints of a process that is chosen here, with 10 nm of
white noise. The program is shown only targets and recordings.
"""

from dataclasses import replace
from textwrap import fill

import matplotlib.pyplot as plt
import numpy as np

import dlwpredict as dlw

# %%
# A process to be learned
# -----------------------
# It differs from the paper's in focus, threshold, cross-linking and shrinkage.

default = dlw.ParameterSet()
chosen = replace(
    default,
    paper=replace(
        default.paper,
        exposure_fwhm_xy_um=0.6,
        exposure_fwhm_z_um=1.9,
        threshold=0.42,
        crosslink_fwhm_xy_um=5.5,
        shrinkage_min=0.75,
        shrinkage_max=0.93,
    ),
)


def record(target, seed):
    """Return the simulated recording of a print of the chosen process."""
    printed = dlw.predict(target, chosen, as_measured=True)
    noise_um = np.random.default_rng(seed).normal(0, 0.010, printed.shape)
    return printed.with_heights(printed.heights_um + noise_um)


# %%
# The first structure is a roughness in which all heights are equally frequent (AIR), the second a
# chirp, waves whose period grows outwards (CIN).

air = dlw.design("air", size_um=20, pitch_um=0.4, margin_um=2, seed=1)
cin = dlw.design("cin", size_um=20, pitch_um=0.4, margin_um=2)
pairs = [(air, record(air, seed=1)), (cin, record(cin, seed=2))]
dlw.plot(*pairs[0], names=("target", "recording"))

# %%
# One structure
# -------------
# A recording of your own comes onto the target's grid by ``dlw.align``; this one is there already.
# The fit starts at the paper's parameters.

one = dlw.calibrate(pairs[:1])


def table(calibration):
    """Print chosen and fitted values with their 95 % intervals."""
    found = calibration.parameters
    print("                      chosen  fitted   95 % interval")
    for name, (low, high) in found.intervals.items():
        value, fitted = (getattr(p.paper, name) for p in (chosen, found))
        values = f"{value:6.2f}{fitted:8.3f}   {low:.3f} to {high:.3f}"
        print(f"{name:22}{values}")
    for warning in calibration.warnings:
        print("\n" + fill(f"warning: {warning}", 70))


table(one)

# %%
# The shrinkage and the lateral width of cross-linking are known to 2 %, the lateral width of the
# focus to an eighth, the threshold to a sixth; the length of the focus and the axial width of
# cross-linking hardly. Over the few heights of one structure, a longer focus and a wider
# cross-linking change the print in nearly the same way. The warning says so.
#
# Two structures
# --------------

two = dlw.calibrate(pairs)
table(two)

# %%
# Every interval as a share of the chosen value. The second structure shortens the intervals of the
# parameters that the first one could not tell apart.

# sphinx_gallery_thumbnail_number = 2
figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
for label, fit, colour in (("AIR", one, "C1"), ("AIR and CIN", two, "C0")):
    for row, (name, ends) in enumerate(fit.parameters.intervals.items()):
        value, y = getattr(chosen.paper, name), row + 0.24 * (fit is two)
        fitted = getattr(fit.parameters.paper, name)
        axes.plot(np.divide(ends, value), [y, y], color=colour, lw=3)
        axes.plot(fitted / value, y, "o", color=colour)
    axes.plot([], [], "o-", color=colour, lw=3, label=label)
axes.axvline(1, color="0.4", lw=0.8)
axes.set(xlabel="fitted / chosen, with 95 % interval", yticks=range(7))
axes.set_yticklabels(one.parameters.intervals)
axes.invert_yaxis()
axes.legend(frameon=False)
plt.show()

# %%
# Parameters that are badly known can still predict structures of the same kind; for others, add a
# recording. :doc:`What the seven parameters mean, and when not to trust them </docs/parameters>`
# goes on from here. A simulated recording cannot show the most important doubt: whether the model
# holds for your printer at all. :doc:`missing_effect` asks that.

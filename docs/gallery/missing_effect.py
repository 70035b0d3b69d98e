"""
What is missing?
================

Where prediction and recording still differ after the fit, ``diagnose`` says which physics the model
lacks. Here the answer is known: **the recordings are simulated**, with an effect that the seven
parameters do not describe.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import dlwpredict as dlw

# %%
# A printer that remembers
# ------------------------
# In this process the lines just written raise the dose of the next ones by up to 10 %, and that
# fades over 6 µm. The lines are written one after the other along x, so the print becomes a little
# higher towards +x. ``dlw.effects.library()`` holds all effects that have a name.

dose_memory = dlw.effects.library()["dose-memory"](gain=0.1, length_um=6)
default = dlw.ParameterSet()
paper = replace(
    default.paper, threshold=0.42, shrinkage_min=0.75, shrinkage_max=0.93
)
printer = replace(default, paper=paper, effects=(dose_memory,))


def record(target, seed):
    """Return the simulated recording of a print, with 10 nm of noise."""
    printed = dlw.predict(target, printer, as_measured=True)
    noise_um = np.random.default_rng(seed).normal(0, 0.010, printed.shape)
    return printed.with_heights(printed.heights_um + noise_um)


air = dlw.design("air", size_um=20, pitch_um=0.4, margin_um=2, seed=1)
cin = dlw.design("cin", size_um=20, pitch_um=0.4, margin_um=2)
pairs = [(cin, record(cin, seed=1)), (air, record(air, seed=2))]

# %%
# The seven parameters alone
# --------------------------
# The fit moves the seven so that they take up part of what they do not describe. The difference
# that is left has a shape; noise would have none.

seven = dlw.calibrate(pairs).parameters
target, recording = pairs[0]
predicted = dlw.predict(target, seven)
dlw.plot(predicted, recording, names=("prediction", "recording"))

# %%
# Diagnose
# --------
# All effects are scored, alone and in sets, and the leading sets are fitted beside the seven.

answer = dlw.diagnose(pairs)
answer

# %%
# The finding as data. Its class is the smallest set of names that holds 95 % of the probability.
# Here it is one name: these recordings tell it from all its look-alikes. With several names they
# could not, and the verdict would be *ambiguous*.

print("verdict   ", answer.verdict)
for finding in answer.findings:
    print("class     ", ", ".join(finding["effects"]))
    print("side      ", finding["side"])
    for strengths in finding["parameters"].values():
        for name, found in strengths.items():
            values = "{value:.3f} ({low:.3f} to {high:.3f})".format(**found)
            print(f"{name:10} {values}")

# %%
# The chosen gain, 0.1, and length, 6 µm, lie in their intervals. ``conversion`` is the share of the
# dose change that reaches cross-linking, here none. Its interval begins near 0: read it as "below
# 0.08".
#
# The maps
# --------
# What the seven leave, how surely that is more than noise, what the effect explains of it, and the
# remainder. Points near walls do not count. Every recording may have a small tilt, offset and shift
# of its own, for no microscope levels perfectly. They take up much of the ramp; the rest of the
# shape gives the effect away.

models = answer.diagnosis.baseline, answer.diagnosis.extended
left, remainder = (1e3 * model.fit.residual_um(0) for model in models)
counts = np.isfinite(left)
maps = {
    "recording − prediction / nm": left,
    "beyond noise: how surely": answer.diagnosis.mismatch[0],
    "explained by dose-memory / nm": left - remainder,
    "remainder / nm": remainder,
}
heights = {"vmin": -40, "vmax": 40, "cmap": "RdBu_r"}
# sphinx_gallery_thumbnail_number = 2
figure, panels = plt.subplots(2, 2, figsize=(8, 7), layout="constrained")
for axes, (title, values) in zip(panels.flat, maps.items(), strict=True):
    scale = {"vmin": 0, "vmax": 1} if "surely" in title else heights
    shown = np.where(counts, values, np.nan)
    picture = axes.pcolormesh(target.x_um, target.y_um, shown, **scale)
    axes.set(title=title, aspect="equal", xlabel="x / µm", ylabel="y / µm")
    figure.colorbar(picture, ax=axes, shrink=0.8)
plt.show()

# %%
# The corrected design
# --------------------
# Corrected for the seven alone, the next print keeps the ramp. Corrected for what was found, it
# does not. Both designs go to the same simulated printer.


def error_nm(written):
    """Return how far the print of a design is from the target, rms."""
    printed = dlw.predict(written, printer)
    return 1e3 * dlw.score(target, printed, part_only=True).rmse_um


print(f"not corrected {error_nm(target):17.1f} nm rms off the target")
processes = {"the seven alone": seven, "the diagnosis": answer.parameters}
for name, process in processes.items():
    corrected = dlw.precompensate(target, process).corrected
    print(f"corrected by {name:15} {error_nm(corrected):5.1f} nm")
dlw.plot(target, corrected, names=("target", "corrected design"))

# %%
# The simulated printer remembers by the same formula that the program fits. A real one does so
# approximately, and then fewer than 95 % of the intervals hold the truth: :doc:`the evidence
# </docs/evidence>` counts how many, with a virtual press that shares no code with the program.
# :doc:`Reading a diagnosis </docs/diagnosis>` says what to do about each verdict.

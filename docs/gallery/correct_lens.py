"""
Predict and correct a micro-lens
================================

A micro-lens is designed, its print is predicted, and the design is corrected so that the print has
the heights of the target. Nothing is measured here: the process is the one of the paper.
:doc:`learn_process` shows how to learn your own.
"""

import tempfile
from pathlib import Path

import numpy as np

import dlwpredict as dlw

# %%
# Design
# ------
# A spherical cap of 5 µm sag on a square plate of 20 µm × 20 µm, 2 µm thick. Lengths are µm; 0 is
# the substrate, where nothing is written.

target = dlw.design(
    "lens", size_um=20, pitch_um=0.4, margin_um=2, base_um=2, height_um=5
)
print(target.summary())

# %%
# Predict
# -------
# ``dlw.ParameterSet()`` holds the seven parameters of the paper. The focus rounds the edges; the
# resin shrinks, and near the outside, where it is less cross-linked, it shrinks more.

process = dlw.ParameterSet()
printed = dlw.predict(target, process)
dlw.plot(target, printed, names=("target", "predicted print"))

# %%
# What is wrong with it?
# ----------------------
# ``score`` compares two maps point by point; ``part_only`` leaves out the bare substrate. Most of
# the error is a mean difference: the print is too low. What is left of it without that mean is an
# error of the shape.

before = dlw.score(target, printed, part_only=True)
print(f"rms error            {before.rmse_um:.3f} µm")
print(f"mean difference      {before.mean_difference_um:.3f} µm")
print(f"rms without the mean {before.rmse_offset_free_um:.3f} µm")

# %%
# What that does to the optics: on a sphere of radius R about the height c, r² + h² = 2ch + (R² −
# c²), which is linear in c and in R² − c². A fit to r < 8 µm gives the radius of curvature, and how
# far the surface is from a sphere. The focal length is R/(n − 1) for a refractive index n and a
# flat back: it is wrong by the same share as R.


def sphere(lens):
    """Return R in µm, and the rms distance from that sphere in nm."""
    r = np.hypot(lens.x_um, lens.y_um[:, None])
    inner = r < 8
    h, r = lens.heights_um[inner], r[inner]
    columns = np.stack([2 * h, np.ones_like(h)], axis=1)
    (c, constant), *_ = np.linalg.lstsq(columns, r**2 + h**2)
    radius = np.sqrt(constant + c**2)
    return radius, 1e3 * np.std(h - c - np.sqrt(radius**2 - r**2))


for name, lens in {"target": target, "predicted print": printed}.items():
    radius_um, off_nm = sphere(lens)
    print(f"{name:15} R = {radius_um:.2f} µm, {off_nm:.0f} nm off a sphere")

# %%
# Correct
# -------
# ``precompensate`` looks for the design whose print has the target's heights: it predicts, adds
# what is missing, and predicts again.

result = dlw.precompensate(target, process)
dlw.plot(target, result.corrected, names=("target", "corrected design"))

# %%
# Predict again
# -------------

after = dlw.score(target, result.predicted, part_only=True)
radius_um, off_nm = sphere(result.predicted)
print(f"rms error before     {1e3 * before.rmse_um:.0f} nm")
print(f"rms error after      {1e3 * after.rmse_um:.1f} nm")
print(f"rms off a sphere     {off_nm:.1f} nm")
print(f"radius of curvature  {radius_um:.2f} µm")
print(f"predictions          {result.predictions}")
dlw.plot(target, result.predicted, names=("target", "print, corrected"))

# %%
# This is how well the *model* can be inverted, not how good the next print will be: that one is as
# good as the process is known.
#
# Write the STL
# -------------
# The ending of the file decides the format. The solid is watertight, its number is µm, and it is
# read back and checked before the file counts as written. :doc:`To the printer </docs/printer>` has
# the settings of the slicer that match the model.

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "lens.stl"
    remarks = dlw.write(path, result.corrected)
    print(f"{path.name}, {path.stat().st_size} bytes", *remarks)

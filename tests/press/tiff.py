"""Height maps as contract TIFFs: float32, ImageJ tags, pitch in the description at full precision."""

import os
from pathlib import Path

import numpy as np
import tifffile


def _described(text):
    """Return the `key=value` lines of a description as a dict."""
    pairs = (line.split("=", 1) for line in (text or "").splitlines() if "=" in line)
    return {key.strip(): value.strip() for key, value in pairs}


def _tag_pitch(page, name):
    """Return the pitch in um from a resolution tag, or None."""
    tag = page.tags.get(name)
    if tag is None or tag.value[0] == 0:
        return None
    return tag.value[1] / tag.value[0]


def read_map(path):
    """Read heights and pitches: `(heights in um, dx_um, dy_um)`; the description wins over the tags."""
    with tifffile.TiffFile(path) as file:
        page = file.pages[0]
        heights = np.asarray(page.asarray(), float)
        words = _described(page.description)
        dx = float(words["pitch_x_um"]) if "pitch_x_um" in words else _tag_pitch(page, "XResolution")
        dy = float(words["pitch_y_um"]) if "pitch_y_um" in words else _tag_pitch(page, "YResolution")
    if heights.ndim != 2:
        raise ValueError(f"{path}: shape: {heights.shape}, a height map has two axes")
    if not (dx and dy and dx > 0 and dy > 0):
        raise ValueError(f"{path}: pitch_x_um: missing, the press needs the pitch in the description or the tags")
    return heights, dx, dy


def write_map(path, heights, dx_um, dy_um, *, overwrite=False, notes=None):
    """Write a contract TIFF through a temporary name, so that there is the whole file or none."""
    path = Path(path)
    if path.exists() and not overwrite:
        raise FileExistsError(f"{path}: exists, use --overwrite to replace it")
    words = {"z_unit": "um", "pitch_x_um": repr(float(dx_um)), "pitch_y_um": repr(float(dy_um)), **(notes or {})}
    partial = path.with_name(f".{path.name}.{os.getpid()}.tif")
    metadata = {"unit": "um", **{key: str(value) for key, value in words.items()}}
    tifffile.imwrite(
        partial, np.float32(heights), imagej=True, resolution=(1 / dx_um, 1 / dy_um), metadata=metadata, datetime=False
    )
    partial.replace(path)

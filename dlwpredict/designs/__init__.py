"""Targets made by formula, on a margin of bare substrate: ``cin()``, ``air(seed=3)``, ``f(pitch_um=0.5)`` ...

A kind is a function in one of the files here, turned into a design by `design`; `KINDS` lists them by the name that the
command line uses.

Examples
--------
>>> from dlwpredict.designs import KINDS, f
>>> f(pitch_um=0.5).shape
(100, 100)
>>> sorted(KINDS)
['air', 'blaze', 'cin', 'f', 'fresnel', 'grating', 'lens', 'lens-array', 'pads', 'posts', 'stairs']
"""

from dlwpredict.designs.base import KINDS, options_of
from dlwpredict.designs.chirp import cin
from dlwpredict.designs.gratings import blaze, grating
from dlwpredict.designs.lenses import fresnel, lens, lens_array
from dlwpredict.designs.letter import f
from dlwpredict.designs.roughness import air
from dlwpredict.designs.steps import pads, posts, stairs

__all__ = [
    "KINDS",
    "air",
    "blaze",
    "cin",
    "f",
    "fresnel",
    "grating",
    "lens",
    "lens_array",
    "options_of",
    "pads",
    "posts",
    "stairs",
]

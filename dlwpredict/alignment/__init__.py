"""Alignment: find a target in a recording, bring the recording onto the target's grid, level it.

`align` is the whole chain; the modules hold one step each: `spikes`, `fill` (gaps), `search` (every pose), `choose`
(which pose, and whether any), `refine` (sub-pixel), `distortion` (how much), `uncertainty`, `resample`, `level`.
"""

from dlwpredict.alignment.alignment import Alignment
from dlwpredict.alignment.run import align

__all__ = ["Alignment", "align"]

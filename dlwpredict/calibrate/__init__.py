"""Calibration: one parameter set for several recordings, and how well it is known.

``prepare`` checks a pair and chooses the points that count, ``choose`` (in `dlwpredict.flat`) says what moves,
``calibrate`` fits. `Problem`, `Point`, `trace` and `inform` are the parts, for those who fit something else.
"""

from dlwpredict.calibrate.problem import Point, Problem
from dlwpredict.calibrate.recordings import Recording, near_walls, prepare
from dlwpredict.calibrate.run import Calibration, calibrate

__all__ = ["Calibration", "Point", "Problem", "Recording", "calibrate", "near_walls", "prepare"]

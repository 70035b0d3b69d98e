"""Calibration: one parameter set for several recordings, and how well it is known.

`infer.recording.prepare` checks a pair and chooses the points that count, `infer.free.choose` says what moves,
`calibrate` fits.
"""

from dlwpredict.calibration.run import Calibration, calibrate

__all__ = ["Calibration", "calibrate"]

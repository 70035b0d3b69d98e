"""The result of an alignment: the map on the target's grid and every figure with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

from dlwpredict.alignment.pose import Pose
from dlwpredict.heightmap import HeightMap


@dataclass(frozen=True)
class Alignment:
    """A recording brought onto its target's grid.

    Pose: the target point (x, y), from the target's centre, y up, lies in the recording at
    shift + R(rotation)·[[1, shear], [0, 1]]·diag(scale)·(x, y) + bow + cubic (`Pose`) from the recording's centre.
    Heights: recorded height = aligned height + offset + tilt·(x, y), x and y from the recording's centre. A mirrored
    recording is counted after its columns were reversed.

    Parameters
    ----------
    aligned : HeightMap
        On the target's grid; filled points marked.
    pose : Pose
    tilt_mrad : tuple of float
        Slope of the plane taken out, along the recording's x and y.
    offset_um : float
        Height of that plane at the recording's centre.
    cc : float
        Correlation (corr2) of aligned map and target over the measured points.
    missing_fraction : float
        Share of the recording's points that were not measured.
    rejected_spikes : int
        Points of the recording rejected as spikes.
    uncertainty : dict
        One standard error per figure, same shape as the figure; 0 where the distortion keeps it fixed.
    distortion : str
        rigid, affine, bow or cubic.
    distortion_test : dict
        Per distortion tried: p_value, rim_px (what it moves at the target's rim), blocks, accepted; relief_p_value
        where the relief inside the outline was asked too.
    symmetry : str
        "none", "n-fold" where the target looks the same after n turns, "round", "mirror", or "shift".
    quality : dict
        height_gain, correlation_explained, residual_rms_um, match_log_odds, lead_log_odds.
    """

    aligned: HeightMap
    pose: Pose
    tilt_mrad: tuple[float, float]
    offset_um: float
    cc: float
    missing_fraction: float
    rejected_spikes: int
    uncertainty: dict
    distortion: str
    distortion_test: dict
    symmetry: str
    quality: dict

    def summary(self) -> str:
        """Say pose, correlation, and what heights count from, in one line."""
        pose, error = self.pose, self.uncertainty
        (x, y), (dx, dy) = pose.shift_um, error["shift_um"]
        return (
            f"shift {x:.3f}±{dx:.3f}, {y:.3f}±{dy:.3f} µm, "
            f"rotation {pose.rotation_deg:.3f}±{error['rotation_deg']:.3f}°, "
            f"scale {pose.scale[0]:.4f}, {pose.scale[1]:.4f} ({self.distortion}), CC {self.cc:.3f}, "
            f"heights {'to the substrate' if self.aligned.height_reference == 'substrate' else 'relative'}"
        )

    def __repr__(self) -> str:
        return f"Alignment({self.summary()})"

    def as_dict(self) -> dict:
        """Return the report's keys in the contract's order, then what this project adds."""
        bow_x, bow_y = self.pose.bow_um
        return {
            "shift_um": list(self.pose.shift_um),
            "rotation_deg": self.pose.rotation_deg,
            "scale": list(self.pose.scale),
            "tilt_mrad": list(self.tilt_mrad),
            "offset_um": self.offset_um,
            "cc": self.cc,
            "mirrored": self.pose.mirrored,
            "missing_fraction": self.missing_fraction,
            "filled_points": 0 if self.aligned.filled is None else int(self.aligned.filled.sum()),
            "height_reference": self.aligned.height_reference,
            "instrument": self.aligned.instrument.kind,
            "instrument_fast_axis_deg": self.aligned.instrument.fast_axis_deg,
            "instrument_pitch_um": self.aligned.instrument.pitch_um,
            "instrument_scale": self.aligned.instrument.scale,
            "uncertainty": self.uncertainty,
            "shear_mrad": 1e3 * self.pose.shear,
            "bow_um": {"x": list(bow_x), "y": list(bow_y)},
            "cubic_um": list(self.pose.cubic_um),
            "distortion": self.distortion,
            "distortion_test": self.distortion_test,
            "symmetry": self.symmetry,
            "nan_points": round(self.aligned.missing_fraction * self.aligned.heights_um.size),
            "rejected_spikes": self.rejected_spikes,
            "quality": self.quality,
        }

"""Predict, calibrate, correct and diagnose prints made by multi-photon lithography."""

__version__ = "0.1.0"

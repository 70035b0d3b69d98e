"""Numerics that know nothing of prints: smoothing, reading between pixels, work shared by processes."""

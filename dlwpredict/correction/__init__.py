"""Correction: what to write so that the print has the heights of the target, as far as a printer can."""

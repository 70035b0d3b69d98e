"""Solids: from a height map to a watertight mesh and back."""

"""Mutation testing: the numerics written wrong, one place at a time, to see whether the tests notice."""

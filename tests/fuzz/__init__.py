"""Bad files against every reader: `python -m tests.fuzz --inputs 10000`."""

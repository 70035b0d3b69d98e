"""Commands killed while they write: `python -m tests.crash --kills 50`."""

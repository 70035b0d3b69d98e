"""The command line: one module per command; read, one library call, write, say."""

import os

# Work is shared out over our own threads. Matrix libraries that start more of them beside these only slow it down,
# by a factor of ten and more where other programs use the cores too. Must be said before numpy is imported.
for _variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

from dlwpredict.cli.app import app, main  # noqa: E402

__all__ = ["app", "main"]

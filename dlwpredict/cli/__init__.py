"""The command line: one module per command; read, one library call, write, say."""

from dlwpredict.cli.app import app, main

__all__ = ["app", "main"]

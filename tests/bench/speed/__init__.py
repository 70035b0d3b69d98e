"""Speed: every figure as a ratio measured side by side in one run. ``python -m tests.bench.speed``, `make bench`.

`jobs` is what is timed, each in a process of its own; `measure` runs them in turn; `parts` says what is compared with
what, and the target; `reference` is the paper's chain as SciPy gives it.
"""

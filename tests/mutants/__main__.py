"""Mutation testing: `python -m tests.mutants` writes the code wrong, one place at a time, and sees whether tests fail.

Ends with 0 if nine in ten mutants are caught and every survivor has a reason in `table.yaml`.
"""

from __future__ import annotations

import argparse
import sys

from tests.mutants.mutant import mutants
from tests.mutants.run import copied, summary

LEAST_SHARE = 0.9


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", metavar="TEXT", help="mutants whose file or text contains this")
    parser.add_argument("--timeout", type=float, default=300.0, metavar="SECONDS", help="for one mutant")
    options = parser.parse_args()
    chosen = [mutant for mutant in mutants() if options.only in str(mutant)]
    if not chosen:
        parser.error(f"no mutant contains {options.only!r}")
    outcomes = []
    with copied(timeout_s=options.timeout) as copy:
        tests = sorted({test for mutant in chosen for test in mutant.tests})
        print(
            f"{len(chosen)} mutants, {len(tests)} test files; all of these pass without a mutant: ", end="", flush=True
        )
        copy.require_passing(tests)
        print("yes", flush=True)
        for number, mutant in enumerate(chosen, 1):
            outcome = copy.judge(mutant)
            outcomes.append(outcome)
            said = f"caught ({outcome.by})" if outcome.by else "SURVIVES"
            print(f"{number:4d}  {outcome.seconds:6.1f} s  {said}  {mutant}", flush=True)
    print(summary(outcomes))
    survivors = [outcome.mutant for outcome in outcomes if not outcome.by]
    unexplained = [mutant for mutant in survivors if not mutant.reason]
    return int(bool(unexplained) or len(outcomes) - len(survivors) < LEAST_SHARE * len(outcomes))


if __name__ == "__main__":
    sys.exit(main())

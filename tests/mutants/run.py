"""Run the tests of every mutant in a copy of the project; the checkout is never touched."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.mutants.mutant import Mutant

ROOT = Path(__file__).parents[2]
LEFT_OUT = (".*", "__pycache__", "*.egg-info", "runs", "node_modules")


@dataclass(frozen=True)
class Outcome:
    """What became of a mutant.

    Parameters
    ----------
    mutant : Mutant
    by : str
        The test that caught it; empty if none did.
    seconds : float
    """

    mutant: Mutant
    by: str
    seconds: float


@dataclass(frozen=True)
class Copy:
    """A copy of the project in which mutants live.

    Parameters
    ----------
    root : Path
    timeout_s : float
        Tests of one mutant that take longer have caught it: it hangs.
    """

    root: Path
    timeout_s: float = 300.0

    def run(self, tests: Iterable[str], timeout_s: float | None, *, keep_compiled: bool = False) -> str:
        """Run test files up to the first failure; return what failed, or nothing."""
        words = ["-m", "pytest", "-x", "-q", "--no-header", "--tb=line", "-p", "no:cacheprovider", *tests]
        settings = {**os.environ, "PYTHONPATH": str(self.root), "PYTHONDONTWRITEBYTECODE": "" if keep_compiled else "1"}
        try:
            done = subprocess.run(
                [sys.executable, *words],
                cwd=self.root, env=settings, timeout=timeout_s, capture_output=True, text=True,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return "no end"
        if done.returncode == 0:
            return ""
        failed = [line.split(" - ")[0] for line in done.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
        return failed[0] if failed else f"pytest ended with {done.returncode}"

    def require_passing(self, tests: Iterable[str]) -> None:
        """Refuse a project whose tests fail by themselves: they would catch everything."""
        if failed := self.run(tests, None, keep_compiled=True):
            raise SystemExit(f"error: without any mutant: {failed}")

    def judge(self, mutant: Mutant) -> Outcome:
        """Run the mutant's tests until one fails. That they cannot even be collected counts as well."""
        started = time.monotonic()
        with self._mutated(mutant):
            by = self.run(mutant.tests, self.timeout_s)
        return Outcome(mutant, by, time.monotonic() - started)

    @contextmanager
    def _mutated(self, mutant: Mutant) -> Iterator[None]:
        path = self.root / mutant.file
        original = path.read_text(encoding="utf-8")
        for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*"):
            compiled.unlink()  # it might pass for that of the mutant, which can have its size and its time
        try:
            path.write_text(mutant.applied(original), encoding="utf-8")
            yield
        finally:
            path.write_text(original, encoding="utf-8")


@contextmanager
def copied(root: Path = ROOT, **knobs: float) -> Iterator[Copy]:
    """Copy the project to a temporary folder."""
    with TemporaryDirectory(prefix="mutants-") as folder:
        copy = Path(folder) / root.name
        shutil.copytree(root, copy, ignore=shutil.ignore_patterns(*LEFT_OUT), symlinks=True)
        yield Copy(copy, **knobs)


def summary(outcomes: list[Outcome]) -> str:
    """Return the figures, and every survivor with its reason."""
    survivors = [outcome.mutant for outcome in outcomes if not outcome.by]
    equivalent = [mutant for mutant in survivors if mutant.equivalent]
    caught, counted = len(outcomes) - len(survivors), len(outcomes) - len(equivalent)
    lines = [
        f"{len(outcomes)} mutants, {caught} caught, {len(survivors)} survive, {len(equivalent)} of them equivalent",
        f"caught: {100 * caught / max(len(outcomes), 1):.1f} % of all, "
        f"{100 * caught / max(counted, 1):.1f} % of those that are not equivalent",
    ]
    lines += [f"survives: {mutant}\n    {mutant.reason or 'NO REASON GIVEN'}" for mutant in survivors]
    expected = [outcome for outcome in outcomes if outcome.by and outcome.mutant.reason]
    lines += [f"caught, though listed as a survivor: {outcome.mutant}" for outcome in expected]
    return "\n".join(lines)

"""A mutant: one place of the code written otherwise."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import yaml

TABLE = Path(__file__).parent / "table.yaml"


@dataclass(frozen=True)
class Mutant:
    """One place of the code written otherwise.

    Parameters
    ----------
    file : str
        Path in the project.
    old, new : str
        ``old`` stands in the file exactly once.
    tests : tuple of str
        Paths in the project of the test files that should see it, in this order.
    equivalent, survives : str
        Why no test can see it; why none does. Empty where one should.
    """

    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    equivalent: str = ""
    survives: str = ""

    @property
    def reason(self) -> str:
        """Why it is expected to survive; empty where it is not."""
        return f"equivalent: {self.equivalent}" if self.equivalent else self.survives

    def applied(self, text: str) -> str:
        """Return the file's text with the place written otherwise; ValueError where it does not stand there once."""
        if text.count(self.old) != 1 or self.old == self.new:
            raise ValueError(f"{self.file}: {self.old!r} stands there {text.count(self.old)} times")
        return text.replace(self.old, self.new)

    def __str__(self) -> str:
        return f"{self.file}: {self.old} -> {self.new or '(nothing)'}"


def mutants(table: Path = TABLE) -> list[Mutant]:
    """Read the table."""
    found = []
    for file, part in yaml.safe_load(table.read_text(encoding="utf-8")).items():
        for entry in part["mutants"]:
            tests = entry.pop("tests", part["tests"]).split()
            paths = tuple((Path("tests") / f"{name}.py").as_posix().replace("tests/../", "") for name in tests)
            found.append(Mutant(f"dlwpredict/{file}", tests=paths, **entry))
    return found

"""Imports point downwards, and every command is documented."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import dlwpredict
from dlwpredict.cli.commands import NAMES

ROOT = Path(dlwpredict.__file__).parent

LAYERS = [
    {"errors", "lab"},
    {"heightmap"},
    {"parameters"},
    {"numerics", "noise"},
    {"metrology", "solid", "model", "designs"},
    {"effects"},
    {"process"},
    {"alignment", "correction"},
    {"infer"},
    {"calibration", "diagnosis"},
    {"files"},
    {"batch", "pairing"},
    {"tiling"},
    {"plots"},
    {"api"},
    {"pages"},
    {"cli"},
]
LEVEL = {name: level for level, names in enumerate(LAYERS) for name in names}

DIAGNOSE = [
    {"policy"},
    {"library", "structure"},
    {"posterior"},
    {"starts"},
    {"refits"},
    {"search"},
    {"classes"},
    {"judge"},
    {"run"},
    {"answer"},
]
"""What a diagnosis consists of, from below."""

EXCEPTIONS = {
    ("cli.app", ""): "shows the program's version",
    ("files.resume", ""): "what another version began is not gone on with",
    ("files.provenance", ""): "records the program's version",
    ("batch.records", ""): "a result of another version is made again",
    ("tiling.large", ""): "tiles of another version are made again",
}
"""(importing module, imported name) that may break the rule, each with its reason."""


def modules():
    return sorted(ROOT.rglob("*.py"))


def imports_of(path: Path) -> set[str]:
    """Return the parts of the package that a file imports: `model`, `errors`, ... and "" for the package itself."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = (
                [f"{node.module}.{alias.name}" for alias in node.names]
                if node.module == "dlwpredict"
                else [node.module]
            )
            assert node.level == 0, f"{path}: relative import"
        found |= {(name + ".").split(".")[1] for name in names if name and name.split(".")[0] == "dlwpredict"}
    return found


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_point_downwards(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    own = parts[0]
    if own == "__init__":
        assert not imports_of(path)
        return
    for other in imports_of(path) - {own}:
        if (".".join(parts), other) not in EXCEPTIONS:
            assert LEVEL[other] < LEVEL[own], f"{'.'.join(parts)} imports {other}, which stands no lower"


def of_diagnosis(name: str) -> int:
    """Return the layer of a module inside `diagnosis`."""
    return next(level for level, parts in enumerate(DIAGNOSE) if name.split(".")[0] in parts)


def inner_imports_of(path: Path) -> set[str]:
    """Return the modules of `diagnosis` that a file imports from."""
    nodes = (node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.ImportFrom))
    found = {f"{node.module}.{alias.name}" for node in nodes for alias in node.names}
    return {name.removeprefix("dlwpredict.diagnosis.") for name in found if name.startswith("dlwpredict.diagnosis.")}


@pytest.mark.parametrize("path", sorted((ROOT / "diagnosis").rglob("[!_]*.py")), ids=lambda path: path.stem)
def test_imports_inside_the_diagnosis_point_one_way(path):
    own = ".".join(path.relative_to(ROOT / "diagnosis").with_suffix("").parts)
    for other in inner_imports_of(path):
        beside = of_diagnosis(other) == of_diagnosis(own) and other.split(".")[0] == own.split(".")[0]
        assert of_diagnosis(other) < of_diagnosis(own) or beside, f"{own} imports {other}, which stands no lower"


def test_what_is_inferred_knows_nothing_of_who_asks():
    assert not {"calibration", "diagnosis"} & set().union(
        *(imports_of(path) for path in (ROOT / "infer").rglob("*.py"))
    )


@pytest.mark.parametrize("path", sorted((ROOT / "cli").glob("*.py")), ids=lambda path: path.stem)
def test_commands_do_not_compute(path):
    """They read, call, write and say; but for `streams`, which writes numpy's numbers as JSON."""
    names = {
        name.split(".")[0]
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in ([node.module] if isinstance(node, ast.ImportFrom) else [alias.name for alias in node.names])
    }
    assert not {"numpy", "scipy"} & names or path.stem == "streams"


MOST_ARGUMENTS = 8


@pytest.mark.parametrize("path", [p for p in modules() if "cli" not in p.parts], ids=lambda p: str(p.relative_to(ROOT)))
def test_no_function_takes_more_than_eight_arguments(path):
    """But for commands, whose arguments are options, and `declare`, which lists the columns of a table."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef) and node.name != "declare":
            names = [one.arg for one in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
            assert len([n for n in names if n not in ("self", "cls")]) <= MOST_ARGUMENTS, f"{path}: {node.name}"


def test_every_part_has_a_layer():
    parts = {path.relative_to(ROOT).with_suffix("").parts[0] for path in modules()} - {"__init__"}
    assert parts == set(LEVEL)


def test_readme_names_every_command():
    readme = (ROOT.parent / "README.md").read_text(encoding="utf-8")
    assert [name for name in NAMES if f"`{name}" not in readme] == []


def test_nothing_heavy_is_imported_for_help():
    """Matplotlib and trimesh cost seconds; `--help` must not pay for them."""
    code = "import sys, dlwpredict.cli; print([m for m in ('matplotlib', 'trimesh') if m in sys.modules])"
    assert (
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "[]"
    )

"""The documentation is true: the reference is fresh, examples and tutorial run, links lead somewhere."""

import ast
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from typer.main import get_command
from typer.testing import CliRunner

import dlwpredict as dlw
from dlwpredict.cli import app
from dlwpredict.designs import air, cin
from dlwpredict.effects import library
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.parameters_yaml import read_parameters, write_parameters
from dlwpredict.parameters import Paper, ParameterSet, declarations
from dlwpredict.process import predict

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
GALLERY = sorted((DOCS / "gallery").glob("*.py"))
PAGES = [*DOCS.glob("*.md"), *ROOT.glob("*.md"), *(path for path in ROOT.glob("[cst]*/**/README.md"))]


def commands(group=None, name=""):
    """Return every command by its words, those of groups included."""
    found = {}
    for word, command in (group or get_command(app)).commands.items():
        words = f"{name} {word}".strip()
        found |= commands(command, words) if hasattr(command, "commands") else {words: command}
    return found


def example(command):
    lines = [line.strip()[2:] for line in (command.help or "").splitlines() if line.strip().startswith("$ ")]
    return lines[0] if lines else None


@pytest.mark.slow
def test_the_reference_is_what_the_commands_say():
    """With another typer the wording may differ, the headings and options may not."""
    kept = (DOCS / "commands.md").read_text(encoding="utf-8")
    made = runpy.run_path(str(DOCS / "make.py"))["commands"]()
    if f"typer {metadata.version('typer')};" in kept:
        assert made == kept, "docs/commands.md is stale: make docs"
    names = re.compile(r"^#+ .*$|`--?[a-z][\w-]*", re.MULTILINE)
    assert sorted(names.findall(made)) == sorted(names.findall(kept)), "docs/commands.md is stale: make docs"


def test_the_pages_that_are_made_are_fresh():
    made = runpy.run_path(str(DOCS / "make.py"))
    for name in ("effects", "evidence"):
        assert made[name]() == (DOCS / f"{name}.md").read_text(encoding="utf-8"), f"docs/{name}.md is stale: make docs"
    drawn = {path.stem for path in (DOCS / "signatures").glob("*.png")}
    assert drawn == set(library()), "docs/signatures is stale: make pictures"


@pytest.mark.parametrize(
    ("value", "wanted", "expected"),
    [
        (0.95, ">= 95 %", True),
        (0.949, ">= 95 %", False),
        (0.02, "<= 2 %", True),
        (0.021, "<= 2 %", False),
        (0.79, "90 to 98 %", False),
        (0.99, "90 to 98 %", False),
        (0.92, "90 to 98 %", True),
        (1.2, "<= 1.1", False),
        (-0.028, "within 10 %", True),
        (0.0, "0", True),
        (0.1, "0", False),
        (1.0, "100 %", True),
        (0.99, "100 %", False),
        (0.66, "all", False),
        (0.5, "", None),
        (None, ">= 95 %", None),
    ],
)
def test_what_was_missed_is_called_missed(value, wanted, expected):
    assert runpy.run_path(str(DOCS / "make.py"))["met"](value, wanted) is expected


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= 900


def test_every_page_can_be_reached():
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    for page in DOCS.glob("*.md"):
        assert page.stem == "index" or re.search(rf"^{page.stem}$", index, re.MULTILINE), page.name


def test_every_command_has_an_example_of_its_own():
    assert {name: example(command) for name, command in commands().items() if not example(command)} == {}
    for name, command in commands().items():
        assert example(command).startswith(f"dlwpredict {name}"), name


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with small files under the names of the examples."""
    folder = tmp_path_factory.mktemp("bench")
    truth = ParameterSet(Paper(threshold=0.4, shrinkage_max=0.9))
    write_parameters(folder / "process.yaml", truth)
    generator = np.random.default_rng(1)
    (folder / "runs" / "demo" / "air").mkdir(parents=True)
    for name, part in (
        ("air", air(size_um=20, pitch_um=0.5, margin_um=4)),
        ("cin", cin(size_um=20, pitch_um=0.5, margin_um=4)),
    ):
        printed = predict(part, truth).heights_um
        noise = gaussian_filter(generator.normal(0, 0.03, part.shape), 1.0)  # over about 1 µm, as a microscope's is
        recording = part.with_heights(printed + noise)
        for place, one in (("", part), ("_aligned", recording)):
            write_height_map(folder / f"{name}{place}.tif", one)
    for names in (
        ("air", "target", "corrected", "runs/demo/air/target"),
        ("air_aligned", "recording", "aligned", "runs/demo/air/aligned"),
    ):
        for name in names[1:]:
            shutil.copy(folder / f"{names[0]}.tif", folder / f"{name}.tif")
    manifest = "format: dlwpredict-batch/1\nstructures: [air.tif, cin.tif]\n"
    (folder / "manifest.yaml").write_text(f"{manifest}commands: ['export-stl {{target}} -o {{name}}.stl']\n")
    np.savetxt(folder / "scan.txt", 1e-6 * read_height_map(folder / "recording.tif").heights_um, delimiter="\t")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(commands()))
def test_the_example_runs(name, bench, tmp_path, monkeypatch):
    shutil.copytree(bench, tmp_path / "bench")
    monkeypatch.chdir(tmp_path / "bench")
    command = commands()[name]
    words = shlex.split(example(command))[1:]
    if name == "verify":  # the files must say what they were made from
        for before in ("calibrate", "precompensate", "export-stl"):
            again = example(commands()[before]).replace(" part.stl", " corrected.stl")
            assert CliRunner().invoke(app, [*shlex.split(again)[1:], "--overwrite"]).exit_code == 0
    if any("--overwrite" in getattr(option, "opts", ()) for option in command.params):
        words.append("--overwrite")
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    for option in ("-o", "--json", "--plot", "--report", "--params-out"):
        if option in words:
            assert Path(words[words.index(option) + 1]).stat().st_size > 0


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
def test_the_tutorial_runs(tmp_path):
    text = (DOCS / "tutorial.md").read_text(encoding="utf-8")
    script = "\n".join(re.findall(r"```sh\n(.*?)```", text, re.DOTALL))
    assert script.count("dlwpredict ") >= 10
    for folder in ("sample_data", "configs"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    result = subprocess.run(
        ["bash", "-euc", script], cwd=tmp_path, env={**os.environ, "PATH": path}, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stdout + result.stderr
    made = tmp_path / "tutorial"
    assert (made / "cin_corrected.stl").stat().st_size > 1000
    target, aligned, following = (
        read_height_map(made / f"{name}.tif").heights_um for name in ("cin_target", "cin_aligned", "cin_next")
    )
    inside = slice(40, -40), slice(40, -40)
    before, after = (np.sqrt(np.nanmean((one - target)[inside] ** 2)) for one in (aligned, following))
    assert after < 0.2 * before


def anchors(page):
    """Return the anchors of a page's headings, as GitHub and the site make them."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    headings = re.findall(r"^#+ +(.+?) *$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files_and_headings(page):
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if "://" in link:
            continue
        path, _, anchor = link.partition("#")
        to = page.parent / path if path else page
        assert to.exists(), link
        assert not anchor or anchor in anchors(to), link


@pytest.mark.parametrize("path", GALLERY, ids=lambda path: path.stem)
def test_an_example_of_the_gallery_uses_the_interface_alone(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    compile(tree, path, "exec")
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    imported |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert "dlwpredict" in imported and not any(name.startswith("dlwpredict.") for name in imported)
    assert {name.partition(".")[0] for name in imported} <= {
        "dlwpredict",
        "numpy",
        "matplotlib",
    } | sys.stdlib_module_names
    used = {
        node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "dlw"
    }
    assert used and used <= set(dlw.__all__)


def test_the_gallery_is_linked():
    assert len(GALLERY) >= 3 and "examples/index" in (DOCS / "index.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_an_example_of_the_gallery_runs(tmp_path):
    """`make site` runs all of them."""
    command = [sys.executable, "-W", "error", DOCS / "gallery" / "correct_lens.py"]
    environment = {**os.environ, "MPLBACKEND": "agg"}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, encoding="utf-8")
    assert done.returncode == 0, done.stderr
    assert "lens.stl" in done.stdout and not list(tmp_path.iterdir())


def test_the_page_on_parameters_says_what_the_program_holds():
    text = (DOCS / "parameters.md").read_text(encoding="utf-8")
    for name, (default, known) in declarations(Paper).items():
        row = next(line for line in text.splitlines() if line.startswith(f"| `{name}`"))
        unit = "" if known.unit == "1" else " µm"
        assert f"| {default if unit == '' else f'{default:g}'}{unit}, {known.low:g} to {known.high:g} |" in row


def test_every_parameter_set_of_the_configs_is_read_and_listed():
    listed = (ROOT / "configs" / "README.md").read_text(encoding="utf-8")
    sets = [path for path in (ROOT / "configs").glob("*.yaml") if "dlwpredict-parameters/1" in path.read_text()]
    assert len(sets) >= 3
    for path in sets:
        paper = read_parameters(path).paper
        row = next(line for line in listed.splitlines() if line.startswith(f"| `{path.name}`"))
        assert f"{paper.exposure_fwhm_xy_um:g}, {paper.exposure_fwhm_z_um:g} µm" in row
        assert f"{paper.crosslink_fwhm_xy_um:g}, {paper.crosslink_fwhm_z_um:g} µm" in row


def test_the_version_comes_with_those_of_the_libraries():
    said = CliRunner().invoke(app, ["--version"]).stdout.splitlines()
    found = dict(line.split(maxsplit=1) for line in said)
    assert found["numpy"] == metadata.version("numpy")
    assert found["dlwpredict"] == metadata.version("dlwpredict")
    assert {"python", "scipy", "typer", "tifffile", "trimesh"} <= found.keys()

"""Ask the program: `dlwpredict diagnose` as a subprocess that sees opaque files only."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import yaml

import dlwpredict
from dlwpredict.files.atomic import write_text
from tests.prove.sealed import Folder

LONGEST_S = 900.0
"""A diagnosis that takes longer has failed."""


def code_sha256() -> str:
    """Return the SHA-256 of the program under test, all its files together."""
    root, digest = Path(dlwpredict.__file__).parent, hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return digest.hexdigest()


def answered(folder: Path, name: str, code: str) -> dict | None:
    """Return the answer on file, None where there is none or another state of the program gave it."""
    kept = Folder(folder).answer(name)
    answer = json.loads(kept.read_text()) if kept.exists() else {"code": None}
    return answer if answer["code"] == code else None


def ask(folder: Path, name: str, code: str) -> dict:
    """Return the program's answer to a case; the one on file where this state of the program gave it."""
    place = Folder(folder)
    if (answer := answered(folder, name, code)) is not None:
        return answer
    kept = place.answer(name)
    kept.parent.mkdir(parents=True, exist_ok=True)
    pairs = len(list(place.data(name).glob("target_*.tif")))
    words = [word for k in range(pairs) for word in ("--pair", f"target_{k}.tif", f"recording_{k}.tif")]
    if (further := place.data(name) / "words.json").exists():
        words += json.loads(further.read_text())
    with tempfile.TemporaryDirectory() as out:
        said, process = Path(out, "diagnosis.yaml"), Path(out, "extended.yaml")
        command = [sys.executable, "-c", "from dlwpredict.cli import main; main()", "diagnose", *words]
        command += ["-o", str(said), "--params-out", str(process), "--no-advice", "--jobs", "1", "--quiet"]
        started = time.perf_counter()
        status, complaint = _run(command, place.data(name))
        answer = {"code": code, "seconds": time.perf_counter() - started, "status": status, "complaint": complaint}
        if status == 0:
            answer |= {"diagnosis": _loaded(said), "extended": _loaded(process)}
    write_text(kept, json.dumps(answer, indent=1) + "\n")
    return answer


def _run(command: list[str], where: Path) -> tuple[int, str]:
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            command, cwd=where, env=environment, capture_output=True, text=True, timeout=LONGEST_S, check=False
        )
    except subprocess.TimeoutExpired:
        return -1, f"took longer than {LONGEST_S:.0f} s"
    return done.returncode, (done.stderr.strip().splitlines() or [""])[-1] if done.returncode else ""


def _loaded(path: Path) -> dict:
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    content.pop("provenance", None)
    return content

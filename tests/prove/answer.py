"""Ask the program: `dlwpredict align` where a recording is raw, then `diagnose`, as subprocesses on opaque files."""

from __future__ import annotations

import hashlib
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import yaml

import dlwpredict
from dlwpredict.files.atomic import write_text
from tests.prove.sealed import Folder

PROGRAM = Path(sys.executable)
"""Interpreter of the program that is asked."""

LONGEST_S, WALL = 900.0, 4.0
"""A command that takes more CPU seconds has failed, or so many times as long by the clock: cores may be shared."""


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
    answer = {"code": code, **_aligned(place, name)}
    if answer["status"] == 0:
        answer |= diagnosed(place, name)
    write_text(kept, json.dumps(answer, indent=1) + "\n")
    return answer


def pairs_of(place: Folder, name: str) -> range:
    """Return the numbers of a case's pairs."""
    return range(len(list(place.data(name).glob("target_*.tif"))))


def _aligned(place: Folder, name: str) -> dict:
    """Have every raw recording laid on its target."""
    told = {"status": 0, "complaint": "", "seconds": 0.0, "cpu_s": 0.0, "align_cpu_s": 0.0}
    for k in pairs_of(place, name):
        raw = place.data(name) / f"raw_{k}.tif"
        if raw.exists() and told["status"] == 0:
            laid = place.aligned(name, k).absolute()
            laid.parent.mkdir(parents=True, exist_ok=True)
            words = ["align", raw.name, f"target_{k}.tif", "-o", str(laid), "--overwrite", "--quiet"]
            status, complaint, cpu_s = ran(command_of(words), raw.parent)
            told |= {"status": status, "complaint": complaint, "align_cpu_s": told["align_cpu_s"] + cpu_s}
    return told


def diagnosed(place: Folder, name: str, program: Path = PROGRAM, longest_s: float = LONGEST_S) -> dict:
    """Have a case whose recordings lie on their targets diagnosed, by the program of some interpreter."""
    pairs = pairs_of(place, name)
    recordings = [place.recording(name, k).absolute() for k in pairs]
    words = [word for k in pairs for word in ("--pair", f"target_{k}.tif", str(recordings[k]))]
    if (further := place.data(name) / "words.json").exists():
        words += json.loads(further.read_text())
    with tempfile.TemporaryDirectory() as out:
        said, process = Path(out, "diagnosis.yaml"), Path(out, "extended.yaml")
        words += ["-o", str(said), "--params-out", str(process), "--no-advice", "--jobs", "1", "--quiet"]
        started = time.perf_counter()
        status, complaint, cpu_s = ran(command_of(["diagnose", *words], program), place.data(name), longest_s)
        told = {"seconds": time.perf_counter() - started, "cpu_s": cpu_s, "status": status, "complaint": complaint}
        return told | ({"diagnosis": _loaded(said), "extended": _loaded(process)} if status == 0 else {})


def command_of(words: list[str], program: Path = PROGRAM) -> list[str]:
    return [str(program), "-c", "from dlwpredict.cli import main; main()", *words]


def ran(command: list[str], where: Path, longest_s: float = LONGEST_S) -> tuple[int, str, float]:
    """Return exit status, complaint, and the CPU seconds of a command and all its processes."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    with tempfile.TemporaryFile() as told:
        process = subprocess.Popen(command, cwd=where, env=environment, stdout=subprocess.DEVNULL, stderr=told)
        resource.prlimit(process.pid, resource.RLIMIT_CPU, (int(longest_s), int(longest_s)))
        overdue = threading.Timer(WALL * longest_s, process.kill)
        overdue.start()
        _, waited, used = os.wait4(process.pid, 0)
        late, process.returncode = not overdue.is_alive(), os.waitstatus_to_exitcode(waited)
        overdue.cancel()
        told.seek(0)
        lines = told.read().decode(errors="replace").strip().splitlines()
    cpu_s = used.ru_utime + used.ru_stime
    if late or -process.returncode in (signal.SIGXCPU, signal.SIGKILL):
        return -1, f"took longer than {longest_s:.0f} s", cpu_s
    return process.returncode, (lines or [""])[-1] if process.returncode else "", cpu_s


def _loaded(path: Path) -> dict:
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    content.pop("provenance", None)
    return content

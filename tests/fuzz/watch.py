"""Read bad files in a process of its own, and say what went wrong: time, memory, tracebacks, other files touched."""

import json
import mmap
import os
import re
import resource
import signal
import struct
import sys
import time
import traceback
import warnings
import zlib
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from dlwpredict.cli.console import fault
from dlwpredict.errors import InputError
from tests.fuzz.readers import Reader

SECONDS = 10
BYTES = 2**30
Make = Callable[[np.random.Generator], tuple[str, bytes]]

_FORBIDDEN = re.compile(
    r"os\.(system|exec|posix_spawn|spawn|fork|remove|rename|rmdir|mkdir|link|symlink|chmod|chown|truncate)|subprocess\.|"
    r"shutil\.|socket\.|urllib\.|ftplib\.|http\.|pickle\.find_class|ctypes\.dlopen|webbrowser\.|smtplib\."
)
_CODE = (sys.prefix, sys.base_prefix, str(Path(__file__).resolve().parents[2] / "dlwpredict"), "<frozen")


def watched(reader: Reader, count: int, make: Make, folder: Path, seed: int = 0) -> dict:
    """Read ``count`` files made from numbered generators; return counts, the slowest, and every fault with its number.

    A fault is anything but a height map or an error in one line that names the file: another exception, more than
    10 s of processor time or 1 GB, a warning, text on stdout or stderr, code run, or any other file touched.
    """
    shared = mmap.mmap(-1, 16)
    total, faults, slowest, largest, first = Counter(), [], 0.0, 0, 0
    while first < count:
        log = folder / "log.jsonl"
        child = os.fork()
        if child == 0:
            os._exit(_work(reader, first, count, make, folder, seed, shared, log))
        ended = _wait(child, shared)
        done = [json.loads(line) for line in log.read_text().splitlines()]
        for entry in done:
            total[entry["end"]] += 1
            slowest, largest = max(slowest, entry["seconds"]), max(largest, entry["bytes"])
            faults += [entry] if entry["end"] == "fault" else []
        first = done[-1]["number"] + 1 if done else first
        if ended and first < count:
            total["fault"] += 1
            faults.append({"number": first, "fault": ended})
            first += 1
    return {"ends": dict(total), "slowest_s": slowest, "largest_bytes": largest, "faults": faults}


def _wait(child: int, shared: mmap.mmap) -> str:
    """Wait for the end of a process; kill it where one file takes too long."""
    while True:
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            return "" if status == 0 else f"process ended with status {status}"
        (started,) = struct.unpack("d", shared[:8])
        if started and _processor_s(child) - started > SECONDS:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return f"took more than {SECONDS} s"
        time.sleep(0.01)


def _processor_s(process: int) -> float:
    """Return the processor time of a process, s: other programs on the machine do not count."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _work(reader, first, count, make, folder, seed, shared, log) -> int:
    touched = _listening(folder)
    warnings.simplefilter("error")
    outputs = (folder / "said").open("w+b")
    os.dup2(outputs.fileno(), 1)
    os.dup2(outputs.fileno(), 2)
    _limit_memory()
    base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with log.open("w", buffering=1) as stream:
        for number in range(first, count):
            rng = np.random.default_rng([seed, zlib.crc32(reader.name.encode()), number])
            ending, content = make(rng)
            path = folder / f"bad{ending}"
            path.write_bytes(content)
            touched.clear()
            started = time.process_time()
            shared[:8] = struct.pack("d", started)
            end, wrong = _outcome(reader, path, rng)
            seconds = time.process_time() - started
            shared[:8] = struct.pack("d", 0.0)
            wrong = wrong or (f"touched {touched[0]}" if touched else "")
            if outputs.tell() or os.fstat(outputs.fileno()).st_size:
                wrong = wrong or "said " + (folder / "said").read_text(errors="replace")[:300]
                os.ftruncate(outputs.fileno(), 0)
                outputs.seek(0)
            grown = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - base)
            entry = {"number": number, "end": "fault" if wrong else end, "seconds": seconds, "bytes": grown}
            stream.write(json.dumps(entry | ({"fault": wrong, "ending": ending} if wrong else {})) + "\n")
            path.unlink()
    return 0


def _outcome(reader: Reader, path: Path, rng: np.random.Generator) -> tuple[str, str]:
    """Return how reading ended, and what is wrong with that."""
    try:
        reader.read(path, rng)
    except InputError as error:
        said = fault(error)
        short = len(said) < 4100 and said.isprintable() and said.startswith(f"error: {path}: ")
        scarce = re.search("MemoryError|Unable to allocate|not enough memory", said)
        return "refused", "" if short and not scarce else f"said {said[:300]!r}"
    except BaseException:
        return "fault", traceback.format_exc()[-1500:]
    return "read", ""


def _limit_memory() -> None:
    """Let this process take up to 1 GB more than it has."""
    status = Path("/proc/self/status").read_text()
    taken = 1024 * int(re.search(r"VmData:\s+(\d+)", status)[1])
    resource.setrlimit(resource.RLIMIT_DATA, (taken + BYTES, taken + BYTES))


def _where(event: str, arguments: tuple) -> str:
    """Return the path that an event of the system is about; a folder that is cleared names it by a descriptor."""
    path = str(arguments[0]) if arguments else ""
    held = arguments[1] if event in ("os.remove", "os.rmdir") else -1
    return str(Path(f"/proc/self/fd/{held}").readlink() / path) if held >= 0 else path


def _listening(folder: Path) -> list[str]:
    """Return a list that fills with everything done beyond reading the one file and the program's own code."""
    touched: list[str] = []
    own = str(folder)

    def hook(event: str, arguments: tuple) -> None:
        if event == "open":
            path, _, flags = arguments
            text = os.fsdecode(path) if isinstance(path, (str, bytes)) else ""
            written = isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
            harmless = text == os.devnull or (not written and text.startswith((*_CODE, "/proc", "/sys", "/etc")))
            if not harmless and not text.startswith(own):
                touched.append(f"open {text!r} {flags}") if text else None
        elif _FORBIDDEN.match(event) and not _where(event, arguments).startswith(own):
            touched.append(f"{event} {arguments!r}"[:200])

    sys.addaudithook(hook)
    return touched

"""Run a command in a process of its own and kill it at a moment of its writing."""

import os
import resource
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import dlwpredict.pages.diagnosis
import dlwpredict.plots  # noqa: F401
from dlwpredict.cli.app import app


def run(
    words: Sequence[str],
    folder: Path,
    *,
    kill_after: float | None = None,
    largest: int | None = None,
) -> tuple[int, str, float]:
    """Run a command in a folder; return its status, stderr, and seconds from its first output file to its end.

    Parameters
    ----------
    kill_after : float, optional
        Seconds after the first output file was begun at which SIGKILL is sent.
    largest : int, optional
        Files can grow to this many bytes only.
    """
    begun, begin = os.pipe()
    said, say = os.pipe()
    child = os.fork()
    if child == 0:
        _work(words, folder, begin, say, largest)
    os.close(begin)
    os.close(say)
    os.read(begun, 1)  # returns at the first output file, or at the end
    started = time.perf_counter()
    if kill_after is not None:
        while time.perf_counter() < started + kill_after and not _ended(child):
            time.sleep(2e-4)
        os.kill(child, signal.SIGKILL)
    stderr = b"".join(iter(lambda: os.read(said, 65536), b"")).decode()
    _, status = os.waitpid(child, 0)
    seconds = time.perf_counter() - started
    os.close(begun)
    os.close(said)
    return os.waitstatus_to_exitcode(status), stderr, seconds


def _ended(child: int) -> bool:
    return os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


def _work(words, folder, begin, say, largest) -> None:
    status = 70
    try:
        os.chdir(folder)
        os.dup2(say, 2)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        sys.stderr = os.fdopen(2, "w")
        sys.stdout = os.fdopen(1, "w")
        if largest is not None:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))
        sys.addaudithook(lambda event, _: event == "tempfile.mkstemp" and os.write(begin, b"x"))
        app(list(words), standalone_mode=True)
    except SystemExit as ended:
        status = ended.code or 0
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(status)

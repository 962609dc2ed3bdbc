"""Fails each call that changes a file, one after the other: ``python faulty_disk.py CASES``.

Each case forks a process that writes over a file while the n-th call below its folder fails, until
a write succeeds. The error must be typed, the old file (or the new one) whole, and nothing else
may be there after the next write. `faulty_disk.cpp` is compiled and preloaded.
"""

from __future__ import annotations

import ctypes
import errno
import itertools
import logging
import os
import subprocess
import sys
import tempfile
from pathlib import Path

ERRORS = (errno.ENOSPC, errno.EIO)
MAX_CALLS = 400
TYPED, FOREIGN, DONE = 11, 12, 13
"""Exit codes of a writer."""


def preloaded(folder: Path) -> Path:
    """Compile the library."""
    library = folder / "faulty_disk.so"
    source = Path(__file__).with_suffix(".cpp")
    subprocess.run(
        ["g++", "-std=c++20", "-O1", "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True
    )
    return library


def outcome(name: str, folder: Path, which: int, call: int, error: int, stays: bool) -> int:
    """Write in a child process whose n-th call fails; its exit code, negative for a signal."""
    from killed_writers import WRITERS

    from manip3d import Error

    child = os.fork()
    if child == 0:
        code = FOREIGN
        try:
            ctypes.CDLL(None).arm(os.fsencode(folder), ctypes.c_long(call), error, int(stays))
            WRITERS[name](folder, which)
            code = DONE
        except (Error, OSError):
            code = TYPED
        except BaseException as foreign:
            print(f"{name}, call {call}, {os.strerror(error)}: {foreign!r}", flush=True)
        finally:
            os._exit(code)
    status = os.waitpid(child, 0)[1]
    return -os.WTERMSIG(status) if os.WIFSIGNALED(status) else os.WEXITSTATUS(status)


def findings(name: str, error: int, stays: bool) -> tuple[int, list[str]]:
    """All calls of one writer in turn: the cases, and what is wrong."""
    from killed_writers import COMPANIONS, WRITERS, left_by, look, whole

    old, new = whole(name, 0), whole(name, 1)
    wrong = []
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place).resolve()
        WRITERS[name](folder, 0)
        for call in range(1, MAX_CALLS):
            code = outcome(name, folder, 1, call, error, stays)
            found = look(name, folder)
            case = f"{name}, call {call}, {os.strerror(error)}{' for good' if stays else ''}"
            if code not in (TYPED, DONE):
                wrong.append(f"{case}: ended with {code}")
            companion = COMPANIONS.get(name)
            missing = (set(old) & set(new)) - {companion} - set(found)
            torn = [
                file for file, data in found.items() if data not in (old.get(file), new.get(file))
            ]
            if companion in found and found not in (old, new):
                wrong.append(f"{case}: {companion} is not of the file beside it")
            if missing or torn:
                wrong.append(f"{case}: missing {sorted(missing)}, torn {torn}")
            if code == DONE and any(found.get(file) != data for file, data in new.items()):
                wrong.append(f"{case}: no error, but not written")
            WRITERS[name](folder, 0)
            if left_by(folder):
                wrong.append(f"{case}: {left_by(folder)} temporary files outlive the next write")
            counted = ctypes.CDLL(None).arm(b"", ctypes.c_long(0), 0, 0)
            if code == DONE and not is_reached(name, folder, call):
                return call, wrong
            assert counted == 0  # the parent's calls are not counted
    return MAX_CALLS, wrong


def is_reached(name: str, folder: Path, call: int) -> bool:
    """Whether an undisturbed write makes at least ``call`` calls."""
    from killed_writers import WRITERS

    arm = ctypes.CDLL(None).arm
    arm.restype = ctypes.c_long
    arm(os.fsencode(folder), ctypes.c_long(0), 0, 0)
    WRITERS[name](folder, 0)
    return bool(arm(b"", ctypes.c_long(0), 0, 0) >= call)


def main() -> int:
    """Go through all writers until there were so many cases."""
    if "faulty_disk.so" not in os.environ.get("LD_PRELOAD", ""):
        with tempfile.TemporaryDirectory() as place:
            library = str(preloaded(Path(place)))
            environment = {**os.environ, "LD_PRELOAD": library}
            return subprocess.run(
                [sys.executable, *sys.argv], env=environment, check=False
            ).returncode

    from killed_writers import WRITERS

    logging.getLogger("manip3d").setLevel(logging.ERROR)  # what formats cannot hold
    wanted, cases, wrong = int(sys.argv[1]), 0, []
    rounds = itertools.product((False, True), ERRORS, WRITERS)
    for stays, error, name in rounds:
        if cases >= wanted:
            break
        done, found = findings(name, error, stays)
        cases += done
        wrong += found
    print(f"{cases} cases, {len(wrong)} findings", *wrong, sep="\n", flush=True)
    return int(bool(wrong) or cases < wanted)


if __name__ == "__main__":
    sys.exit(main())

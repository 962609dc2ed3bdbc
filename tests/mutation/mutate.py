"""Changes the code in one place at a time, and reports which changes no test notices.

``python tests/mutation/mutate.py`` runs all of ``mutants.toml``; words choose those whose file
holds one of them. Mutants of C++ are built in ``build/mutants``, one after the other, while the
tests of those before run. Exit code 1: some survived.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
import tomllib
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
BUILD = ROOT / "build" / "mutants"
PATIENCE = 10
"""A mutant whose tests take so many times as long as without it, and a minute, is noticed."""


def mutants() -> list[dict[str, Any]]:
    """Return the list: each with ``file``, ``old``, ``new`` and ``tests``."""
    found: list[dict[str, Any]] = tomllib.loads((HERE / "mutants.toml").read_text())["mutant"]
    return found


def module_of(file: str) -> str:
    """Return the name under which a file of the package is imported."""
    parts = Path(file).with_suffix("").relative_to("python").parts
    return ".".join(part for part in parts if part != "__init__")


def is_python(mutant: dict[str, Any]) -> bool:
    """Whether a mutant changes the Python package and not the core."""
    return bool(mutant["file"].startswith("python/"))


def verdict_of(mutant: dict[str, Any], library: Future[str] | None, seconds: float) -> str:
    """Make the change, and run its tests for so long at most."""
    if library is None:
        about = {key: mutant[key] for key in ("old", "new")}
        about |= {"module": module_of(mutant["file"]), "path": str(ROOT / mutant["file"])}
        return verdict(mutant, about, seconds)
    try:
        path = library.result()
    except subprocess.CalledProcessError as error:
        return f"not run: {error}"
    return verdict(mutant, {"module": "manip3d._core", "library": path}, seconds)


def seconds_unchanged(tests: str) -> float | None:
    """Return how long tests run without a change; None where they fail, and so tell nothing."""
    started = time.monotonic()
    found = verdict({"tests": tests}, {"module": ""}, None)
    return time.monotonic() - started if found == "survived" else None


def verdict(mutant: dict[str, Any], about: dict[str, str], seconds: float | None) -> str:
    """Run the tests of a mutant: ``killed``, ``survived`` or why they could not run."""
    environment = {k: v for k, v in os.environ.items() if k != "MANIP3D_DATA"}
    environment |= {"MANIP3D_MUTANT": json.dumps(about), "PYTHONPATH": str(HERE)}
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "-p", "mutating",
               "-p", "no:cacheprovider", *mutant["tests"].split()]  # fmt: skip
    try:
        done = subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=seconds
        )
    except subprocess.TimeoutExpired:
        return "killed"
    if done.returncode == 0:
        return "survived"
    if done.returncode < 0:  # a signal: the changed code crashed
        return "killed"
    if done.returncode == 1 and " failed" in done.stdout + done.stderr:
        return "killed"
    return "not run: " + " ".join((done.stdout + done.stderr).split())[-300:]


def built(mutant: dict[str, Any], number: int) -> str:
    """Build the core with the change; return where it is."""
    source = BUILD / "source"
    if not (BUILD / "build.ninja").exists():
        run("cmake", "-S", source, "-B", BUILD, "-G", "Ninja", "-DCMAKE_BUILD_TYPE=Release",
            "-DMANIP3D_PYTHON=ON", f"-DPython_EXECUTABLE={sys.executable}")  # fmt: skip
        run("cmake", "--build", BUILD, "--target", "_core")
    changed = source / mutant["file"]
    text = (ROOT / mutant["file"]).read_text()
    changed.write_text(text.replace(mutant["old"], mutant["new"]))
    try:
        run("cmake", "--build", BUILD, "--target", "_core")
        (library,) = BUILD.glob("_core*.so")
        kept = BUILD / "mutant" / str(number) / library.name
        kept.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(library, kept)
    finally:
        changed.write_text(text)
    return str(kept)


def bring_up_to_date(source: Path) -> None:
    """Copy what has changed since the last run, or what a killed one left with its change."""
    places = [ROOT / "CMakeLists.txt", ROOT / "LICENSE", ROOT / "README.md"]
    for folder in ("cpp", "packaging"):
        places += [path for path in (ROOT / folder).rglob("*") if path.is_file()]
    for path in places:
        copy = source / path.relative_to(ROOT)
        content = path.read_bytes()
        if not copy.exists() or copy.read_bytes() != content:
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes(content)


def run(*command: object) -> None:
    """Run a command that must succeed."""
    subprocess.run([str(word) for word in command], check=True, stdout=subprocess.DEVNULL)


def run_all(chosen: list[dict[str, Any]], libraries: Iterator[Future[str]]) -> Counter[str]:
    """Run mutants, one line each; return how often each verdict was found."""
    usual_seconds = cache(seconds_unchanged)
    counts: Counter[str] = Counter()
    for mutant in chosen:
        library = None if is_python(mutant) else next(libraries)
        usual = usual_seconds(mutant["tests"])
        started = time.monotonic()
        found = "not run: its tests fail without a change"
        if usual is not None:
            found = verdict_of(mutant, library, 60 + PATIENCE * usual)
        counts[found.split(":")[0]] += 1
        seconds = time.monotonic() - started
        print(f"{found}: {mutant['file']}: {mutant['old']} -> {mutant['new']} ({seconds:.0f} s)",
              flush=True)  # fmt: skip
    return counts


def main() -> int:
    """Run the chosen mutants; return the exit code."""
    words = sys.argv[1:]
    chosen = [m for m in mutants() if not words or any(word in m["file"] for word in words)]
    if not chosen:
        print(f"no mutant of {' '.join(words)}", file=sys.stderr)
        return 2
    of_core = [mutant for mutant in chosen if not is_python(mutant)]
    if of_core:
        bring_up_to_date(BUILD / "source")
    builder = ThreadPoolExecutor(1)
    libraries = [builder.submit(built, m, number) for number, m in enumerate(of_core)]
    try:
        counts = run_all(chosen, iter(libraries))
    finally:
        builder.shutdown(cancel_futures=True)
        shutil.rmtree(BUILD / "mutant", ignore_errors=True)
    print(", ".join(f"{number} {word}" for word, number in sorted(counts.items())))
    return 0 if set(counts) <= {"killed"} else 1


if __name__ == "__main__":
    sys.exit(main())

"""Arguments that many functions share: random generators, threads, progress."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from manip3d.errors import InputError

if TYPE_CHECKING:
    Rng: TypeAlias = "int | np.random.Generator | None"
    Progress: TypeAlias = "Callable[[float, str], object] | bool | None"


def generator_of(rng: Rng) -> np.random.Generator:
    """Return ``numpy.random.default_rng(rng)``, after a check of the argument."""
    is_seed = isinstance(rng, int | np.integer) and rng >= 0
    if not (rng is None or is_seed or isinstance(rng, np.random.Generator)):
        raise InputError(f"rng: expected a seed >= 0, a Generator or None, got {rng!r}")
    return np.random.default_rng(rng)


def seed_of(rng: Rng) -> int:
    """Return a 64-bit seed for a kernel in ``_core``, drawn from ``generator_of(rng)``."""
    return int(generator_of(rng).integers(2**64, dtype=np.uint64))


def threads_of(threads: int) -> int:
    """Return the number of threads; for 0, that in ``MANIP3D_THREADS``, or 0 (all cores)."""
    if not 0 <= threads < 1 << 31:
        raise InputError(f"threads: expected 0 to 2147483647, got {threads}")
    if threads != 0:
        return threads
    text = os.environ.get("MANIP3D_THREADS", "") or "0"
    if not text.isdecimal():
        raise InputError(f"MANIP3D_THREADS: expected a whole number >= 0, got {text!r}")
    return int(text)


@contextmanager
def reporting(progress: Progress, message: str) -> Iterator[Callable[[float], object] | None]:
    """Yield a kernel's callback ``fraction -> None`` for a function's argument ``progress``.

    True draws a bar on the standard error stream; a callable gets ``(fraction, message)``. The
    callback is None if ``progress`` is None or False.
    """
    if progress is None or progress is False:
        yield None
    elif callable(progress):
        yield lambda fraction: progress(fraction, message)
    elif progress is True:
        from rich.console import Console
        from rich.progress import Progress as Bar

        with Bar(console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task(message, total=1.0)
            yield lambda fraction: bar.update(task, completed=fraction)
    else:
        raise InputError(f"progress: expected None, True or a callable, got {progress!r}")


@contextmanager
def sharing(progress: Progress, message: str) -> Iterator[Callable[[float, float], Progress]]:
    """Divide one progress among several runs: ``part(begin, end)`` is the progress of one run.

    The total never decreases, and ends at 1 even if a run stops early.
    """
    with reporting(progress, message) as report:
        so_far = 0.0

        def part(begin: float, end: float) -> Progress:
            if report is None:
                return None

            def tell(fraction: float, _: str = "") -> None:
                nonlocal so_far
                so_far = max(so_far, begin + (end - begin) * fraction)
                report(so_far)

            return tell

        yield part
        if report is not None and so_far < 1.0:
            report(1.0)


def fraction_only(told: Callable[[float], object] | None) -> Callable[[float, str], object] | None:
    """Return a progress function that passes on the fraction without the message."""
    return None if told is None else lambda fraction, message: told(fraction)


def shares(sizes: Iterable[float]) -> list[tuple[float, float]]:
    """Return begin and end, from 0 to 1, of each run's part in a total, from the runs' costs."""
    ends = np.cumsum([0.0, *sizes])
    ends = ends / ends[-1] if ends[-1] > 0.0 else np.linspace(0.0, 1.0, len(ends))
    return [(float(begin), float(end)) for begin, end in itertools.pairwise(ends)]

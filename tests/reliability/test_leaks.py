"""Calls that are over leave nothing behind: no memory, no file descriptors."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import kernels
from manip3d import DeviceError, InputError, capture, simplify

WARM_UP, CALLS = 100, 500
MOST_PER_CALL = 512  # bytes
ATTEMPTS = 4  # memory that grows for other reasons does not grow each time


def resident_bytes() -> int:
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE")


def least_growth(call: Callable[[], object], calls: int, attempts: int = ATTEMPTS) -> float:
    """Bytes that a call adds, in the best of some windows: a leak is in all of them."""
    least = np.inf
    for _ in range(attempts):
        before = resident_bytes()
        for _ in range(calls):
            call()
        least = min(least, (resident_bytes() - before) / calls)
        if least < MOST_PER_CALL:
            break
    return least


@pytest.fixture
def two_cores() -> None:
    if len(os.sched_getaffinity(0)) < 2:
        pytest.skip("needs two cores")


def test_the_measure_sees_a_leak() -> None:
    kept: list[bytes] = []
    assert least_growth(lambda: kept.append(bytes(2 * MOST_PER_CALL)), 2000, 2) > MOST_PER_CALL


def test_parallel_calls_do_not_leak(two_cores: None) -> None:
    """Each call once made an arena of oneTBB of its own, of which 14 kB stayed."""
    call = lambda: simplify.dense_mesh(kernels.DEPTH, kernels.CAMERA, threads=2)  # noqa: E731
    for _ in range(WARM_UP):
        call()
    assert least_growth(call, CALLS) < MOST_PER_CALL


@pytest.mark.slow
@pytest.mark.parametrize("name", kernels.KERNELS)
def test_no_kernel_leaks(name: str, two_cores: None) -> None:
    def call() -> object:
        return kernels.KERNELS[name](2)

    for _ in range(WARM_UP):
        call()
    assert least_growth(call, CALLS) < MOST_PER_CALL


def descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


def test_a_bad_address_leaks_no_descriptor() -> None:
    before = descriptors()
    for _ in range(20):
        with pytest.raises(InputError, match="address"):
            capture.open("velodyne:nowhere:0")
        with pytest.raises(InputError, match="sender"):
            capture.open("velodyne:0", sender="300.1.1.1")
        with pytest.raises(DeviceError):
            capture.open("velodyne:192.0.2.1:0")  # no address of this machine
    assert descriptors() == before

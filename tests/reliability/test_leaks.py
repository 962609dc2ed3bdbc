"""Calls that are over leave nothing behind: no memory, no file descriptors."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import kernels
from manip3d import DeviceError, Error, InputError, LidarFrame, authenticate, capture, simplify
from open_files import descriptors
from watermark_scans import grid_scan, key_file

sys.path.append(str(Path(__file__).parents[1] / "fuzz"))

import hostile_files

CALLS, MIN_CALLS = 500, 25  # at night CALLS, else as many of them as take WINDOW_S
WINDOW_S = 0.2  # of processor time
MAX_PER_CALL = 512  # bytes
ATTEMPTS = 8  # memory that grows for other reasons does not grow each time

Growth = Callable[[Callable[[], object]], float]


class _MallocInfo(ctypes.Structure):
    """glibc's ``struct mallinfo2``."""

    _fields_ = [
        (name, ctypes.c_size_t)
        for name in (
            "arena",
            "ordblks",
            "smblks",
            "hblks",
            "hblkhd",
            "usmblks",
            "fsmblks",
            "uordblks",
            "fordblks",
            "keepcost",
        )
    ]


_libc = ctypes.CDLL(None)
_libc.mallinfo2.restype = _MallocInfo


def memory() -> NDArray[np.float64]:
    """Bytes that malloc has given out, and bytes that are resident.

    The first does not see what oneTBB and Python keep for themselves, the second not what fits in
    memory that was freed before.
    """
    gc.collect()
    info = _libc.mallinfo2()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return np.array([info.uordblks + info.hblkhd, pages * os.sysconf("SC_PAGESIZE")], float)


def least_growth(call: Callable[[], object], calls: int) -> float:
    """Bytes that a call adds, in the best of some windows: a leak is in all of them."""
    least = np.full(2, np.inf)
    gc.freeze()  # each collection then looks at what is new only
    try:
        for _ in range(ATTEMPTS):
            before = memory()
            for _ in range(calls):
                call()
            least = np.minimum(least, (memory() - before) / calls)
            if (least < MAX_PER_CALL).all():
                break
    finally:
        gc.unfreeze()
    return float(least.max())


@pytest.fixture
def growth(request: pytest.FixtureRequest) -> Growth:
    """Give the bytes that a call adds once it has been made often enough to be warm."""
    nightly = request.config.getoption("--hypothesis-profile") == "nightly"

    def measure(call: Callable[[], object]) -> float:
        call()  # the first one imports and fills caches
        started = time.process_time()
        call()
        seconds = max(time.process_time() - started, 1e-6)
        calls = CALLS if nightly else int(np.clip(WINDOW_S / seconds, MIN_CALLS, CALLS))
        for _ in range(calls // 5):
            call()
        return least_growth(call, calls)

    return measure


@pytest.fixture
def two_cores() -> None:
    if len(os.sched_getaffinity(0)) < 2:
        pytest.skip("needs two cores")


@pytest.mark.parametrize("calls", [MIN_CALLS, CALLS])
def test_the_measure_sees_a_leak(calls: int) -> None:
    kept: list[bytes] = []
    assert least_growth(lambda: kept.append(bytes(2 * MAX_PER_CALL)), calls) > MAX_PER_CALL


def test_parallel_calls_do_not_leak(two_cores: None, growth: Growth) -> None:
    """Each call once made an arena of oneTBB of its own, of which 14 kB stayed."""
    call = lambda: simplify.dense_mesh(kernels.DEPTH, kernels.CAMERA, threads=2)  # noqa: E731
    assert growth(call) < MAX_PER_CALL


@pytest.mark.slow
@pytest.mark.parametrize("name", kernels.KERNELS)
def test_no_kernel_leaks(name: str, two_cores: None, growth: Growth) -> None:
    assert growth(lambda: kernels.KERNELS[name](2)) < MAX_PER_CALL


def test_a_monitor_keeps_nothing_of_its_frames(tmp_path: Path, growth: Growth) -> None:
    """Watermark and cameras in every frame; only the risk remembers, so far back."""
    pytest.importorskip("cv2", reason="the extra 'alert' is not installed")
    scan = LidarFrame(grid_scan(1500))
    random = np.random.default_rng(0)
    left, right = random.integers(0, 256, (2, 40, 260, 3), np.uint8)
    rig = authenticate.StereoRig(88.0, (130.0, 20.0), 0.5, np.eye(4)[[2, 0, 1, 3]])
    with (
        authenticate.KeyFile(key_file(tmp_path / "key")) as key,
        authenticate.Watermarker(key) as sender,
        authenticate.Watermarker(key) as receiver,
    ):
        monitor = authenticate.AlertMonitor(receiver, rig=rig, budget_s=np.inf, every_s=np.inf)

        def judge() -> None:
            sent = sender.embed(scan)
            alert = monitor.judge(
                sent.frame, record=sent.record, left=left, right=right, speed_mps=200.0
            )
            assert alert.witnesses["watermark"].verdict == "authentic"

        assert growth(judge) < MAX_PER_CALL
        assert monitor.counts.skipped == {"forensics": monitor.counts.frames}


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


@pytest.mark.slow
@pytest.mark.parametrize("kind", sorted(hostile_files.KINDS.keys()))
def test_no_reader_leaks(kind: str, tmp_path: Path, growth: Growth) -> None:
    """Readers leak no memory and no open file, with whole, cut and damaged files."""
    for module in hostile_files.NEEDS.get(kind, ()):
        pytest.importorskip(module)
    example = hostile_files.examples_of(kind)[-1]
    name = max(example)
    random = np.random.default_rng(0)
    folders = [tmp_path / "whole", tmp_path / "cut", tmp_path / "damaged"]
    for folder, content in zip(
        folders,
        (example[name], example[name][:-9], hostile_files.damage(example[name], random)),
        strict=True,
    ):
        hostile_files.lay_out(example | {name: content}, folder)

    def read() -> None:
        for folder in folders:
            with contextlib.suppress(Error, OSError), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                hostile_files.KINDS[kind].read(folder, name)

    read()
    before = descriptors()
    assert growth(read) < MAX_PER_CALL
    assert descriptors() == before

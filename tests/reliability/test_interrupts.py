"""Ctrl-C ends what takes long within half a second."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import kernels
import long_kernels
from manip3d import Intrinsics, Mesh, forge, metrics

MAX_S = 0.5  # of processor time, which does not depend much on other work
ATTEMPTS = 3
HUNG_S = 300.0  # of a child; a bound on waiting, not on speed


def render(threads: int) -> Callable[[], object]:
    camera = Intrinsics(640, 480, 500.0, 500.0, 319.5, 239.5)
    mesh = long_kernels.wall()
    return lambda: metrics.render_depth(mesh, camera, threads=threads)


def resample_cloud() -> Callable[[], object]:
    points = np.random.default_rng(0).random((150_000, 3), np.float32)
    return lambda: forge.resample(points, spacing=0.004)


def resample_faces() -> Callable[[], object]:
    square = Mesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    return lambda: forge.resample(square, spacing=0.0007)


def thin_out() -> Callable[[], object]:
    points = np.random.default_rng(0).random((4_000_000, 3), np.float32)
    return lambda: forge.resample(points, spacing=0.02)


@pytest.mark.parametrize("after", [0.3, 0.7])
@pytest.mark.parametrize(
    "make",
    [lambda: render(1), lambda: render(2), resample_cloud, resample_faces, thin_out],
    ids=["render", "render in parallel", "resample a cloud", "resample faces", "thin out"],
)
def test_ctrl_c_is_heard(make: Callable[[], Callable[[], object]], after: float) -> None:
    work = make()
    times = []
    for _ in range(ATTEMPTS):
        taken = long_kernels.seconds_to_stop(work, after)
        assert taken is not None, "the work is too short to be interrupted"
        times.append(taken)
        if taken < MAX_S:
            return
    raise AssertionError(times)


def test_every_kernel_is_known_to_be_long_or_short() -> None:
    assert long_kernels.LONG.keys() | long_kernels.SHORT == kernels.KERNELS.keys()
    assert not long_kernels.LONG.keys() & long_kernels.SHORT


@pytest.mark.parametrize("name", long_kernels.LONG)
def test_long_kernels_hear_ctrl_c(name: str) -> None:
    """Each in a process of its own."""
    command = [sys.executable, long_kernels.__file__, name]
    tests = Path(__file__).parents[1]
    path = os.pathsep.join([str(tests), os.environ.get("PYTHONPATH", "")])
    taken = []
    for _ in range(ATTEMPTS):
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=HUNG_S,
            check=False,
            env={**os.environ, "PYTHONPATH": path},
        )
        assert done.returncode == 0, done.stderr
        assert done.stdout != "finished\n", "the work is too short to be interrupted"
        taken.append(float(done.stdout))
        if taken[-1] < MAX_S:
            return
    raise AssertionError(taken)


# The scan is of another scanner: at these lateral offsets no laser meets a point, and no step of
# the encoder has fired. The search for the first one that did once went round for ever.
NO_FIRING = textwrap.dedent(
    """
    import dataclasses
    import numpy as np
    import lattice_scans
    from manip3d import authenticate

    points = lattice_scans.scan(np.random.default_rng(0))
    lattice = lattice_scans.lattice()
    far = dataclasses.replace(lattice, lateral=np.full_like(lattice.lateral, 1000.0))
    for previous in (None, points):
        result = authenticate.generic_consistency(points, lattice=far, previous=previous)
        print(result.verdict)
    """
)


def test_a_scan_without_a_firing_is_judged() -> None:
    command = [sys.executable, "-c", NO_FIRING]
    tests = Path(__file__).parents[1]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=120, check=False, cwd=tests
    )
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.split()) == 2

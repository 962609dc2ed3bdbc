"""On one of the machine's processors all works as on several, and nothing is printed about it."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

PROGRAM = """
import os, sys
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
import numpy as np
from manip3d.authenticate import occlusion_consistency
points = np.random.default_rng(0).normal(size=(200_000, 3)).astype(np.float32)
print(occlusion_consistency(points, threads=int(sys.argv[1])).verdict)
"""


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="the system cannot pin a process")
@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="needs a machine with two processors")
@pytest.mark.parametrize("threads", [0, 2])
def test_no_warning_on_one_processor(threads: int) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(threads)], capture_output=True, text=True, check=True
    )
    assert done.stdout == "no_trace\n"
    assert done.stderr == ""

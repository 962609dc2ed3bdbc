"""Simulated data do not depend on the kernels that a BLAS chooses by the processor."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

FLAGS = {"Prescott": "pni", "Haswell": "avx2", "SkylakeX": "avx512f"}

DIGESTS = """
import hashlib
import numpy as np
from manip3d import simulate

def show(name, *arrays):
    digest = hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays))
    print(name, digest.hexdigest())

for name, faces in (("rocker", 5000), ("airplane", 4000)):
    mesh = getattr(simulate.models, name)(faces)
    show(name, mesh.vertices, mesh.faces)
body = simulate.BodySimulator(motion="arm-raise", amputated="left_arm", seed=1).capture(0.4)
show("body", body.frame.depth, body.truth.joints)
pair = simulate.stereo_pair(simulate.street(3), 0.5)
show("street", pair.left, pair.depth)
"""


def available() -> list[str]:
    cpu = Path("/proc/cpuinfo")
    flags = set(cpu.read_text().split()) if cpu.exists() else set()
    return [name for name, flag in FLAGS.items() if flag in flags]


@pytest.mark.skipif(len(available()) < 2, reason="the processor is not here that could tell")
def test_models_people_and_streets_are_the_same_with_every_blas() -> None:
    found = {}
    for kernel in (available()[0], available()[-1]):  # the oldest and the newest
        done = subprocess.run(
            [sys.executable, "-c", DIGESTS],
            capture_output=True,
            text=True,
            env=os.environ | {"OPENBLAS_CORETYPE": kernel},
        )
        assert done.returncode == 0, done.stderr
        found[kernel] = done.stdout.splitlines()
    first = next(iter(found.values()))
    assert len(first) == 4
    assert found == dict.fromkeys(found, first)

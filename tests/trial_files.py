"""Made-up trials of UTD-MHAD, as the data set's files hold them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

FRAMES = 3


def write_trial(folder: Path, name: str = "a3_s1_t1", joints: Path | None = None) -> Path:
    """Made-up files of the data set: a wall that comes nearer, and joints 2 m before it."""
    savemat = pytest.importorskip("scipy.io").savemat
    for place in (folder, joints or folder):
        place.mkdir(parents=True, exist_ok=True)
    depth = np.full((240, 320, FRAMES), 2000, np.uint16) - np.arange(FRAMES, dtype=np.uint16)
    depth[:, 0] = 0
    skeletons = np.zeros((20, 3, FRAMES))
    skeletons[:, 0] = np.arange(20)[:, None] / 100.0
    skeletons[:, 2] = 2.0
    path = folder / f"{name}_depth.mat"
    savemat(path, {"d_depth": depth})
    savemat((joints or folder) / f"{name}_skeleton.mat", {"d_skel": skeletons})
    return path

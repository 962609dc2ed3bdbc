"""Errors of joints that last for many frames do not turn the plane as far as they seem small."""

from __future__ import annotations

import numpy as np
import pytest

from manip3d.modify import PhantomPipeline
from manip3d.simulate import BodySimulator

pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")


def test_joints_with_lasting_errors_do_not_outweigh_the_surface() -> None:
    """The plane was off by up to 8.5 degrees, as the joints' errors seemed nearly independent.

    A running mean follows errors that last, so that their correlation is measured too small.
    """
    people = BodySimulator(
        amputated="right_leg", motion="dorsiflexion", turn=-20.0, jitter=0.02, correlation=0.9,
        color="none", room=False, seed=2,
    )  # fmt: skip
    pipeline = PhantomPipeline("right_leg")
    off = []
    for number in range(25):
        seen = people.capture(number / 30.0)
        plane = pipeline.process(seen.frame).plane
        assert plane is not None
        _, normal = seen.truth.mirror_plane("right_leg")
        off.append(np.degrees(np.arccos(min(1.0, abs(float(plane.normal @ normal))))))
    assert max(off) < 6.0

"""`frame_times`: the renderer, the number of frames, and refused arguments."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manip3d import InputError, Mesh, RenderError
from manip3d.viewer import frame_times
from manip3d.viewer.renderers import check


@pytest.mark.parametrize("drawn_by", ["pyvista", pytest.param("chromium", marks=pytest.mark.slow)])
def test_frames_of_a_scene_are_timed(bundle: None, quad: Mesh, drawn_by: Any) -> None:
    try:
        check(drawn_by)
    except RenderError as error:
        pytest.skip(str(error))
    times = frame_times([quad, quad, quad], drawn_by, size=(64, 48), frames=4)
    assert times.num_faces == 3 * quad.num_faces
    assert 1 <= len(times.milliseconds) <= 4
    assert (times.milliseconds > 0.0).all()
    assert times.ms_per_million == pytest.approx(1e6 * times.median / times.num_faces)
    assert times.driver not in ("", "unknown")


def test_what_cannot_be_timed_is_refused(quad: Mesh) -> None:
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32))
    for meshes in ([], [quad, nothing]):
        with pytest.raises(InputError, match="meshes: expected meshes with faces"):
            frame_times(meshes, "pyvista")
    with pytest.raises(InputError, match="drawn_by: expected 'pyvista' or 'chromium'"):
        frame_times([quad], "vulkan")  # type: ignore[arg-type]
    for name, value in {"frames": 0, "seconds": 0.0, "size": (0, 9)}.items():
        with pytest.raises(InputError, match=f"{name}: expected"):
            frame_times([quad], "pyvista", **{name: value})  # type: ignore[arg-type]


def test_a_renderer_that_is_not_there_says_so(
    bundle: None, monkeypatch: pytest.MonkeyPatch, quad: Mesh, tmp_path: Path
) -> None:
    monkeypatch.setitem(os.environ, "PATH", str(tmp_path))
    with pytest.raises(RenderError, match="none of chromium"):
        frame_times([quad], "chromium")

"""Limits that the caller sets hold for every reader: bytes, points, seconds."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manip3d import FormatError, InputError, LidarFrame, _core, io, simulate
from manip3d.io import _limits

READERS: dict[str, Any] = {
    "a.obj": io.read_mesh,
    "a.glb": io.read_scene,
    "a.ply": io.read_report,
    "s.bin": io.read_scan,
    "s.pcd": io.read_scans,
    "s.las": io.read_scan,
    "s.laz": io.read_scan,
    "s.e57": io.read_scan,
    "s.ptx": io.read_scan,
    "grid.ply": io.read_range_grid,
    "d.npy": io.read_depth,
    "d.png": io.read_depth_guessing,
    "p.png": io.read_pixel_map,
    "m.bvh": io.read_bvh,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One file of each kind, with 1 000 points and more."""
    place = tmp_path_factory.mktemp("limits")
    mesh = simulate.models.floor(columns=40, rows=40)
    for name in ("a.obj", "a.glb", "a.ply"):
        mesh.write(place / name)
    rng = np.random.default_rng(0)
    points = rng.uniform(-20, 20, (1500, 3)).astype(np.float32)
    scan = LidarFrame(points=points, intensity=np.ones(1500, np.float32))
    for name in ("s.bin", "s.pcd", "s.las", "s.laz", "s.e57", "s.ptx"):
        try:
            io.write_scan(scan, place / name)
        except ImportError:  # an extra is absent
            continue
    header = (
        "ply\nformat ascii 1.0\nobj_info num_cols 40\nobj_info num_rows 40\n"
        "element vertex 1600\nproperty float x\nproperty float y\nproperty float z\n"
        "element range_grid 1600\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = "".join(f"{x} {y} 1\n" for y in range(40) for x in range(40))
    (place / "grid.ply").write_text(header + rows + "".join(f"1 {i}\n" for i in range(1600)))
    (place / "m.bvh").write_text(
        "HIERARCHY ROOT Hips { OFFSET 0 0 0 CHANNELS 3 Xposition Yposition Zposition\n"
        "End Site { OFFSET 0 1 0 } }\nMOTION\nFrames: 1600\nFrame Time: 0.01\n" + "0 90 0\n" * 1600
    )
    depth = np.full((40, 40), 2000, np.uint16)
    np.save(place / "d.npy", depth)
    image = pytest.importorskip("PIL.Image")
    for name in ("d.png", "p.png"):
        image.fromarray(depth).save(place / name)
    return place


def test_no_reader_is_left_out() -> None:
    tested = {reader.__name__ for reader in READERS.values()}
    readers = {name for name in io.__all__ if name.startswith("read_")}
    assert readers - tested == {"read_mesh_bytes"}  # has no file


@pytest.mark.parametrize("name", READERS)
def test_each_reader_keeps_the_limits(folder: Path, name: str) -> None:
    """Within the limits nothing changes; one point or byte too many is refused by name."""
    path = folder / name
    if not path.exists():
        pytest.skip("the package that writes it is not installed")
    size = path.stat().st_size
    with io.ReadLimits(max_bytes=64 * size, max_points=7000, max_seconds=60):
        READERS[name](path)
    with io.ReadLimits(max_points=1400), pytest.raises(FormatError, match="max_points = 1400"):
        READERS[name](path)
    with io.ReadLimits(max_bytes=100), pytest.raises(FormatError, match="max_bytes = 100"):
        READERS[name](path)
    with io.ReadLimits(max_seconds=1e-9), pytest.raises(FormatError, match="max_seconds") as late:
        READERS[name](path)
    assert late.value.file == str(path)
    READERS[name](path)  # limits end with their block


def test_the_core_stops_in_the_middle(tmp_path: Path) -> None:
    """A long file is given up where it stands, not when it has been read."""
    path = tmp_path / "long.3d"
    path.write_text("1.25 2.5 3.75\n" * 3_000_000)
    seen: list[float] = []

    def late(fraction: float) -> None:
        seen.append(fraction)
        raise FormatError("too late", file=str(path))

    with pytest.raises(FormatError, match="too late"):
        _core.read_points(os.fsencode(path), 0, late)
    assert len(seen) == 1
    assert seen[0] < 1
    expected = pytest.raises(FormatError, match=r"max_seconds = 0\.001")
    with io.ReadLimits(max_seconds=1e-3), expected:
        io.read_scan(path)


def test_blocks_are_nested_and_belong_to_their_thread(folder: Path) -> None:
    """The strictest of all blocks holds; other threads know nothing of it."""
    inner = io.ReadLimits(max_points=10)
    with io.ReadLimits(max_bytes=500), inner:
        assert _limits.byte_limit(None) == 500
        assert _limits.byte_limit(100) == 100
        seen: list[object] = []
        thread = threading.Thread(target=lambda: seen.append(io.read_scan(folder / "s.bin")))
        thread.start()
        thread.join()
        assert len(seen) == 1
        with inner, inner:  # one object may be entered several times
            pass
        with pytest.raises(FormatError, match="max_points = 10"):
            _limits.check_points(11, "x")
    assert _limits.byte_limit(None) == 0


def test_an_error_names_no_limit_that_is_none() -> None:
    for name in ("max_bytes", "max_points", "max_seconds"):
        with pytest.raises(InputError, match=f"{name}: expected > 0, got 0"):
            io.ReadLimits(**{name: 0})
    with pytest.raises(InputError, match="max_seconds"):
        io.ReadLimits(max_seconds=float("nan"))

"""Results can be pickled and deep-copied: process pools and caches take them."""

from __future__ import annotations

import copy
import dataclasses
import importlib
import inspect
import pickle
from collections.abc import Callable, Iterator, Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kernels
import manip3d
import posed_gltf
import rgbd_frames
from cave_scans import AHEAD, ball
from manip3d import (
    LidarFrame,
    Material,
    Texture,
    authenticate,
    capture,
    forge,
    io,
    modify,
    simplify,
)
from manip3d.lidar import ScanFormat

COPIES: dict[str, Callable[[Any], Any]] = {
    "pickle": lambda value: pickle.loads(pickle.dumps(value)),
    "deepcopy": copy.deepcopy,
    "copy": copy.copy,
}


def scan() -> LidarFrame:
    return LidarFrame(
        kernels.cloud[:50],
        np.ones(50, np.float32),
        ring=np.arange(50, dtype=np.uint8),
        origin=(0, 0, 1),
        fields={"range": np.arange(50.0)},
        format=ScanFormat("kitti", header={"a": 1}),
    )


def files(folder: Path) -> Iterator[object]:
    kernels.hill.write(folder / "a.ply")
    yield io.read_report(folder / "a.ply")
    (folder / "arm.glb").write_bytes(posed_gltf.arm().glb())
    yield io.read_scene(folder / "arm.glb").deformations[0]
    scan().write(folder / "a.pcd")
    yield io.read_scan(folder / "a.pcd")
    yield scan().summary()
    np.save(folder / "a.npy", kernels.DEPTH)
    yield io.read_depth_guessing(folder / "a.npy")
    grid = b"ply\nformat ascii 1.0\nobj_info num_cols 2\nobj_info num_rows 1\nelement vertex 1\n"
    grid += b"property float x\nproperty float y\nproperty float z\nelement range_grid 2\n"
    grid += b"property list uchar int vertex_indices\nend_header\n1 2 3\n1 0\n0\n"
    (folder / "g.ply").write_bytes(grid)
    yield io.read_range_grid(folder / "g.ply")
    yield io.ReadLimits(max_points=5)
    yield capture.record(rgbd_frames.frames(2), folder / "recording")
    yield simplify.simplify_recording(
        rgbd_frames.frames(1), folder / "meshes", simplify.DepthOptions(5)
    )
    yield capture.summarize(capture.open_rgbd(f"folder:{folder / 'recording'}"))
    with authenticate.KeyFile.create(folder / "sensor.key") as key:
        marker = authenticate.Watermarker(key)
        sent = marker.embed(kernels.on_grid)
        found = marker.verify(sent.frame, sent.record)
    yield from (sent, found, found.tiles[0], authenticate.Policy())
    yield authenticate.EmbeddedScan(folder / "a.bin", 0, 3000, 1, has_time=False)
    yield authenticate.VerifiedFiles(found.verdict, found.reason, (("a.bin", found),))


def streams() -> Iterator[object]:
    person = kernels.person
    yield modify.PhantomPipeline(affected="right_arm").process(person)
    tracker = modify.ColliderTracker()
    yield tracker.update(person.skeletons[0])
    skeleton, camera = person.skeletons[0], person.calibration.depth
    labels = modify.segment_body(person.depth, camera, skeleton, segmentation="region").labels
    mesh = modify.animation_mesh(person.depth, camera, labels, skeleton)
    yield from (mesh, modify.animate(mesh.vertices, mesh.labels, skeleton, skeleton))
    yield kernels.moves
    forged = forge.stream([person], person, kind=1)
    yield from (next(forged.frames()), forged.truth)
    still = authenticate.inspect_stream([dataclasses.replace(person, number=n) for n in range(8)])
    yield from (still, authenticate.StreamRegion(0, (0, 0, 1, 1), 1.0))


def alerts() -> Iterator[object]:
    monitor = authenticate.AlertMonitor()
    alert = monitor.judge(scan(), speed_mps=9.0)
    yield from (alert, alert.risk, alert.witnesses["watermark"], monitor.counts)
    yield authenticate.AttackObservation("additive", (8.0, 0.0), 4, 10)
    yield authenticate.RiskParameters()
    yield authenticate.CrossModalParameters()
    camera = np.eye(4)[[2, 0, 1, 3]]
    rig = authenticate.StereoRig(88.0, (47.5, 35.5), 0.5, camera)
    seen = authenticate.Disparity(np.full((72, 96), 12.0, np.float32))
    yield from (rig, seen, authenticate.cross_modal_consistency(scan(), seen, rig))
    yield authenticate.surround_consistency(scan(), {"front": seen}, {"front": rig})
    yield authenticate.CameraPair(rig, 2, 3)
    box = manip3d.Box((8, 0, 0), (1, 1, 1))
    yield authenticate.CrossModalRegion("added", 9, 0, 0.01, 1.0, 5.0, box, 2.0)


def values() -> Iterator[object]:
    yield from (manip3d.Box((0, 0, 0), (1, 1, 1)), scan(), kernels.person, kernels.rings)
    yield manip3d.Mesh([[0, 0, 0]], [], materials=[Material("a", textures={"n": Texture("b")})])
    yield from (kernels.views, kernels.scanner, forge.segment(kernels.cloud))
    yield from (rgbd_frames.full_calibration(), kernels.hill.summary())
    yield from (authenticate.PAPER_DENSITY, authenticate.PAPER_OCCLUSION)
    yield simplify.DepthOptions(60)
    yield simplify.lod_chain(kernels.hill, 2)
    levels = simplify.scene_lods(kernels.hill_scene, 2)
    yield from (levels, levels.levels[1], kernels.hill_scene, kernels.hill_scene.nodes[0])
    yield simplify.simplify_scene(kernels.hill_scene, ratio=0.3)
    yield simplify.share_budget([kernels.hill, kernels.pipe], 80)
    for kind in (
        authenticate.LatticeReading,
        authenticate.ReflectanceRegion,
        authenticate.SuspectRegion,
        modify.Hits,
        modify.Placement,
        simplify.DepthFileResult,
        simplify.JointFileResult,
    ):  # plain values, whatever they hold
        yield kind(**{field.name: np.arange(3.0) for field in dataclasses.fields(kind)})
    forged = np.concatenate([AHEAD, ball(0.6, 20_000) + np.float32([3, 1, 0])])
    inspected = authenticate.inspect(np.float16(forged).astype(np.float32), origin=(0, 0, 0))
    assert inspected.processing
    yield from (inspected, inspected.regions[0])
    yield from alerts()
    yield manip3d.FormatError("a", file="b", line=3)


def same(one: object, other: object) -> bool:
    return type(one) is type(other) and kernels.hash_of(one) == kernels.hash_of(other)


@pytest.mark.parametrize("name", kernels.KERNELS)
def test_results_of_kernels(name: str) -> None:
    result = kernels.KERNELS[name](1)
    for how, copied in COPIES.items():
        assert same(copied(result), result), how


@pytest.mark.parametrize("how", COPIES)
def test_other_values(how: str, tmp_path: Path) -> None:
    for value in (*values(), *files(tmp_path), *streams()):
        assert same(COPIES[how](value), value), type(value)


def types_in(value: object, found: set[type]) -> set[type]:
    """The types of a value and of what it holds."""
    if type(value) not in found or isinstance(value, list | tuple | Mapping):
        found.add(type(value))
        inner: Any = ()
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            inner = [getattr(value, field.name) for field in dataclasses.fields(value)]
        elif isinstance(value, Mapping):
            inner = value.values()
        elif isinstance(value, list | tuple):
            inner = value
        for each in inner:
            types_in(each, found)
    return found


def test_every_public_result_was_there(tmp_path: Path) -> None:
    found: set[type] = set()
    for value in (*values(), *files(tmp_path), *streams()):
        types_in(value, found)
    for kernel in kernels.KERNELS.values():
        types_in(kernel(1), found)
    public: set[type] = set()
    for package in (
        "simplify",
        "modify",
        "forge",
        "authenticate",
        "metrics",
        "io",
        "rgbd",
        "lidar",
    ):
        module = importlib.import_module(f"manip3d.{package}")
        public |= {
            item
            for name in module.__all__
            if dataclasses.is_dataclass(item := getattr(module, name)) and inspect.isclass(item)
        }
    assert {item.__name__ for item in public - found if not issubclass(item, Enum)} == set()


def test_a_mapping_of_a_result_cannot_be_changed() -> None:
    frame = pickle.loads(pickle.dumps(scan()))
    with pytest.raises(TypeError):
        frame.fields["range"] = 1
    assert repr(dict(frame.fields)) == repr(frame.fields)

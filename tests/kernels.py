"""Every public function of the kernels once, on an input that takes milliseconds."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib
from collections.abc import Callable
from enum import Enum
from inspect import isfunction, unwrap

import numpy as np

import capsule_body
import exact_models as models
import lattice_scans
import turn_scans
from gltf_files import scene_of
from manip3d import (
    Box,
    Intrinsics,
    LidarFrame,
    Mesh,
    _core,
    authenticate,
    forge,
    io,
    metrics,
    modify,
    simplify,
)
from manip3d.errors import MissingExtraError
from manip3d.rgbd import JOINTS, PARENTS

Kernel = Callable[[int], object]
"""A function of the number of threads; those that take none ignore it."""

V, U = np.mgrid[0:72, 0:96]
DEPTH = (1200 + ((U - 48) ** 2 + (V - 36) ** 2) // 9 + (7 * U + 5 * V) % 4).astype(np.uint16)
CAMERA = Intrinsics(96, 72, 88.0, 88.0, 47.5, 35.5)
GRID = _core.unproject(DEPTH, CAMERA, 1)[0].reshape(72, 96, 3)

hill = models.hill(13)
coarse = hill.replace(faces=hill.faces // 2 * 2)
pipe = models.pipe(16, 6)
paint = np.arange(3 * hill.num_vertices).reshape(-1, 3) % 256

hill_scene = scene_of(models.hill(13))
coarse_pipe = pipe.replace(faces=pipe.faces // 2 * 2)
found = simplify.dense_mesh(DEPTH, CAMERA, threads=1)
dense = found.mesh

cloud = (np.random.default_rng(1).integers(-8192, 8192, (3_000, 3)) / 512).astype(np.float32)
hoax = (np.random.default_rng(2).integers(-512, 512, (300, 3)) / 512).astype(np.float32)
box = Box((4.0, 1.0, 0.0), (6.0, 5.0, 4.0), 0.5)
rings = forge.Lattice([[k / 64, 0.125] for k in range(-24, 8)], 2**-6)
pasted = forge.ctp(cloud, hoax, position=(4, 1, 0), threads=1)
scanner = lattice_scans.lattice()
scan = lattice_scans.scan(np.random.default_rng(0))[::10].copy()
yard = turn_scans.turn(0.0, 0)
shining = LidarFrame(yard[::9], (np.arange(len(yard[::9])) % 97 / 100).astype(np.float32))
level = authenticate.turn_consistency(yard, yard, yard, lattice=scanner, threads=1)
wall = Box((6.0, 0.0, -1.0), (6.0, 3.0, 2.0))
near_wall = np.ascontiguousarray(scan[wall.contains(scan)])
person = capsule_body.painted(0)
skeleton = person.skeletons[0]
ground = np.float32(0.5) * cloud * np.float32([1, 1, 0]) - np.float32([0, 0, 1.7])
street = np.concatenate([ground, hoax + np.float32([6, 0, 0])])
angles = authenticate.AngularGrid(2.0, 2.0)
views = [simplify.CameraView(DEPTH, CAMERA), simplify.CameraView(DEPTH, CAMERA)]
inspected = authenticate.inspect(cloud, origin=(0, 0, 0), threads=1)

on_grid = (np.rint(cloud.astype(np.float64) * 1000) / 1000).astype(np.float32)
blocks = authenticate.noise_blocks(1, slices=12, block_bits=50)
marked = authenticate.embed_paper(on_grid, blocks)
verified = authenticate.WatermarkResult(
    "authentic", "every point", "intact", "in order", 0, "unknown", is_end=True
)


def carrying_picture() -> np.ndarray:
    """A picture with the header of a record, and zeros behind it."""
    header = b"m3d-wm01" + bytes(86) + bytes([4, 0, 1, 0])
    bits = np.unpackbits(np.frombuffer(header, np.uint8), bitorder="little")
    picture = np.zeros((128, 128), np.uint8)
    picture.reshape(-1)[: len(bits)] = bits
    return picture


walk = [capsule_body.painted(number) for number in range(6)]
moves = io.Motion(
    JOINTS,
    PARENTS,
    np.stack([f.skeletons[0].positions.astype(np.float64) * (1.0, -1.0, -1.0) for f in walk]),
    1.0 / 30.0,
)
colored = dataclasses.replace(person, color=np.full((*person.depth.shape, 3), 90, np.uint8))
LABELS = modify.segment_body(person.depth, person.calibration.depth, skeleton).labels
person_mesh = modify.animation_mesh(person.depth, person.calibration.depth, LABELS)


def stereo_or_nothing() -> object:
    """Disparity of a random picture, where OpenCV is installed."""
    picture = np.random.default_rng(3).integers(0, 256, (40, 260), np.uint8)
    try:
        return authenticate.stereo_disparity(picture[:, 20:], picture[:, :-20])
    except MissingExtraError:
        return None


KERNELS: dict[str, Kernel] = {
    "authenticate.attack_type": lambda _: authenticate.attack_type([]),
    "authenticate.cross_modal_consistency": lambda _: authenticate.cross_modal_consistency(
        street,
        authenticate.Disparity(np.full((72, 96), 12.0, np.float32)),
        authenticate.StereoRig(88.0, (47.5, 35.5), 0.5, np.eye(4)[[2, 0, 1, 3]]),
    ),
    "authenticate.surround_consistency": lambda _: authenticate.surround_consistency(
        street,
        {"front": authenticate.Disparity(np.full((72, 96), 12.0, np.float32))},
        {"front": authenticate.StereoRig(88.0, (47.5, 35.5), 0.5, np.eye(4)[[2, 0, 1, 3]])},
    ),
    "authenticate.stereo_disparity": lambda _: stereo_or_nothing(),
    "authenticate.verdict_of_alerts": lambda _: authenticate.verdict_of_alerts(
        [authenticate.AlertMonitor().skip()]
    ),
    "authenticate.watch_drive": lambda _: authenticate.watch_drive(
        authenticate.AlertMonitor(),
        [authenticate.DriveMoment("no scan"), authenticate.DriveMoment("none here either")],
    ),
    "authenticate.temporal_factor": lambda _: authenticate.temporal_factor([True, False]),
    "authenticate.depth_noise": lambda _: authenticate.depth_noise(DEPTH),
    "authenticate.inter_frame_noise": lambda _: authenticate.inter_frame_noise(walk),
    "authenticate.inspect_stream": lambda _: authenticate.inspect_stream(walk),
    "authenticate.judged_frames": lambda _: authenticate.judged_frames(walk),
    "forge.background_plate": lambda _: forge.background_plate(walk),
    "forge.without_people": lambda _: forge.without_people(walk[0], walk[1]),
    "forge.recorded_people": lambda _: forge.recorded_people(walk, with_plate=True),
    "forge.recorded_poses": lambda _: forge.recorded_poses(walk),
    "forge.at_pace": lambda _: list(forge.at_pace(walk, 1e7)),
    "forge.stream": lambda _: [f.frame.depth for f in forge.stream(walk, walk[0], kind=1).frames()],
    "modify.animation_mesh": lambda _: modify.animation_mesh(
        person.depth, person.calibration.depth, LABELS
    ),
    "modify.animate": lambda _: modify.animate(
        person_mesh.vertices, person_mesh.labels, skeleton, walk[5].skeletons[0]
    ),
    "authenticate.noise_blocks": lambda _: authenticate.noise_blocks(1),
    "authenticate.record_of_picture": lambda _: authenticate.record_of_picture(carrying_picture()),
    "authenticate.without_record": lambda _: authenticate.without_record(
        np.full((128, 128), 255, np.uint8)
    ),
    "authenticate.embed_paper": lambda _: authenticate.embed_paper(on_grid, blocks),
    "authenticate.compare_paper": lambda _: authenticate.compare_paper(
        marked.frame, blocks, marked.metadata
    ),
    "authenticate.verdict_of_stream": lambda _: authenticate.verdict_of_stream([verified]),
    "simplify.boundary_vertices": lambda _: simplify.boundary_vertices(pipe),
    "simplify.clean": lambda _: simplify.clean(pipe),
    "simplify.quality": lambda _: simplify.quality(hill, ratio=0.3),
    "simplify.fast": lambda t: simplify.fast(pipe, ratio=0.3, threads=t),
    "simplify.simplify": lambda _: simplify.simplify(pipe, ratio=0.3),
    "simplify.qem4vr": lambda _: simplify.qem4vr(hill, ratio=0.3),
    "simplify.qem_orig": lambda _: simplify.qem_orig(hill, ratio=0.3),
    "simplify.qem_bp": lambda _: simplify.qem_bp(hill, ratio=0.3),
    "simplify.qem_tp": lambda _: simplify.qem_tp(pipe, ratio=0.3),
    "simplify.qem_btp": lambda _: simplify.qem_btp(pipe, ratio=0.3),
    "simplify.lod_chain": lambda _: simplify.lod_chain(hill, 3),
    "simplify.simplify_scene": lambda _: simplify.simplify_scene(hill_scene, ratio=0.3),
    "simplify.scene_lods": lambda _: simplify.scene_lods(hill_scene, 3),
    "simplify.polygon_budget": lambda _: simplify.polygon_budget(10.0, 72.0),
    "simplify.share_budget": lambda _: simplify.share_budget([hill, pipe], 200),
    "simplify.confidence_of_levels": lambda _: simplify.confidence_of_levels(
        np.arange(12, dtype=np.uint8).reshape(3, 4), 15
    ),
    "simplify.cs3_cameras": lambda t: simplify.cs3_cameras(views, 60, threads=t),
    "simplify.relief_cameras": lambda t: simplify.relief_cameras(views, 60, threads=t),
    "simplify.dense_mesh": lambda t: simplify.dense_mesh(DEPTH, CAMERA, threads=t),
    "simplify.dense_mesh_grid": lambda t: simplify.dense_mesh_grid(GRID, threads=t),
    "simplify.cs3": lambda t: simplify.cs3(DEPTH, CAMERA, 100, threads=t),
    "simplify.cs3_grid": lambda t: simplify.cs3_grid(GRID, None, 100, threads=t),
    "simplify.relief": lambda t: simplify.relief(DEPTH, CAMERA, 60, effort="live", threads=t),
    "simplify.relief_grid": lambda t: simplify.relief_grid(
        GRID, None, 60, effort="live", threads=t
    ),
    "simplify.sample_depth": lambda t: simplify.sample_depth(
        DEPTH, CAMERA, 60, method="uniform", threads=t
    ),
    "simplify.sample_depth_grid": lambda _: simplify.sample_depth_grid(
        GRID, None, 60, method="uniform"
    ),
    "simplify.simplify_depth": lambda t: simplify.simplify_depth(
        DEPTH, CAMERA, simplify.DepthOptions(60, threads=t)
    ),
    "simplify.cut_depth_steps": lambda _: simplify.cut_depth_steps(found, DEPTH),
    "simplify.grid_delaunay": lambda _: simplify.grid_delaunay(np.argwhere(DEPTH % 7 == 0)),
    "modify.repose": lambda t: modify.repose(hill.vertices, skeleton, threads=t),
    "modify.body_mirror": lambda _: modify.body_mirror(skeleton, "right_arm"),
    "modify.clothing_colors": lambda _: modify.clothing_colors(colored),
    "modify.segment_body": lambda _: modify.segment_body(
        person.depth, person.calibration.depth, skeleton
    ),
    "modify.lift_landmarks": lambda _: modify.lift_landmarks(
        np.full((33, 2), 80.0), np.ones(33), np.zeros(33), person
    ),
    "modify.skeleton_from": lambda _: modify.skeleton_from(
        skeleton.positions, skeleton.states, layout="kinect-v2"
    ),
    "modify.skeletons_from_motion": lambda _: modify.skeletons_from_motion(moves),
    "modify.joint_layouts": lambda _: modify.joint_layouts(),
    "forge.segment": lambda _: forge.segment(cloud).label,
    "forge.nearest_object": lambda _: forge.nearest_object(street),
    "forge.range_scale": lambda _: forge.range_scale(cloud, hoax),
    "forge.ctp": lambda t: forge.ctp(cloud, hoax, position=(4, 1, 0), threads=t),
    "forge.crtp": lambda t: forge.crtp(cloud, hoax, position=(4, 1, 0), spacing=0.3, threads=t),
    "forge.resample": lambda t: forge.resample(hoax, spacing=0.2, threads=t),
    "forge.subtract": lambda t: forge.subtract(cloud, box, threads=t),
    "forge.deform": lambda t: forge.deform(cloud, box, amplitude=0.2, threads=t),
    "forge.insert_occluding": lambda t: forge.insert_occluding(
        cloud, hoax, position=(6, 1, 0), lattice=rings, threads=t
    ),
    "forge.snap_to_lattice": lambda t: forge.snap_to_lattice(pasted, rings, along="ray", threads=t),
    "forge.lattice_insert": lambda t: forge.lattice_insert(
        scan, near_wall, lattice=scanner, turn=1.5, threads=t
    ),
    "forge.lattice_remove": lambda t: forge.lattice_remove(scan, wall, lattice=scanner, threads=t),
    "forge.spoof": lambda t: forge.spoof(scan, near_wall, lattice=scanner, turn=1.5, threads=t),
    "forge.additive": lambda t: forge.additive(
        cloud, hoax, offset=(9, 9, 0), allow_collision=True, threads=t
    ),
    "forge.subtractive": lambda t: forge.subtractive(cloud, box, threads=t),
    "forge.additive_subtractive": lambda t: forge.additive_subtractive(
        cloud, hoax, box, offset=(9, 9, 0), allow_collision=True, threads=t
    ),
    "forge.replacement": lambda t: forge.replacement(
        cloud, hoax, box, allow_collision=True, threads=t
    ),
    "forge.translation": lambda t: forge.translation(cloud, box, allow_collision=True, threads=t),
    "forge.rotation": lambda t: forge.rotation(cloud, box, allow_collision=True, threads=t),
    "authenticate.estimate_origin": lambda t: authenticate.estimate_origin(scan, threads=t),
    "authenticate.estimate_grid": lambda t: authenticate.estimate_grid(scan, threads=t),
    "authenticate.estimate_lattice": lambda _: authenticate.estimate_lattice([scan]),
    "authenticate.identify_sensor": lambda t: authenticate.identify_sensor(scan, threads=t),
    "authenticate.kitti_lattice": lambda _: authenticate.kitti_lattice(),
    "authenticate.measure_power": lambda t: authenticate.measure_power(
        [LidarFrame(cloud)], scanner, planted=1, threads=t
    ),
    "authenticate.calibrate_lattice": lambda t: authenticate.calibrate_lattice(
        [LidarFrame(scan[9 * k :]) for k in range(4)], planted=1, threads=t
    ),
    "authenticate.inspect": lambda t: authenticate.inspect(cloud, origin=(0, 0, 0), threads=t),
    "authenticate.inspect_drive": lambda t: list(
        authenticate.inspect_drive([LidarFrame(cloud)] * 2, origin=(0, 0, 0), threads=t)
    ),
    "authenticate.points_id": lambda _: authenticate.points_id(cloud),
    "authenticate.are_same_points": lambda _: authenticate.are_same_points("0" * 32, "f" * 32),
    "authenticate.judge_drive": lambda _: authenticate.judge_drive([inspected]),
    "authenticate.verdict_of_drive": lambda _: authenticate.verdict_of_drive([inspected]),
    "authenticate.drive_evidence": lambda _: authenticate.drive_evidence([inspected]),
    "authenticate.likelihood_ratio": lambda _: authenticate.likelihood_ratio(0.01),
    "authenticate.combined_verdict": lambda _: authenticate.combined_verdict(inspected.detectors),
    "authenticate.occlusion_consistency": lambda t: authenticate.occlusion_consistency(
        cloud, grid=angles, threads=t
    ),
    "authenticate.density_consistency": lambda t: authenticate.density_consistency(
        cloud, threads=t
    ),
    "authenticate.generic_consistency": lambda t: authenticate.generic_consistency(
        scan, lattice=scanner, threads=t
    ),
    "authenticate.turn_consistency": lambda t: authenticate.turn_consistency(
        yard[~turn_scans.box_at(0, 0.0).contains(yard)], yard, yard, lattice=scanner, threads=t
    ),
    "authenticate.reflectance_consistency": lambda t: authenticate.reflectance_consistency(
        shining, lattice=scanner, previous=shining, following=shining, turns=level, threads=t
    ),
    "metrics.render_depth": lambda t: metrics.render_depth(dense, CAMERA, threads=t),
    "metrics.range_image_error": lambda t: metrics.range_image_error(
        DEPTH, CAMERA, dense, threads=t
    ),
    "metrics.range_image_error_grid": lambda t: metrics.range_image_error_grid(
        GRID, None, dense, threads=t
    ),
    "metrics.flicker": lambda t: metrics.flicker([dense, dense], CAMERA, threads=t),
    "metrics.boundary_noise": lambda t: metrics.boundary_noise(
        DEPTH, CAMERA, dense, flying=DEPTH % 9 == 0, truth=DEPTH / 1000.0, threads=t
    ),
    "metrics.texture_error": lambda t: metrics.texture_error(
        pipe, coarse_pipe, samples=500, threads=t
    ),
    "metrics.color_error": lambda t: metrics.color_error(
        hill.replace(colors=paint), hill.replace(colors=paint[::-1]), samples=500, threads=t
    ),
    "metrics.boundary_gap": lambda t: metrics.boundary_gap(pipe, coarse_pipe, threads=t),
    "metrics.closest_points": lambda t: metrics.closest_points(hill, cloud, threads=t),
    "metrics.nearest_distances": lambda t: metrics.nearest_distances(cloud, threads=t),
    "metrics.compare": lambda t: metrics.compare(hill, coarse, threads=t),
    "metrics.metro": lambda t: metrics.metro(hill, coarse, threads=t),
    "metrics.hausdorff_bound": lambda t: metrics.hausdorff_bound(
        hill, coarse, tolerance=1e-2, threads=t
    ),
    "metrics.fmpd": lambda t: metrics.fmpd(hill, coarse, threads=t),
}


READ_FILES = {
    "capture.holds_clouds",
    "authenticate.as_stored",
    "authenticate.drive_numbers",
    "authenticate.drive_pictures",
    "authenticate.drive_scans",
    "authenticate.embed_files",
    "authenticate.find_record",
    "authenticate.read_carrier",
    "authenticate.read_record",
    "authenticate.read_rigs",
    "authenticate.record_path",
    "forge.read_stream_truth",
    "authenticate.scan_of_record",
    "authenticate.verify_files",
    "authenticate.write_rigs",
    "authenticate.write_carrier",
    "authenticate.write_watermarked",
    "simplify.simplify_depth_file",
    "simplify.simplify_camera_files",
    "simplify.simplify_recording",
    "simplify.poses_of_files",
    "simplify.common_depth_unit",
    "simplify.colors_of_frames",
}
"""Readers, or readers, kernels and writers in one."""


def public_functions() -> set[str]:
    """Names of what the packages of kernels export and is a function."""
    names: set[str] = set()
    for package in ("simplify", "modify", "forge", "authenticate", "metrics"):
        module = importlib.import_module(f"manip3d.{package}")
        exported = {name: getattr(module, name) for name in module.__all__}
        names |= {
            f"{package}.{name}" for name, item in exported.items() if isfunction(unwrap(item))
        }
    return names - READ_FILES


def _feed(digest: hashlib._Hash, value: object) -> None:
    if isinstance(value, np.ndarray):
        digest.update(f"{value.dtype.str}{value.shape}".encode())
        digest.update(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, Mesh):
        for name in value.__slots__:
            _feed(digest, getattr(value, name))
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        for field in dataclasses.fields(value):
            if not field.name.startswith("_") and field.name not in ("seconds", "timings"):
                _feed(digest, getattr(value, field.name))
    elif isinstance(value, dict):
        for key in sorted(value, key=str):
            _feed(digest, (str(key), value[key]))
    elif isinstance(value, tuple | list):
        digest.update(f"{len(value)}".encode())
        for item in value:
            _feed(digest, item)
    elif isinstance(value, Enum):
        _feed(digest, value.value)
    else:
        digest.update(repr(value).encode())


def hash_of(value: object) -> str:
    """One hash over all that a kernel returns, except the seconds that it took."""
    digest = hashlib.sha256()
    _feed(digest, value)
    return digest.hexdigest()

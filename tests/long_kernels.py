"""Kernels on inputs that take seconds: ``python long_kernels.py NAME`` presses Ctrl-C amid one.

It prints how many seconds of processor time passed from Ctrl-C to KeyboardInterrupt, which do not
depend on what else the machine does, or ``finished``.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

import capsule_body
import exact_models
import lattice_scans
from gltf_files import scene_of
from manip3d import Intrinsics, LidarFrame, Mesh, authenticate, forge, metrics, modify, simplify

PRESSED_AFTER_S = 0.1  # of the kernel's processor time
ROWS, COLS = 1200, 1600
CAMERA = Intrinsics(COLS, ROWS, 1500.0, 1500.0, COLS / 2, ROWS / 2)


@cache
def cloud(count: int = 2_000_000, seed: int = 1) -> NDArray[np.float32]:
    spread = np.float32([20, 20, 1])
    return np.random.default_rng(seed).standard_normal((count, 3), np.float32) * spread


@cache
def shining(copies: int) -> LidarFrame:
    points = scan(copies)
    return LidarFrame(points, (np.arange(len(points)) % 97 / 100).astype(np.float32))


def scan(copies: int = 1) -> NDArray[np.float32]:
    turn = lattice_scans.scan(np.random.default_rng(0))
    far = [turn * np.float32(1 + 0.001 * k) for k in range(copies)]
    return np.concatenate(far)


@cache
def hill(side: int, lift: float = 0.0) -> Mesh:
    mesh = exact_models.hill(side)
    return mesh.replace(vertices=mesh.vertices + np.array([0, 0, lift]))


@cache
def depth() -> NDArray[np.uint16]:
    v, u = np.mgrid[0:ROWS, 0:COLS]
    hills = 1200 + ((u - COLS // 2) ** 2 + (v - ROWS // 2) ** 2) // 2000
    return (hills + (7 * u + 5 * v) % 4).astype(np.uint16)


@cache
def ball(count: int) -> NDArray[np.float32]:
    return np.random.default_rng(2).standard_normal((count, 3), np.float32) / 2


@cache
def wall(count: int = 20_000) -> Mesh:
    """Triangles that each cover most of the picture."""
    corners = np.random.default_rng(0).uniform(-3, 3, (count, 3, 3)) + np.array([0, 0, 4])
    corners += [[-40, -40, 0], [40, -40, 0], [0, 60, 0]]
    return Mesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


RINGS = forge.Lattice([[k / 64, 0.125] for k in range(-48, 16)], 2**-9)
SKELETON = capsule_body.painted(0).skeletons[0]
SMALL = Intrinsics(640, 480, 500.0, 500.0, 319.5, 239.5)
FLAT = np.full((480, 640), 4000, np.uint16)

LONG: dict[str, Callable[[], Callable[[], object]]] = {
    "simplify.clean": lambda: partial(simplify.clean, hill(900)),
    "simplify.quality": lambda: partial(simplify.quality, hill(300), ratio=0.2),
    "simplify.fast": lambda: partial(simplify.fast, hill(900), ratio=0.1),
    "simplify.simplify": lambda: partial(simplify.simplify, hill(300), ratio=0.2),
    "simplify.qem4vr": lambda: partial(simplify.qem4vr, hill(400), ratio=0.1),
    "simplify.qem_orig": lambda: partial(simplify.qem_orig, hill(400), ratio=0.1),
    "simplify.qem_bp": lambda: partial(simplify.qem_bp, hill(400), ratio=0.1),
    "simplify.lod_chain": lambda: partial(simplify.lod_chain, hill(400), 3),
    "simplify.simplify_scene": lambda: partial(
        simplify.simplify_scene, scene_of(hill(300)), ratio=0.2
    ),
    "simplify.scene_lods": lambda: partial(simplify.scene_lods, scene_of(hill(400)), 3),
    "simplify.share_budget": lambda: partial(simplify.share_budget, [hill(300)] * 2, 200),
    "simplify.relief_cameras": lambda: partial(
        simplify.relief_cameras, [simplify.CameraView(depth(), CAMERA)] * 3, 9000, threads=1
    ),
    "simplify.cs3_cameras": lambda: partial(
        simplify.cs3_cameras, [simplify.CameraView(depth(), CAMERA)] * 3, 9000, threads=1
    ),
    "modify.repose": lambda: partial(modify.repose, cloud(), SKELETON, threads=1),
    "forge.segment": lambda: partial(forge.segment, cloud()),
    "forge.nearest_object": lambda: partial(forge.nearest_object, cloud()),
    "forge.crtp": lambda: partial(
        forge.crtp, cloud(), ball(400_000), position=(4, 1, 0), spacing=0.01, threads=1
    ),
    "forge.resample": lambda: partial(forge.resample, ball(400_000), spacing=0.008, threads=1),
    "forge.insert_occluding": lambda: partial(
        forge.insert_occluding, cloud(), ball(90_000), position=(6, 1, 0), lattice=RINGS, threads=1
    ),
    "forge.snap_to_lattice": lambda: partial(
        forge.snap_to_lattice,
        forge.ctp(cloud(), cloud(), position=(99, 1, 0)),
        RINGS,
        along="ray",
        threads=1,
    ),
    "authenticate.estimate_origin": lambda: partial(
        authenticate.estimate_origin, scan(5) + np.float32(3), threads=1
    ),
    "authenticate.estimate_lattice": lambda: partial(authenticate.estimate_lattice, [scan()] * 20),
    "authenticate.identify_sensor": lambda: partial(
        authenticate.identify_sensor, scan(20), threads=1
    ),
    "authenticate.measure_power": lambda: partial(
        authenticate.measure_power,
        [LidarFrame(scan())] * 4,
        lattice_scans.lattice(),
        planted=3,
        threads=1,
    ),
    "authenticate.calibrate_lattice": lambda: partial(
        authenticate.calibrate_lattice,
        [LidarFrame(scan()[9 * k :]) for k in range(8)],
        planted=3,
        threads=1,
    ),
    "authenticate.inspect": lambda: partial(
        authenticate.inspect, cloud(), origin=(0, 0, 0), threads=1
    ),
    "authenticate.density_consistency": lambda: partial(
        authenticate.density_consistency, cloud(), threads=1
    ),
    "authenticate.generic_consistency": lambda: partial(
        authenticate.generic_consistency, scan(30), lattice=lattice_scans.lattice(), threads=1
    ),
    "authenticate.turn_consistency": lambda: partial(
        authenticate.turn_consistency,
        scan(30),
        scan(30),
        scan(30),
        lattice=lattice_scans.lattice(),
        threads=1,
    ),
    "authenticate.reflectance_consistency": lambda: partial(
        authenticate.reflectance_consistency,
        shining(30),
        lattice=lattice_scans.lattice(),
        threads=1,
    ),
    "metrics.render_depth": lambda: partial(metrics.render_depth, wall(), SMALL, threads=1),
    "metrics.range_image_error": lambda: partial(
        metrics.range_image_error, FLAT, SMALL, wall(), threads=1
    ),
    "metrics.flicker": lambda: partial(metrics.flicker, [wall()] * 2, SMALL, threads=1),
    "metrics.boundary_noise": lambda: partial(
        metrics.boundary_noise, FLAT, SMALL, wall(), flying=FLAT > 0, truth=FLAT / 1000.0, threads=1
    ),
    "metrics.boundary_gap": lambda: partial(
        metrics.boundary_gap, hill(1000), hill(1000, 1e-3), threads=1
    ),
    "metrics.closest_points": lambda: partial(
        metrics.closest_points, hill(300), cloud() / 20, threads=1
    ),
    "metrics.nearest_distances": lambda: partial(metrics.nearest_distances, cloud(), threads=1),
    "metrics.compare": lambda: partial(metrics.compare, hill(300), hill(300, 0.37), threads=1),
    "metrics.metro": lambda: partial(metrics.metro, hill(300), hill(300, 0.37), threads=1),
    "metrics.hausdorff_bound": lambda: partial(
        metrics.hausdorff_bound, hill(300), hill(300, 0.37), tolerance=1e-6, threads=1
    ),
}
"""Makers of work in one thread; what is made before is not part of it."""

SHORT = {
    "authenticate.attack_type",
    "authenticate.cross_modal_consistency",
    "authenticate.drive_evidence",
    "authenticate.likelihood_ratio",
    "authenticate.stereo_disparity",
    "authenticate.surround_consistency",
    "authenticate.temporal_factor",
    "authenticate.verdict_of_alerts",
    "authenticate.watch_drive",
    "simplify.boundary_vertices",
    "simplify.qem_tp", "simplify.qem_btp", "simplify.dense_mesh", "simplify.dense_mesh_grid",
    "simplify.cs3", "simplify.cs3_grid", "simplify.relief", "simplify.relief_grid",
    "simplify.sample_depth", "simplify.sample_depth_grid", "simplify.simplify_depth",
    "simplify.confidence_of_levels", "simplify.cut_depth_steps", "simplify.grid_delaunay",
    "modify.body_mirror", "modify.clothing_colors",
    "modify.segment_body", "modify.lift_landmarks", "modify.skeleton_from", "modify.joint_layouts",
    "modify.skeletons_from_motion", "simplify.polygon_budget",
    "forge.range_scale", "forge.ctp", "forge.subtract", "forge.deform", "forge.additive",
    "forge.subtractive", "forge.additive_subtractive", "forge.replacement", "forge.translation",
    "forge.rotation", "forge.lattice_insert", "forge.lattice_remove", "forge.spoof",
    "authenticate.estimate_grid", "authenticate.kitti_lattice",
    "authenticate.points_id", "authenticate.are_same_points",
    "authenticate.inspect_drive", "authenticate.verdict_of_drive", "authenticate.judge_drive",
    "authenticate.combined_verdict", "authenticate.occlusion_consistency",
    "authenticate.record_of_picture", "authenticate.without_record",
    "authenticate.noise_blocks", "authenticate.embed_paper", "authenticate.compare_paper",
    "authenticate.verdict_of_stream", "authenticate.depth_noise", "authenticate.inter_frame_noise",
    "authenticate.inspect_stream", "authenticate.judged_frames", "forge.background_plate",
    "forge.without_people", "forge.stream",
    "forge.recorded_people", "forge.recorded_poses", "forge.at_pace",
    "modify.animation_mesh", "modify.animate",
    "metrics.range_image_error_grid", "metrics.texture_error", "metrics.color_error",
    "metrics.fmpd",
}  # fmt: skip
"""Done in about a second with two million points or pixels, or the same code as one above."""


def seconds_to_stop(work: Callable[[], object], after: float = PRESSED_AFTER_S) -> float | None:
    """Processor time from Ctrl-C to KeyboardInterrupt; None: the work was done before."""
    begin = time.process_time()
    pressed, over = 0.0, threading.Event()

    def press() -> None:
        nonlocal pressed
        while not over.wait(0.01):
            if time.process_time() - begin > after:
                pressed = time.process_time()
                os.kill(os.getpid(), signal.SIGINT)
                return

    thread = threading.Thread(target=press)
    thread.start()
    try:
        work()
    except KeyboardInterrupt:
        return time.process_time() - pressed
    else:
        return None
    finally:
        over.set()
        thread.join()


if __name__ == "__main__":
    taken = seconds_to_stop(LONG[sys.argv[1]]())
    print("finished" if taken is None else f"{taken:.3f}")

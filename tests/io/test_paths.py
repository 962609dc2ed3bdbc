"""Paths with a NUL character are refused everywhere: the system would open another file."""

from __future__ import annotations

import importlib
import inspect
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

import exact_models
import rgbd_frames
from manip3d import (
    InputError,
    LidarFrame,
    Material,
    Texture,
    _core,
    authenticate,
    batch,
    capture,
    datasets,
    experiments,
    forge,
    io,
    report,
    simplify,
    simulate,
    study,
    viewer,
)

NUL = "victim.obj\0.obj"
mesh = exact_models.hill(5)
scan = LidarFrame(np.random.default_rng(0).random((50, 3), np.float32))
MISSING = Path("missing")

OPTIONS = simplify.DepthOptions(points=10, intrinsics="kinect-v2")


def marker() -> authenticate.Watermarker:
    with TemporaryDirectory() as folder:
        return authenticate.Watermarker(authenticate.KeyFile.create(folder + "/a.key"))


def write_results(path: str) -> object:
    """The results of a study without answers."""
    with tempfile.TemporaryDirectory() as folder:
        file = study.write_template("display", Path(folder) / "study.toml", example=True)
        asked, definition = study.read_study(file)
        with study.StudyFolder(Path(folder) / "answers", definition) as answers:
            return study.write_results(asked, answers, path)


def write_scene(path: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "hill.glb"
        mesh.write(file)
        io.write_scene(io.read_scene(file), path)


def write_rigs(path: str) -> None:
    calibration = datasets.KittiCalibration(*simulate.cameras.projections())
    rig = authenticate.StereoRig.from_calibration(calibration)
    authenticate.write_rigs({"front": authenticate.CameraPair(rig, 2, 3)}, path)


# By "function parameter"; the callable gets the path.
ENTRIES: dict[str, Callable[[str], object]] = {
    "io.read_bvh path": io.read_bvh,
    "io.read_depth path": io.read_depth,
    "io.read_pixel_map path": io.read_pixel_map,
    "io.read_mesh path": io.read_mesh,
    "io.read_report path": io.read_report,
    "io.read_range_grid path": io.read_range_grid,
    "io.read_scan path": lambda p: io.read_scan(p + ".pcd"),
    "io.read_scans path": lambda p: io.read_scans(p + ".e57"),
    "io.write_mesh path": lambda p: io.write_mesh(mesh, p),
    "io.write_scan path": lambda p: io.write_scan(scan, p + ".pcd"),
    "io.write_scans path": lambda p: io.write_scans([scan], p + ".e57"),
    "capture.open uri": lambda p: capture.open(f"folder:{p}"),
    "capture.open_lidar uri": lambda p: capture.open_lidar(f"pcap:{p}"),
    "capture.open_lidar calibration": lambda p: capture.open_lidar("velodyne:0", calibration=p),
    "capture.open_lidar metadata": lambda p: capture.open_lidar(f"ouster:{__file__}", metadata=p),
    "capture.open_drive source": capture.open_drive,
    "capture.open_drive calibration": lambda p: capture.open_drive("velodyne:0", calibration=p),
    "capture.open_rgbd uri": lambda p: capture.open_rgbd(f"mkv:{p}"),
    "capture.read_velodyne_calibration path": capture.read_velodyne_calibration,
    "capture.record path": lambda p: capture.record(
        rgbd_frames.frames(1), p.replace(".obj", ""), overwrite=True
    ),
    "datasets.open_kitti path": datasets.open_kitti,
    "datasets.open_kitti calibration": lambda p: datasets.open_kitti(".", calibration=p),
    "datasets.open_range_images path": datasets.open_range_images,
    "datasets.open_people uri": lambda p: datasets.open_people(f"people:{p}"),
    "simulate.write_forged_people folder": simulate.write_forged_people,
    "simulate.write_drive folder": lambda p: simulate.write_drive(None, p, 1),  # type: ignore[arg-type]
    "report.write_report results_dir": lambda p: report.write_report(p, "a.md"),
    "report.write_report output": lambda p: report.write_report(".", p + ".md"),
    "viewer.view output": lambda p: viewer.view(mesh, p + ".html"),
    "viewer.play output": lambda p: viewer.play([mesh], p + ".html"),
    "io.is_color_png path": io.is_color_png,
    "io.read_depth_guessing path": io.read_depth_guessing,
    "simplify.simplify_depth_file source": lambda p: simplify.simplify_depth_file(p, "a", OPTIONS),
    "simplify.simplify_depth_file output": lambda p: simplify.simplify_depth_file("a", p, OPTIONS),
    "simplify.simplify_depth_file color": lambda p: simplify.simplify_depth_file(
        "a", "b", OPTIONS, color=p
    ),
    "simplify.simplify_depth_file mask": lambda p: simplify.simplify_depth_file(
        "a", "b", OPTIONS, mask=p
    ),
    "simplify.simplify_depth_file confidence": lambda p: simplify.simplify_depth_file(
        "a", "b", OPTIONS, confidence=p
    ),
    "simplify.poses_of_files sources": lambda p: simplify.poses_of_files([p], "a"),
    "simplify.poses_of_files poses": lambda p: simplify.poses_of_files(["a"], p),
    "simplify.simplify_recording output": lambda p: simplify.simplify_recording([], p, OPTIONS),
    "simplify.simplify_camera_files sources": lambda p: simplify.simplify_camera_files(
        [p], "a", "b", OPTIONS
    ),
    "simplify.simplify_camera_files poses": lambda p: simplify.simplify_camera_files(
        ["a"], p, "b", OPTIONS
    ),
    "simplify.simplify_camera_files output": lambda p: simplify.simplify_camera_files(
        ["a"], "b", p, OPTIONS
    ),
    "simplify.simplify_camera_files colors": lambda p: simplify.simplify_camera_files(
        ["a"], "b", "c", OPTIONS, colors=[p]
    ),
    "simplify.colors_of_frames frames": lambda p: simplify.colors_of_frames([p], "."),
    "simplify.colors_of_frames colors": lambda p: simplify.colors_of_frames([], p),
    "simplify.common_depth_unit frames": lambda p: simplify.common_depth_unit([p]),
    "io.local_copy source": lambda p: io.local_copy(p).__enter__(),
    "io.local_output output": lambda p: io.local_output(p).__enter__(),
    "batch.find_files sources": batch.find_files,
    "report.write_evidence output": lambda p: report.write_evidence(
        authenticate.inspect(scan), p + ".json"
    ),
    "report.write_drive_evidence output": lambda p: report.write_drive_evidence(
        [], p + ".html", names=[]
    ),
    "report.write_stream_evidence output": lambda p: report.write_stream_evidence(
        authenticate.inspect_stream(rgbd_frames.frames(1)), rgbd_frames.frames(1), p + ".json"
    ),
    "report.append_log path": lambda p: report.append_log(
        p, authenticate.inspect(scan), source="x"
    ),
    "report.read_log path": report.read_log,
    "report.write_suspected_rows output": lambda p: report.write_suspected_rows(
        authenticate.inspect(scan), p
    ),
    "capture.export_joints path": lambda p: capture.export_joints(rgbd_frames.frames(1), p),
    "io.read_scene path": io.read_scene,
    "io.write_scene path": lambda p: write_scene(p + ".glb"),
    "report.write_alert_overview output": lambda p: report.write_alert_overview(
        [{"source": "a", "error": "b"}], p + ".html"
    ),
    "capture.watched_recording uri": lambda p: capture.watched_recording(f"pcap:{p}"),
    "capture.watched_recording calibration": lambda p: capture.watched_recording(
        "velodyne:0", calibration=p
    ),
    "capture.watched_recording rigs": lambda p: capture.watched_recording(f"bag:{p}", rigs=p),
    "datasets.watched_kitti folder": datasets.watched_kitti,
    "datasets.watched_kitti calibration": lambda p: datasets.watched_kitti(".", calibration=p),
    "datasets.watched_kitti rigs": lambda p: datasets.watched_kitti(".", rigs=p),
    "datasets.watched_kitti carriers": lambda p: datasets.watched_kitti(p, carriers=p),
    "authenticate.read_rigs path": authenticate.read_rigs,
    "authenticate.write_rigs path": write_rigs,
    "io.write_lods path": lambda p: io.write_lods([mesh], p + ".glb"),
    "viewer.kind_of source": viewer.kind_of,
    "viewer.open_thing source": viewer.open_thing,
    "viewer.open_thing color": lambda p: viewer.open_thing(__file__, color=p),
    "viewer.open_thing calibration": lambda p: viewer.open_thing(__file__, calibration=p),
    "capture.folder_depth folder": lambda p: capture.folder_depth(p, intrinsics="tum"),
    "capture.holds_clouds path": capture.holds_clouds,
    "authenticate.as_stored path": lambda p: authenticate.as_stored(scan, p),
    "authenticate.as_stored unchanged": lambda p: authenticate.as_stored(
        scan, "a.bin", unchanged=p
    ),
    "authenticate.calibrate_lattice frames": lambda p: authenticate.calibrate_lattice([p] * 4),
    "authenticate.drive_numbers folder": authenticate.drive_numbers,
    "authenticate.drive_scans folder": authenticate.drive_scans,
    "authenticate.drive_pictures drive": lambda p: authenticate.drive_pictures(p, "image_02"),
    "authenticate.embed_files source": lambda p: authenticate.embed_files(marker(), p, "b.bin"),
    "authenticate.embed_files output": lambda p: authenticate.embed_files(marker(), ".", p),
    "authenticate.verify_files source": lambda p: authenticate.verify_files(marker(), p),
    "authenticate.verify_files record": lambda p: authenticate.verify_files(
        marker(), "a.bin", record=p
    ),
    "authenticate.find_record scan": authenticate.find_record,
    "authenticate.read_carrier path": authenticate.read_carrier,
    "authenticate.write_carrier path": lambda p: authenticate.write_carrier(
        np.zeros((8, 8), np.uint8), p
    ),
    "authenticate.read_record path": authenticate.read_record,
    "authenticate.record_path scan": authenticate.record_path,
    "authenticate.scan_of_record record": lambda p: authenticate.scan_of_record(p + ".wm"),
    "authenticate.write_watermarked path": lambda p: authenticate.write_watermarked(
        authenticate.Watermarked(scan, b"", 0, 1), p + ".bin"
    ),
    "authenticate.write_watermarked unchanged": lambda p: authenticate.write_watermarked(
        authenticate.Watermarked(scan, b"", 0, 1), "a.bin", unchanged=p
    ),
    "authenticate.write_watermarked picture": lambda p: authenticate.write_watermarked(
        authenticate.Watermarked(scan, b"", 0, 1), "a.bin", picture=p
    ),
    "forge.read_stream_truth path": forge.read_stream_truth,
    "study.copy_rating_stimuli images": lambda p: study.copy_rating_stimuli(p, "b"),
    "study.copy_rating_stimuli output": lambda p: study.copy_rating_stimuli(".", p),
    "study.make_stimuli images": lambda p: study.make_stimuli(p, images=p),
    "study.make_rating_stimuli output": study.make_rating_stimuli,
    "study.make_stimuli definition": study.make_stimuli,
    "study.read_study path": study.read_study,
    "study.write_results output": write_results,
    "study.write_template path": lambda p: study.write_template("display", p + ".toml"),
    "experiments.run folder": lambda p: experiments.run([], folder=Path(p)),
}


def public_path_parameters() -> Iterator[str]:
    """All public functions with a parameter that is a path."""
    rooms = ("io", "capture", "simplify", "modify", "forge", "authenticate", "metrics", "datasets")
    for room in (*rooms, "simulate", "study", "experiments", "report", "viewer"):
        module = importlib.import_module(f"manip3d.{room}")
        for name in module.__all__:
            function = inspect.unwrap(getattr(module, name), stop=lambda f: inspect.isclass(f))
            if not inspect.isfunction(function):
                continue
            for parameter, value in inspect.signature(function).parameters.items():
                if "PathLike" in str(value.annotation) or parameter == "uri":
                    yield f"{room}.{name} {parameter}"


NO_PATHS = {"capture.from_frames uri", "io.is_url source"}  # names that nothing is opened by


def test_the_list_of_entries_is_complete() -> None:
    assert set(public_path_parameters()) - NO_PATHS <= set(ENTRIES)


@pytest.mark.parametrize("entry", ENTRIES)
def test_a_nul_is_refused(entry: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    victim = tmp_path / "victim.obj"
    victim.write_bytes(b"precious")
    with pytest.raises(InputError):
        ENTRIES[entry](NUL)
    assert victim.read_bytes() == b"precious"
    assert [path.name for path in tmp_path.iterdir()] == ["victim.obj"]


def test_methods_refuse_a_nul(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    forged = forge.ctp(scan, scan.points[:9], position=(1, 1, 1))
    lattice = authenticate.SensorLattice
    calls: list[Callable[[], Any]] = [
        lambda: mesh.write(NUL),
        lambda: scan.write("a.pcd\0.pcd"),
        lambda: forged.write("a.bin\0.bin"),
        lambda: lattice.load(NUL),
        lambda: authenticate.KeyFile(NUL),
        lambda: study.StudyFolder(NUL, {}),
        lambda: authenticate.KeyFile.create(NUL),
        lambda: io.texture_path(mesh.replace(source="a.obj"), Texture("a.png\0.png")),
        lambda: _core.write_mesh(mesh, b"a.off\0.off", b"", 0, False, [], [], False),
        lambda: _core.make_temporary_folder(b"a\0b"),
    ]
    for call in calls:
        with pytest.raises(InputError, match="NUL"):
            call()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("address", ["127.0.0.1\0.5", "127.0.0.1\0"])
def test_addresses_with_a_nul_are_refused(address: str) -> None:
    with pytest.raises(InputError, match="NUL"):
        capture.open(f"velodyne:{address}:0")
    with pytest.raises(InputError, match="NUL"):
        capture.open("velodyne:0", sender=address)


def test_a_name_that_no_file_can_have_is_refused() -> None:
    with pytest.raises(InputError, match="path"):
        io.read_mesh("a\ud800.obj")


def test_a_nul_in_a_texture_of_a_mesh_reads_no_other_file(tmp_path: Path) -> None:
    (tmp_path / "secret.png").write_bytes(b"\x89PNG secret")
    textured = exact_models.pipe(8, 3).replace(source=str(tmp_path / "a.obj"))
    material = Material("skin", textures={"base_color": Texture("secret.png\0.png")})
    with pytest.raises(InputError, match="NUL"):
        textured.replace(
            materials=(material,), face_material=np.zeros(textured.num_faces, np.int32)
        ).write(tmp_path / "out.glb")

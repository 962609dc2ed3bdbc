"""The frames of RGB-D recordings become meshes in a folder."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from command_line import error_line, manip3d
from manip3d import FormatError, InputError, RgbdFrame, capture, read_mesh, simplify

OPTIONS = simplify.DepthOptions(300)


@pytest.fixture(scope="module")
def frames() -> list[RgbdFrame]:
    with capture.open_rgbd("sim:body?frames=3") as source:
        return list(source)


def test_a_frame_becomes_what_its_images_do(frames: list[RgbdFrame], tmp_path: Path) -> None:
    made = simplify.simplify_recording(frames, tmp_path / "meshes", OPTIONS)
    assert not made.failed
    assert [result.output.name for result in made.frames] == [f"00000{k}.glb" for k in range(3)]
    frame, result = frames[1], made.frames[1]
    alone = simplify.simplify_depth(
        frame.depth,
        frame.calibration.depth,
        OPTIONS,
        color=frame.color,
        registration=frame.calibration.registration,
    )
    mesh = read_mesh(result.output)
    used = alone.vertices[np.unique(alone.faces)]  # files leave the others out
    np.testing.assert_allclose(
        np.sort(mesh.vertices, axis=0),
        np.sort(used * np.array([1.0, -1.0, -1.0]), axis=0),
        atol=1e-6,
    )
    assert (result.points, result.coverage) == (alone.num_used, alone.coverage)
    assert mesh.materials[0].base_color is not None


def test_stable_meshes_depend_on_the_frames_before(frames: list[RgbdFrame], tmp_path: Path) -> None:
    noise = np.random.default_rng(0)
    noisy = [
        replace(
            frames[0], depth=np.where(frames[0].depth > 0, frames[0].depth + shift, 0), number=k
        )
        for k, shift in enumerate(noise.integers(0, 9, (4, *frames[0].depth.shape), np.uint16))
    ]
    kept = []
    for stable in (False, True):
        folder = tmp_path / str(stable)
        made = simplify.simplify_recording(noisy, folder, OPTIONS, stable=stable)
        sets = [
            {tuple(p) for p in read_mesh(r.output).vertices[:, :2].round(2)} for r in made.frames
        ]
        kept.append(len(sets[-2] & sets[-1]))
    assert kept[1] > 2 * kept[0]


def test_frames_of_one_number_do_not_replace_each_other(
    frames: list[RgbdFrame], tmp_path: Path
) -> None:
    without = [replace(frame, number=0) for frame in frames]
    without[1] = replace(without[1], depth=np.zeros_like(without[1].depth))
    made = simplify.simplify_recording(without, tmp_path / "places", OPTIONS)
    assert [result.output.name for result in made.frames] == ["000000.glb", "000002.glb"]
    assert list(made.failed) == [1]
    twice = [replace(frame, number=number) for frame, number in zip(frames, (3, 4, 3), strict=True)]
    with pytest.raises(InputError, match="expected one frame of each number, got two of 3"):
        simplify.simplify_recording(twice, tmp_path / "twice", OPTIONS)
    assert len(list((tmp_path / "twice").iterdir())) == 2


def test_frames_without_a_surface_are_named(frames: list[RgbdFrame], tmp_path: Path) -> None:
    blind = replace(frames[1], depth=np.zeros_like(frames[1].depth))
    made = simplify.simplify_recording([frames[0], blind, frames[2]], tmp_path, OPTIONS)
    assert [result.output.name for result in made.frames] == ["000000.glb", "000002.glb"]
    assert list(made.failed) == [1]
    assert "found no measured pixel" in made.failed[1]
    with pytest.raises(FormatError, match="found none in 1; frame 1: expected a surface"):
        simplify.simplify_recording([blind], tmp_path, OPTIONS)


@pytest.mark.parametrize(
    ("options", "more", "reason"),
    [
        (replace(OPTIONS, intrinsics="tum"), {}, "options: expected neither intrinsics nor unit"),
        (replace(OPTIONS, unit="mm"), {}, "options: expected neither intrinsics nor unit"),
        (
            simplify.DepthOptions(None, bandwidth=1e6, rate=30.0),
            {},
            "options: expected points or ratio, and no bandwidth",
        ),
        (
            replace(OPTIONS, method="cs3"),
            {"stable": True},
            "stable: expected method relief, got cs3",
        ),
        (OPTIONS, {"num_frames": 0}, "num_frames: expected at least 1, got 0"),
    ],
)
def test_what_frames_say_themselves_is_refused(
    options: simplify.DepthOptions, more: dict[str, int], reason: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=reason):
        simplify.simplify_recording([], tmp_path / "meshes", options, **more)
    with pytest.raises(InputError, match="frames: expected at least one, got none"):
        simplify.simplify_recording([], tmp_path / "meshes", OPTIONS)
    assert not (tmp_path / "meshes").exists()


def test_meshes_of_an_earlier_run_are_replaced(frames: list[RgbdFrame], tmp_path: Path) -> None:
    simplify.simplify_recording(frames, tmp_path, OPTIONS)
    blind = replace(frames[1], depth=np.zeros_like(frames[1].depth))
    with pytest.raises(FormatError):
        simplify.simplify_recording([blind], tmp_path, OPTIONS, replace=True)
    simplify.simplify_recording(frames[:1], tmp_path, OPTIONS)
    assert len(list(tmp_path.iterdir())) == 3
    simplify.simplify_recording([frames[2], blind], tmp_path, OPTIONS, replace=True)
    assert [path.name for path in tmp_path.iterdir()] == ["000002.glb"]
    foreign = tmp_path / "202411.glb"  # a date
    foreign.write_bytes(b'glTF{"asset":{"generator":"another program"}}')
    simplify.simplify_recording(frames[:1], tmp_path, OPTIONS, replace=True)
    assert {path.name for path in tmp_path.iterdir()} == {"000000.glb", foreign.name}


def test_the_command_takes_recordings(frames: list[RgbdFrame], tmp_path: Path) -> None:
    recording = tmp_path / "visit"
    capture.record(frames, recording)
    out = tmp_path / "meshes"
    done = manip3d("depth", recording, "-o", out, "--points", 300, "--frames", 2, "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert [frame["points"] > 290 for frame in told["frames"]] == [True, True]
    assert told["failed"] == {}
    assert sorted(path.name for path in out.iterdir()) == ["000000.glb", "000001.glb"]
    assert "relief: 2 frames" in done.stderr
    base = ("depth", recording, "-o", out)
    assert "exists already; --force" in error_line(manip3d(*base, "--points", 300))
    for option, value in (
        ("--unit", "mm"),
        ("--color", recording),
        ("--to", ".ply"),
        ("--confidence-max", 2),
    ):
        done = manip3d(*base, "--points", 300, "--force", option, value)
        assert f"{option}: cannot be given with an RGB-D recording" in error_line(done)
    others = ("000007.txt", "7.glb", "0000007.glb", "00000x.glb")
    for name in ("000007.glb", "1000000.glb", *others):
        (out / name).write_bytes((out / "000000.glb").read_bytes())
    (out / "000008.glb").mkdir()
    done = manip3d(*base, "--points", 300, "--frames", 1, "--force")
    assert done.returncode == 0, done.stderr
    kept = {"000000.glb", "000008.glb", *others}  # the meshes of earlier frames are gone
    assert {path.name for path in out.iterdir()} == kept
    done = manip3d(*base, "--points", 300, "--force", "--stable", "--method", "cs3")
    assert "--stable: expected method relief, got cs3" in error_line(done)


def test_the_url_of_an_image_is_no_address_of_a_recording(tmp_path: Path) -> None:
    pytest.importorskip("fsspec")
    np.save(tmp_path / "wall.npy", np.full((48, 64), 2.0, np.float32))
    base = ("depth", f"file://{tmp_path}/wall.npy", "-o", tmp_path / "wall.ply", "--points", 100)
    done = manip3d(*base, "--intrinsics", "60,60,31.5,23.5")
    assert done.returncode == 0, done.stderr
    assert read_mesh(tmp_path / "wall.ply").num_faces > 0


def test_frames_are_those_of_a_recording(tmp_path: Path) -> None:
    np.save(tmp_path / "wall.npy", np.full((48, 64), 2.0, np.float32))
    base = ("depth", tmp_path / "wall.npy", "-o", tmp_path / "wall.ply", "--points", 100)
    done = manip3d(*base, "--intrinsics", "60,60,31.5,23.5", "--frames", 2)
    assert "--frames: can only be given with an RGB-D recording or --poses" in error_line(done)


def test_frames_without_number_before_numbered_ones(
    frames: list[RgbdFrame], tmp_path: Path
) -> None:
    mixed = [replace(frame, number=number) for frame, number in zip(frames, (0, 0, 1), strict=True)]
    with pytest.raises(InputError, match="got two of 0"):
        simplify.simplify_recording(mixed, tmp_path / "mixed", OPTIONS)

"""Camera and unit of folders of depth images, as Python and the command line find them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from command_line import manip3d
from manip3d import capture, simplify
from manip3d.errors import InputError
from manip3d.io import read_mesh

CAMERA = "60,60,31.5,23.5"
CAMERA_OF_OPEN3D = '{"width": 64, "height": 48, "intrinsic_matrix": [60,0,0,0,60,0,31.5,23.5,1]}'


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    """Three depth images of a curved wall in TUM's unit, with a camera in Open3D's file."""
    folder = tmp_path / "walk"
    (folder / "depth").mkdir(parents=True)
    (folder / "camera_intrinsic.json").write_text(CAMERA_OF_OPEN3D)
    v, u = np.mgrid[:48, :64]
    for number in range(3):
        metres = 2.0 + 0.3 * np.sin(u / 9) + 0.2 * np.cos(v / 7 + number)
        stored = np.round(metres * 5000).astype(np.uint16)
        Image.fromarray(stored).save(folder / "depth" / f"{number}.png")
    return folder


def test_the_unit_is_guessed_as_by_the_command_line(walk: Path, tmp_path: Path) -> None:
    found = capture.folder_depth(walk)
    assert found is not None
    assert (found.unit, found.is_guess, found.units_per_metre) == ("tum", True, 5000.0)
    assert found.images == walk / "depth"
    assert found.intrinsics == str(walk / "camera_intrinsic.json")
    with capture.open_rgbd(f"folder:{walk}", units_per_metre=found.units_per_metre) as frames:
        options = simplify.DepthOptions(99)
        made = simplify.simplify_recording(frames, tmp_path / "ours", options)
    done = manip3d("depth", walk, "--points", "99", "-o", tmp_path / "theirs", "--json")
    assert f"read {found.sentence}; --unit overrides it\n" in done.stderr
    assert json.loads(done.stdout)["unit"] == found.unit
    for result in made.frames:
        theirs = read_mesh(tmp_path / "theirs" / result.output.name)
        assert np.array_equal(read_mesh(result.output).vertices, theirs.vertices)


def test_what_is_given_counts(walk: Path) -> None:
    found = capture.folder_depth(walk, intrinsics=CAMERA, unit="4000")
    assert found is not None
    assert (found.intrinsics, found.unit, found.is_guess) == (CAMERA, "4000", False)
    assert found.sentence.endswith("unit 4000 (1/4000 m)")


def test_a_unit_that_is_no_part_of_a_metre_is_refused(walk: Path) -> None:
    found = capture.folder_depth(walk, unit="disparity:50000")
    assert found is not None
    told = f"unit: expected a number of units per metre .* got disparity:50000; {walk / 'depth'}"
    with pytest.raises(InputError, match=told):
        _ = found.units_per_metre


@pytest.mark.parametrize("name", ["calibration.json", "frames.jsonl", "depth.txt", "metadata.yaml"])
def test_files_of_recordings_state_the_unit(walk: Path, name: str) -> None:
    (walk / name).touch()
    assert capture.folder_depth(walk, intrinsics=CAMERA) is None


def test_without_a_camera_or_images_nothing_is_found(walk: Path, tmp_path: Path) -> None:
    (walk / "camera_intrinsic.json").unlink()
    assert capture.folder_depth(walk) is None
    assert capture.folder_depth(tmp_path, intrinsics=CAMERA) is None
    for image in (walk / "depth").iterdir():
        image.write_bytes(b"no image")
    assert capture.folder_depth(walk, intrinsics=CAMERA) is None


def test_what_is_no_folder_is_refused(tmp_path: Path) -> None:
    for place in (tmp_path / "absent", Path(__file__)):
        with pytest.raises(InputError, match="folder: expected a folder with depth images"):
            capture.folder_depth(place, intrinsics=CAMERA)

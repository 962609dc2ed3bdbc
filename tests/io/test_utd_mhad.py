"""Trials of UTD-MHAD that a user has: found by their files, and read with their joints."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import manip3d
from command_line import run
from manip3d import capture
from manip3d.datasets import open_people
from real_data import RealData
from trial_files import FRAMES, write_trial

TABLE = "frame,joint,name,x_m,y_m,z_m"


def write_pictures(folder: Path) -> Path:
    """The same trial as pictures and a table."""
    folder.mkdir()
    lines = [TABLE]
    for frame in range(FRAMES):
        depth = np.full((240, 320), 2000 - frame, np.uint16)
        depth[:, 0] = 0
        Image.fromarray(depth).save(folder / f"depth_{frame:04d}.png")
        lines += [f"{frame},{joint},joint,{joint / 100},0,2" for joint in range(20)]
    (folder / "joints.csv").write_text("\n".join(lines))
    return folder


def test_files_and_folders_of_one_trial_are_recordings(tmp_path: Path) -> None:
    path = write_trial(tmp_path / "one")
    address = f"utd-mhad:{path}"
    assert capture.rgbd_address(str(path)) == address
    path.with_name(f"._{path.name}").write_bytes(b"\0\5\x16\7")  # macOS writes it
    assert capture.rgbd_address(str(path.parent)) == address
    assert capture.rgbd_address(address) == address
    pictures = write_pictures(tmp_path / "pictures")
    assert capture.rgbd_address(str(pictures)) == f"utd-mhad:{pictures}"
    write_trial(tmp_path / "one", "a3_s2_t1")
    assert capture.rgbd_address(str(path.parent)) is None  # which of both?
    assert capture.rgbd_address(str(tmp_path)) is None


@pytest.mark.parametrize("kind", ["mat", "apart", "pictures"])
def test_a_trial_has_depth_and_joints(kind: str, tmp_path: Path) -> None:
    """The images are turned round; 20 joints become 25; of all three layouts alike."""
    if kind == "pictures":
        place = write_pictures(tmp_path / "pictures")
    else:  # as distributed, joints lie in a folder of their own
        joints = tmp_path / "Skeleton" if kind == "apart" else None
        place = write_trial(tmp_path / "Depth", joints=joints)
    with capture.open(f"utd-mhad:{place}") as source:
        frames = list(source)
        assert source.num_frames == len(frames) == FRAMES
    for number, frame in enumerate(frames):
        assert (frame.depth[:, :-1] == 2000 - number).all()
        assert not frame.depth[:, -1].any()
        np.testing.assert_array_equal(frame.body_index == 0, frame.depth > 0)
        (person,) = frame.skeletons
        # The data set's hand, 7, is the Kinect V2's; x of its axes points to the left.
        np.testing.assert_allclose(person.positions[7], [-0.07, 0.0, 2.0], atol=1e-6)


@pytest.mark.parametrize("lead", ["\n", "sep=;\n"])
def test_the_heading_of_a_table_may_be_its_second_line(lead: str, tmp_path: Path) -> None:
    folder = write_pictures(tmp_path / "pictures")
    table = folder / "joints.csv"
    table.write_text(lead + table.read_text().replace(",", ";").replace(".", ","))
    with capture.open(f"utd-mhad:{folder}") as source:
        frames = list(source)
    assert [len(frame.skeletons) for frame in frames] == [1] * FRAMES
    np.testing.assert_allclose(frames[0].skeletons[0].positions[7], [-0.07, 0.0, 2.0], atol=1e-6)


def test_what_is_wrong_with_a_trial_is_told(tmp_path: Path) -> None:
    savemat = pytest.importorskip("scipy.io").savemat
    path = write_trial(tmp_path / "one")
    skeleton = path.with_name("a3_s1_t1_skeleton.mat")
    whole = skeleton.read_bytes()

    def refused(words: str) -> None:
        with pytest.raises(manip3d.FormatError, match=words):
            open_people(f"utd-mhad:{path}")

    skeleton.unlink()
    refused(r"a3_s1_t1_depth.mat: expected the joints of this trial in .*_skeleton\.mat")
    skeleton.write_bytes(b"no file of MATLAB, but long enough for its header" * 9)
    refused("a3_s1_t1_skeleton.mat: damaged, or no MATLAB 5 file")
    for joints in (np.zeros((20, 3)), np.zeros((25, 3, FRAMES)), {"x": 1.0}):
        savemat(skeleton, {"d_skel": joints})
        refused(r"expected d_skel of shape \(20, 3, 'frames'\)")
    savemat(skeleton, {"d_skel": np.zeros((20, 3, FRAMES), complex)})
    refused("expected d_skel of shape")  # complex numbers are no joints
    savemat(skeleton, {"d_skel": np.zeros((20, 3, FRAMES + 1))})
    refused(f"expected {FRAMES} skeletons, got {FRAMES + 1}")
    for far in (np.nan, 1e300):
        savemat(skeleton, {"d_skel": np.full((20, 3, FRAMES), far)})
        refused("joint 0 of frame 0: expected metres within 1000 of the camera")
    skeleton.write_bytes(whole)
    savemat(path, {"d_depth": np.full((240, 320, FRAMES), -1.0)})
    refused("expected depths of 0 to 65535 mm")
    savemat(path, {"d_depth": np.zeros((240, 320, 500), np.uint16)}, do_compression=True)
    refused("expected a compression by at most 200, got more")
    path.unlink()
    with pytest.raises(FileNotFoundError, match=r"a3_s1_t1_depth\.mat"):
        open_people(f"utd-mhad:{path}")


def test_damaged_files_are_refused_or_read(tmp_path: Path) -> None:
    """Bytes of either file are changed or cut off; there is no other error."""
    path = write_trial(tmp_path / "one")
    rng = np.random.default_rng(0)
    read = 0
    for victim in (path, path.with_name("a3_s1_t1_skeleton.mat")):
        whole = victim.read_bytes()
        for _ in range(60):
            content = bytearray(whole[: rng.integers(1, 2 * len(whole))])
            for at in rng.integers(0, min(300, len(content)), 3):
                content[at] = rng.integers(256)
            victim.write_bytes(content)
            try:
                open_people(f"utd-mhad:{path}")
                read += 1
            except manip3d.FormatError:
                pass
        victim.write_bytes(whole)
    assert read < 100


def test_what_is_wrong_with_a_table_is_told(tmp_path: Path) -> None:
    folder = write_pictures(tmp_path / "pictures")
    table = folder / "joints.csv"
    lines = table.read_text().splitlines()
    swapped = [*lines[:3], lines[4], lines[3], *lines[5:]]
    cut = lines[:-1]
    places = "expected joints 0 to 19 of frames 0 to 2, frame by frame, got joint "
    none = r"joints\.csv: expected the 20 joints of 3 frames, got those of none"
    for text, words in (
        ("\n".join(swapped), r"joints\.csv: line 5: " + places + "2 of frame 0 in its place"),
        ("\n".join([*lines, "", lines[-1]]), "line 63: " + places + "19 of frame 2 in its place"),
        ("\n".join([*cut, "3,0,joint,0,0,2"]), "line 61: " + places + "0 of frame 3 in its place"),
        ("\n".join([*cut, "2,20,joint,0,0,2"]), "line 61: " + places + "20 of frame 2 in its"),
        ("\n".join([*cut, "2,1e300,joint,0,0,2"]), "line 61: " + places + "1e.300 of frame 2"),
        ("\n".join([*cut, "2,nan,joint,0,0,2"]), "line 61: " + places + "nan of frame 2"),
        ("\n".join([*cut, "2,19,joint,here,0,2"]), r"joints\.csv: .*commas.*: could not convert"),
        ("\n".join([*cut, "2,19,joint,nan,0,2"]), r"joints\.csv: joint 19 of frame 2: .* got nan"),
        (f"{TABLE}\n0,0,joint,0,0,2", none),
        (TABLE, none),
        (f"{TABLE}\n\n \n", none),
        ("", none),
    ):
        table.write_text(text)
        with pytest.raises(manip3d.FormatError, match=words):
            open_people(f"utd-mhad:{folder}")
    table.write_text("\n".join(lines))
    Image.fromarray(np.ones((24, 32), np.uint16)).save(folder / "depth_0001.png")
    size = r"depth_0001\.png: expected 320 x 240 pixels, as UTD-MHAD has, got 32 x 24"
    with pytest.raises(manip3d.FormatError, match=size):
        open_people(f"utd-mhad:{folder}")
    (folder / "depth_0001.png").unlink()
    with pytest.raises(manip3d.FormatError, match=r"0002\.png: expected depth_0001\.png before"):
        open_people(f"utd-mhad:{folder}")


@pytest.mark.parametrize(
    ("missing", "frames"), [([25], [1]), ([60], [2]), ([*range(1, 21), 41], [0, 2])]
)
def test_a_frame_without_all_of_its_rows_has_no_skeleton(
    missing: list[int], frames: list[int], tmp_path: Path
) -> None:
    """Rows that a tracker did not write, or that were cut off, do not refuse a whole trial."""
    folder = write_pictures(tmp_path / "pictures")
    table = folder / "joints.csv"
    lines = table.read_text().splitlines()
    table.write_text("\n".join(line for at, line in enumerate(lines) if at not in missing))
    recording = open_people(f"utd-mhad:{folder}")
    assert [image.number for image in recording if not image.skeletons] == frames
    assert len(recording) == FRAMES
    done = run("phantom", "render", folder, "-o", tmp_path / "out")
    assert f"{FRAMES} frames, right arm; no frame shows a phantom limb" in done.output
    assert len(list((tmp_path / "out").iterdir())) == FRAMES


def test_commands_take_trials_and_folders_of_them(tmp_path: Path) -> None:
    path = write_trial(tmp_path / "some" / "Depth", joints=tmp_path / "some" / "Skeleton")
    told = run("capture", "info", path)
    assert told.exit_code == 0, told.output
    assert "3 with skeletons" in told.output
    write_trial(path.parent, "a3_s2_t1", tmp_path / "some" / "Skeleton")
    several = run("capture", "export", tmp_path / "some", "-o", tmp_path / "joints")
    assert several.exit_code == 0, several.output
    tables = sorted(str(p.relative_to(tmp_path)) for p in tmp_path.glob("joints/**/a3*"))
    assert tables == ["joints/Depth/a3_s1_t1.csv", "joints/Depth/a3_s2_t1.csv"]


def test_a_folder_without_a_recording_is_told_what_one_is(tmp_path: Path) -> None:
    (tmp_path / "frame1_depth.png").write_bytes(b"")
    render = "phantom", "render", tmp_path, "-o", tmp_path / "a.mp4"
    live = "phantom", "live", "--no-open", "--seconds", "1", "--source", tmp_path
    for command in (render, live):
        refused = str(run(*command).exception)
        for word in ("frames.jsonl", "depth/", "color/", "depth.txt", "UTD-MHAD"):
            assert word in refused
    missing = run(*live[:-1], tmp_path / "none").exception
    assert isinstance(missing, FileNotFoundError)


def test_the_data_set_s_own_files_show_a_phantom(realdata: RealData, tmp_path: Path) -> None:
    realdata.needs("people_utd_mhad")
    for kind in ("depth", "skeleton"):
        shutil.copy(realdata(f"rgbd/person_utd_mhad/mat/a3_s1_t1_{kind}.mat"), tmp_path)
    done = run("phantom", "render", tmp_path, "-o", tmp_path / "out", "--frames", 5)
    assert done.exit_code == 0, done.output
    assert "5 frames, right arm" in done.output
    assert "skeleton" not in done.output
    named, mine = (open_people(f"utd-mhad:{place}")[9] for place in ("a3_s1", tmp_path))
    np.testing.assert_array_equal(named.depth, mine.depth)
    np.testing.assert_array_equal(named.skeletons[0].positions, mine.skeletons[0].positions)

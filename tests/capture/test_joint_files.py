"""Recordings with the joints that other trackers wrote to files."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageOps

import capsule_body
from command_line import manip3d
from manip3d import (
    FormatError,
    InputError,
    Intrinsics,
    Registration,
    RgbdCalibration,
    RgbdFrame,
    Skeleton,
    capture,
)
from manip3d.capture._joined_joints import _Clocks
from manip3d.capture._joint_sides import other_sides
from manip3d.modify import joint_layouts, skeleton_from
from manip3d.rgbd import INFERRED, JOINTS, NOT_TRACKED, TRACKED

COUNT = 4
CAMERA = capsule_body.SMALL


def bodies() -> list[Skeleton]:
    return [capsule_body.pose(at=(0.05 * n - 0.1, 0.0, 2.4), identity=5) for n in range(COUNT)]


def recorded(path: Path, **changes: Any) -> list[RgbdFrame]:
    """A recording without skeletons, and its frames with them."""
    frames = [
        replace(capsule_body.frame(body, number=n), **changes) for n, body in enumerate(bodies())
    ]
    capture.record([replace(frame, skeletons=()) for frame in frames], path, lossless_color=True)
    return frames


def joined(recording: Path, file: Path, **options: Any) -> list[RgbdFrame]:
    with capture.open_rgbd(f"joints:{recording}#{file}", **options) as source:
        return list(source)


# --- formats --------------------------------------------------------------------------------------


def ntu(people: list[list[Skeleton]]) -> str:
    lines = [str(len(people))]
    for frame in people:
        lines.append(str(len(frame)))
        for one in frame:
            lines += [f"{one.id} 0 1 1 1 1 0 0.02764709 -0.05745083 2", "25"]
            for (x, y, z), state in zip(one.positions.tolist(), one.states, strict=True):
                place = f"{-x:.7g} {-y:.7g} {z:.7g}"  # x to the person's left, y up
                lines.append(f"{place} 277.6 191.8 1036.2 519.1 -0.21 0.04 0.97 -0.04 {state}")
    return "\n".join(lines) + "\n"


def seen_by(layout: str, body: Skeleton) -> dict[str, np.ndarray]:
    """The skin before each joint of a tracker that has joints of the same names."""
    names = joint_layouts()[layout]
    places = dict(zip(JOINTS, body.positions.astype(float), strict=True))
    for side in ("Left", "Right"):
        places[f"BigToe{side}"] = places[f"Foot{side}"]
        places[f"Ear{side}"] = places["Head"] + [0.07 if side == "Left" else -0.07, 0, 0]
    return {name: places[name] for name in names if name in places}


def rows_of(layout: str, body: Skeleton, camera: Intrinsics, confidence: float = 0.9) -> np.ndarray:
    """Column, row and confidence of each joint; 0 where the body of the test has none."""
    names, found = joint_layouts()[layout], seen_by(layout, body)
    rows = np.zeros((len(names), 3))
    for name, place in found.items():
        rows[names.index(name), :2] = camera.project(place[None])[0]
        rows[names.index(name), 2] = confidence
    return rows


def openpose(folder: Path, people: list[list[np.ndarray]], person: int = -1) -> Path:
    folder.mkdir()
    for number, frame in enumerate(people):
        told = [
            {"person_id": [person], "pose_keypoints_2d": rows.ravel().tolist()} for rows in frame
        ]
        name = f"walk_{number:012d}_keypoints.json"
        (folder / name).write_text(json.dumps({"version": 1.3, "people": told}))
    return folder


def azure(frames: list[RgbdFrame]) -> str:
    told = []
    for number, frame in enumerate(frames):
        places = np.zeros((32, 3))
        for name, place in seen_by("azure-kinect", frame.skeletons[0]).items():
            places[joint_layouts()["azure-kinect"].index(name)] = place
        body = {"body_id": 3, "joint_positions": (1000 * places).tolist(), "joint_orientations": []}
        told.append({
            "frame_id": number, "timestamp_usec": frame.time_ns // 1000, "num_bodies": 1,
            "bodies": [body],
        })  # fmt: skip
    return json.dumps({"joint_names": [], "bone_list": [], "frames": told})


# --- joints in metres -----------------------------------------------------------------------------


def test_ntu_s_joints_are_those_of_the_kinect(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "walk")
    people = [[frame.skeletons[0]] for frame in frames]
    states = people[1][0].states.copy()
    states[:3] = NOT_TRACKED, INFERRED, TRACKED
    people[1] = [replace(people[1][0], states=states)]
    people[2] = []
    file = tmp_path / "S001C001P001R001A001.skeleton"
    file.write_text("\ufeff" + ntu(people))
    found = joined(tmp_path / "walk", file)
    assert [len(frame.skeletons) for frame in found] == [1, 1, 0, 1]
    for one, frame, seen in zip(found, frames, people, strict=True):
        np.testing.assert_array_equal(one.depth, frame.depth)
        for skeleton, expected in zip(one.skeletons, seen, strict=True):
            known = expected.states != NOT_TRACKED
            assert skeleton.positions[known] == pytest.approx(expected.positions[known], abs=1e-5)
            assert skeleton.states.tolist() == expected.states.tolist()
            assert (skeleton.id, skeleton.body) == (5, 0)


def test_an_exported_table_is_read_back(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "c")
    other = replace(frames[0].skeletons[0], id=2**60 + 1)
    given = [replace(frames[0], skeletons=(*frames[0].skeletons, other)), frames[2]]
    capture.export_joints(given, tmp_path / "walk.csv")
    found = joined(tmp_path / "c", tmp_path / "walk.csv")
    assert [[one.id for one in frame.skeletons] for frame in found] == [[5, 2**60 + 1], [], [5], []]
    expected = frames[2].skeletons[0].positions
    assert found[2].skeletons[0].positions == pytest.approx(expected, abs=1e-6)


def test_azure_kinect_s_joints_come_by_their_times(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "walk")
    file = tmp_path / "walk.json"
    file.write_text(azure([frames[3], frames[1]]))
    found = joined(tmp_path / "walk", file)
    assert [len(frame.skeletons) for frame in found] == [0, 1, 0, 1]
    wrist = JOINTS.index("WristLeft")
    expected = frames[3].skeletons[0].positions[wrist]
    assert found[3].skeletons[0].positions[wrist] == pytest.approx(expected, abs=1e-5)
    assert found[3].skeletons[0].id == 3
    file.write_text(azure([replace(frame, time_ns=frame.time_ns + 10**9) for frame in frames]))
    with pytest.raises(FormatError, match=r"walk\.json: .*no frame has the time of any"):
        joined(tmp_path / "walk", file)


# --- joints in pixels -----------------------------------------------------------------------------


def off(skeleton: Skeleton, body: Skeleton, names: list[str]) -> float:
    """The largest distance of a joint from the truth."""
    at = [JOINTS.index(name) for name in names]
    assert (skeleton.states[at] == TRACKED).all(), skeleton.states[at]
    return float(np.linalg.norm(skeleton.positions[at] - body.positions[at], axis=1).max())


ARMS = [f"{part}{side}" for part in ("Shoulder", "Elbow", "Wrist") for side in ("Left", "Right")]
FEET = ["FootLeft", "FootRight"]


def test_openpose_s_pixels_are_lifted_by_the_depth_image(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "walk")
    people = [[rows_of("openpose", frame.skeletons[0], CAMERA)] for frame in frames]
    people[0][0][joint_layouts()["openpose"].index("WristLeft"), 2] = 0.2  # hardly found
    folder = openpose(tmp_path / "joints", people)
    found = joined(tmp_path / "walk", folder)
    for one, frame in zip(found[1:], frames[1:], strict=True):
        # The radii of capsules differ from those of an adult that are added to the skin.
        assert off(one.skeletons[0], frame.skeletons[0], ARMS + FEET) < 0.06
        assert one.skeletons[0].states[JOINTS.index("HandLeft")] == NOT_TRACKED
        assert (one.skeletons[0].id, one.skeletons[0].body) == (0, 0)
    assert found[0].skeletons[0].states[JOINTS.index("WristLeft")] == INFERRED
    tracked = openpose(tmp_path / "tracked", people, person=7)
    assert {frame.skeletons[0].id for frame in joined(tmp_path / "walk", tracked)} == {7}


def test_the_files_of_openpose_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "walk")
    people = [[rows_of("openpose", frame.skeletons[0], CAMERA)] for frame in frames]
    folder = openpose(tmp_path / "joints", people)
    for number, file in enumerate(sorted(folder.iterdir())):
        file.rename(folder / f"walk_{8 + number}_keypoints.json")
    (folder / "._walk_8_keypoints.json").write_bytes(b"\0\5\x16\7")  # macOS writes it
    found = joined(tmp_path / "walk", folder)
    heads = [float(frame.skeletons[0].positions[3, 0]) for frame in found]
    assert heads == sorted(heads)


def test_pixels_are_those_of_the_colour_image(tmp_path: Path) -> None:
    """A colour camera of its own, of twice the resolution and beside the depth camera."""
    side = Intrinsics(2 * CAMERA.width, 2 * CAMERA.height, 2 * CAMERA.fx, 2 * CAMERA.fy,
                      2 * CAMERA.cx + 0.5, 2 * CAMERA.cy + 0.5)  # fmt: skip
    moved = np.array([0.05, 0.0, 0.0], np.float32)
    rig = RgbdCalibration(CAMERA, Registration(side, np.eye(3, dtype=np.float32), moved))
    color = np.zeros((side.height, side.width, 3), np.uint8)
    frames = recorded(tmp_path / "walk", color=color, calibration=rig)
    people = []
    for frame in frames:
        body = frame.skeletons[0]
        people.append([rows_of("openpose", replace(body, positions=body.positions + moved), side)])
    found = joined(tmp_path / "walk", openpose(tmp_path / "joints", people))
    for one, frame in zip(found, frames, strict=True):
        assert off(one.skeletons[0], frame.skeletons[0], ARMS + FEET) < 0.06


@pytest.mark.parametrize(("layout", "ends"), [("coco", []), ("coco-wholebody", FEET)])
def test_results_of_coco(tmp_path: Path, layout: str, ends: list[str]) -> None:
    frames = recorded(tmp_path / "walk")
    results = []
    for number in (2, 0):
        rows = rows_of(layout, frames[number].skeletons[0], CAMERA)
        flat = {"keypoints": rows.ravel().tolist()}
        if layout != "coco" and number == 2:  # as COCO-WholeBody's own tools write them
            flat = {"keypoints": rows[:17].ravel().tolist(),
                    "foot_kpts": rows[17:23].ravel().tolist()}  # fmt: skip
        image = number if number else "0.jpg"
        results.append({"image_id": image, "category_id": 1, "score": 0.9, **flat})
    file = tmp_path / "results.json"
    file.write_text(json.dumps(results))
    found = joined(tmp_path / "walk", file)
    assert [len(frame.skeletons) for frame in found] == [1, 0, 1, 0]
    for number in (0, 2):
        (skeleton,) = found[number].skeletons
        assert off(skeleton, frames[number].skeletons[0], ARMS + ends) < 0.06
        assert skeleton.states[JOINTS.index("HandLeft")] == NOT_TRACKED


def test_nobody_without_depth(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "walk", depth=np.zeros((CAMERA.height, CAMERA.width), np.uint16))
    people = [[rows_of("openpose", frame.skeletons[0], CAMERA)] for frame in frames]
    found = joined(tmp_path / "walk", openpose(tmp_path / "joints", people))
    assert not any(frame.skeletons for frame in found)


def test_a_pixel_beside_the_arm_gives_no_joint_on_the_wall(tmp_path: Path) -> None:
    (body,) = bodies()[:1]
    seen = capsule_body.frame(body)
    wall = np.where(seen.depth > 0, seen.depth, np.uint16(4500))
    capture.record([replace(seen, depth=wall, body_index=None, skeletons=())], tmp_path / "walk")
    names = joint_layouts()["openpose"]
    rows = rows_of("openpose", body, CAMERA)
    rows[names.index("WristLeft"), 0] += 20
    (found,) = joined(tmp_path / "walk", openpose(tmp_path / "joints", [[rows]]))
    (skeleton,) = found.skeletons
    assert skeleton.states[JOINTS.index("WristLeft")] == NOT_TRACKED
    assert skeleton.states[JOINTS.index("WristRight")] == TRACKED
    assert skeleton.states[JOINTS.index("ElbowLeft")] == TRACKED


# --- mirrored images ------------------------------------------------------------------------------


BLACK = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
TWO_CAMERAS = RgbdCalibration(
    CAMERA, Registration(CAMERA, np.eye(3, dtype=np.float32), np.zeros(3, np.float32))
)


def mirrored(path: Path, **changes: Any) -> list[RgbdFrame]:
    """A recording whose images another program stored mirrored, and its frames as they are read.

    Images of a colour camera of its own are not mirrored.
    """
    frames = recorded(path, **{"color": None} | changes)
    is_own = frames[0].calibration.registration is not None
    for image in path.rglob("*.png"):
        if is_own and image.parent.name == "colour":
            continue
        with Image.open(image) as stored:
            ImageOps.mirror(stored).save(image)
    description = json.loads((path / "calibration.json").read_text())
    camera = description["calibration"]["depth"]
    camera.update(mirrored=True, cx=CAMERA.width - 1 - camera["cx"])
    (path / "calibration.json").write_text(json.dumps(description))
    lines = (path / "frames.jsonl").read_text().splitlines()
    stored = [json.loads(line) for line in lines]
    for line in stored:
        for name in {"depth", "body_index", "colour"} & set(line):
            line[name]["crc32"] = zlib.crc32((path / name / line[name]["file"]).read_bytes())
    (path / "frames.jsonl").write_text("".join(json.dumps(line) + "\n" for line in stored))
    return frames


def seen_in(picture: str, frames: list[RgbdFrame], file: Path, names: str = "") -> Path:
    """COCO joints of people who face the camera, of a tracker that saw this kind of picture.

    ``names``: ``true`` if it knew that the picture is mirrored; ``no nose`` if no face was found.
    """
    layout = joint_layouts()["coco"]
    order = list(other_sides("coco"))
    results = []
    for frame in frames:
        rows = rows_of("coco", frame.skeletons[0], CAMERA)
        shoulders = [layout.index("ShoulderLeft"), layout.index("ShoulderRight")]
        rows[layout.index("Nose")] = rows[shoulders].mean(axis=0) - (0.0, 12.0, 0.0)
        if names == "no nose":
            rows[layout.index("Nose"), 2] = 0.0
        if picture == "mirrored":
            rows[:, 0] = CAMERA.width - 1 - rows[:, 0]
        if picture == "mirrored" and names != "true":
            rows = rows[order]
        results.append({"image_id": frame.number, "keypoints": rows.ravel().tolist()})
    file.write_text(json.dumps(results))
    return file


def assert_arms(found: list[RgbdFrame], frames: list[RgbdFrame]) -> None:
    for one, frame in zip(found, frames, strict=True):
        np.testing.assert_array_equal(one.depth, frame.depth)
        assert off(one.skeletons[0], frame.skeletons[0], ARMS) < 0.06


@pytest.mark.parametrize("names", ["", "true"])
@pytest.mark.parametrize("has_color", [False, True])
def test_pixels_of_mirrored_images_are_flipped_with_them(
    tmp_path: Path, has_color: bool, names: str
) -> None:
    frames = mirrored(tmp_path / "walk", color=BLACK if has_color else None)
    file = seen_in("mirrored", frames, tmp_path / "coco.json", names)
    assert_arms(joined(tmp_path / "walk", file), frames)


@pytest.mark.parametrize("names", ["", "no nose"])
def test_sides_are_those_of_the_image_that_the_tracker_saw(tmp_path: Path, names: str) -> None:
    """The depth image is mirrored, and that of the colour camera is not."""
    frames = mirrored(tmp_path / "walk", color=BLACK, calibration=TWO_CAMERAS)
    file = seen_in("plain", frames, tmp_path / "coco.json", names)
    assert_arms(joined(tmp_path / "walk", file), frames)


def test_a_colour_camera_may_start_later(tmp_path: Path) -> None:
    """The first frame is without the colour image, in which the tracker saw mirrored people."""
    given = recorded(tmp_path / "plain", color=BLACK, calibration=TWO_CAMERAS)
    frames = [replace(given[0], color=None), *given[1:]]
    capture.record([replace(one, skeletons=()) for one in frames], tmp_path / "walk")
    description = json.loads((tmp_path / "walk" / "calibration.json").read_text())
    description["calibration"]["registration"]["colour"]["mirrored"] = True
    (tmp_path / "walk" / "calibration.json").write_text(json.dumps(description))
    file = seen_in("mirrored", frames[1:], tmp_path / "coco.json")
    assert_arms(joined(tmp_path / "walk", file)[1:], frames[1:])


def test_sides_that_no_face_tells_are_asked_for(tmp_path: Path) -> None:
    frames = mirrored(tmp_path / "walk")
    file = seen_in("mirrored", frames, tmp_path / "coco.json", "no nose")
    with pytest.raises(FormatError, match=r"coco\.json: .*face the camera.*sides=exchanged"):
        joined(tmp_path / "walk", file)
    assert_arms(joined(tmp_path / "walk", Path(f"{file}?sides=exchanged")), frames)
    found = joined(tmp_path / "walk", Path(f"{file}?sides=named"))[0].skeletons[0]
    left, right = (JOINTS.index(f"Wrist{side}") for side in ("Left", "Right"))
    truth = frames[0].skeletons[0].positions
    assert np.linalg.norm(found.positions[left] - truth[right]) < 0.06


def test_turned_people_do_not_tell_the_sides(tmp_path: Path) -> None:
    """Half of the frames are of people whose back is taken for a face."""
    frames = mirrored(tmp_path / "walk")
    file = seen_in("mirrored", frames, tmp_path / "coco.json")
    results = json.loads(file.read_text())
    for one in results[::2]:
        rows = np.reshape(one["keypoints"], (17, 3))[list(other_sides("coco"))]
        one["keypoints"] = rows.ravel().tolist()
    file.write_text(json.dumps(results))
    with pytest.raises(FormatError, match="face the camera"):
        joined(tmp_path / "walk", file)


def test_joints_in_metres_need_no_face_and_take_no_options(tmp_path: Path) -> None:
    frames = mirrored(tmp_path / "walk")
    capture.export_joints(frames, tmp_path / "walk.csv")
    assert_arms(joined(tmp_path / "walk", tmp_path / "walk.csv"), frames)
    with pytest.raises(InputError, match="only of joints in pixels"):
        joined(tmp_path / "walk", Path(f"{tmp_path / 'walk.csv'}?mirrored=yes"))


def test_joints_of_mirrored_images_fit_a_recording_of_them(tmp_path: Path) -> None:
    """A recording has the images flipped, and joints of a tracker that saw them before."""
    frames = mirrored(tmp_path / "walk")
    file = seen_in("mirrored", frames, tmp_path / "coco.json")
    done = manip3d("capture", "record", tmp_path / "walk", "-o", tmp_path / "again", "--json")
    assert done.returncode == 0, done.stderr
    assert "the images are flipped (mirrored camera), also in the recording: add ?mirrored=yes" in (
        done.stderr
    )
    assert json.loads(done.stdout)["flipped"] == ["depth", "color"]
    assert_arms(joined(tmp_path / "again", Path(f"{file}?mirrored=yes")), frames)
    told = manip3d("capture", "info", tmp_path / "walk")
    assert "images  flipped (mirrored camera)" in told.stdout
    assert "flipped" not in manip3d("capture", "info", tmp_path / "again").stdout


def test_sides_of_an_image_that_only_seems_not_mirrored_are_warned_of(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "walk")
    file = seen_in("mirrored", frames, tmp_path / "coco.json", "true")
    with pytest.warns(UserWarning, match=r"coco\.json: left and right seem to be exchanged"):
        joined(tmp_path / "walk", file)
    assert_arms(joined(tmp_path / "walk", Path(f"{file}?mirrored=yes")), frames)
    assert_arms(joined(tmp_path / "walk", seen_in("plain", frames, tmp_path / "p.json")), frames)


@pytest.mark.parametrize(
    "options", ["mirrored=1", "sides=", "sides=named&sides=named", "sides=named&speed=1"]
)
def test_options_of_pixels_have_their_words(tmp_path: Path, options: str) -> None:
    frames = recorded(tmp_path / "walk")
    file = seen_in("plain", frames, tmp_path / "coco.json")
    with pytest.raises(InputError, match="uri: expected mirrored=yes or no and sides="):
        joined(tmp_path / "walk", Path(f"{file}?{options}"))


# --- times ----------------------------------------------------------------------------------------


def test_times_of_a_table_that_contradict_the_frames_are_warned_of(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "walk")
    step = frames[1].time_ns - frames[0].time_ns

    def table(rate: float, after_ns: int = 0) -> Path:
        """The joints by another clock, with this many times the frames of the recording."""
        at = [replace(f, time_ns=int(f.time_ns / rate) + after_ns) for f in frames]
        return capture.export_joints(at, tmp_path / "walk.csv", overwrite=True).path

    assert len(joined(tmp_path / "walk", table(1.0))) == COUNT
    assert len(joined(tmp_path / "walk", table(1.0, 10**18))) == COUNT  # another clock
    assert len(joined(tmp_path / "walk", table(1.1))) == COUNT  # a third of a frame at the end
    with pytest.warns(UserWarning, match=r"walk\.csv: frame 2 is 0\.\d+ s .* but 0\.") as told:
        joined(tmp_path / "walk", table(1.8))
    assert len(told) == 1
    assert f"but {2 * step * 1e-9:.3f} s by the recording, whose times are used" in str(
        told[0].message
    )


def test_a_clock_that_began_again_contradicts_no_table() -> None:
    first = capsule_body.frame(capsule_body.pose())
    step = 33_333_333
    times = (10 * step, 11 * step, 0, step)
    frames = [replace(first, number=n, time_ns=time) for n, time in enumerate(times)]
    same = _Clocks(dict(enumerate(times)))
    assert [same.contradiction(frame) for frame in frames] == [None] * 4
    other = _Clocks(dict(enumerate((*times[:3], 2 * step))))
    assert [other.contradiction(frame) is None for frame in frames] == [True] * 3 + [False]


def test_times_that_are_all_equal_contradict_nothing() -> None:
    first = capsule_body.frame(capsule_body.pose())
    frames = [replace(first, number=n, time_ns=33_333_333 * n) for n in range(4)]
    clocks = _Clocks(dict.fromkeys(range(4), 0))
    assert [clocks.contradiction(frame) for frame in frames] == [None] * 4


def test_a_rate_makes_a_folder_agree_with_a_table(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "walk")
    (tmp_path / "walk" / "frames.jsonl").unlink()
    at = [replace(frame, time_ns=round(n * 1e9 / 15)) for n, frame in enumerate(frames)]
    file = capture.export_joints(at, tmp_path / "walk.csv").path
    with pytest.warns(UserWarning, match=r"for which 30 frames a second are assumed \(--rate"):
        joined(tmp_path / "walk", file)
    found = joined(tmp_path / "walk", file, rate=15.0)
    assert [frame.time_ns for frame in found] == pytest.approx([f.time_ns for f in at], abs=1)


# --- sources --------------------------------------------------------------------------------------


def test_joined_recordings_are_sources_like_others(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "walk.mkv")
    file = tmp_path / "a.skeleton"
    file.write_text(ntu([[frame.skeletons[0]] for frame in frames]))
    address = f"joints:{tmp_path / 'walk.mkv'}#{file}"
    with capture.open_rgbd(address) as source:
        assert len(source) == COUNT
        assert source[2].skeletons[0].positions == pytest.approx(
            frames[2].skeletons[0].positions, abs=1e-5
        )
        assert len(list(source)) == COUNT
        assert len(list(source)) == COUNT  # it begins anew
        source.seek(3)
        (last,) = list(source)
        assert last.number == 3
    assert len(joined(tmp_path / "walk.mkv", file, start=2)) == 2
    done = capture.record(address, tmp_path / "with")
    with capture.open_rgbd(f"folder:{done.path}") as source:
        assert [len(frame.skeletons) for frame in source] == [1] * COUNT


def test_a_recording_that_cannot_be_sought_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = capture.export_joints(recorded(tmp_path / "walk"), tmp_path / "walk.csv").path

    closed = []

    def cannot_seek(self: capture.RgbdSource, index: int) -> None:
        raise OSError(5, "Input/output error")

    with capture.open_rgbd(f"joints:{tmp_path / 'walk'}#{file}") as source:
        source.seek(2)
        monkeypatch.setattr(capture.RgbdSource, "seek", cannot_seek)
        monkeypatch.setattr(capture.RgbdSource, "_close", lambda self: closed.append(self.uri))
        with pytest.raises(OSError, match="Input/output error"):
            next(iter(source))
        assert closed == [f"folder:{tmp_path / 'walk'}"]


def test_commands_take_joined_recordings(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "walk")
    capture.export_joints(frames, tmp_path / "walk.csv")
    address = f"joints:{tmp_path / 'walk'}#{tmp_path / 'walk.csv'}"
    done = manip3d("capture", "export", address, "-o", tmp_path / "again.csv")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "again.csv").read_text() == (tmp_path / "walk.csv").read_text()
    assert manip3d("capture", "info", address).returncode == 0
    assert "joints" in manip3d("capture", "list").stdout


def test_commands_take_the_camera_of_a_folder_that_is_joined(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "walk")
    capture.export_joints(frames, tmp_path / "walk.csv")
    (tmp_path / "walk" / "frames.jsonl").unlink()
    (tmp_path / "walk" / "calibration.json").unlink()
    address = f"joints:{tmp_path / 'walk'}#{tmp_path / 'walk.csv'}"
    camera = f"{CAMERA.fx},{CAMERA.fy},{CAMERA.cx},{CAMERA.cy}"
    options = ("--intrinsics", camera, "--rate", f"{1e9 / (frames[1].time_ns - frames[0].time_ns)}")
    done = manip3d("capture", "export", address, "-o", tmp_path / "again.csv", *options)
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stderr
    assert (tmp_path / "again.csv").read_text() == (tmp_path / "walk.csv").read_text()
    drawn = manip3d("phantom", "render", address, "-o", tmp_path / "a.png", *options)
    assert "expected a bag or a folder" not in drawn.stderr
    assert "opened joints:" in drawn.stderr


def test_numbers_of_frames_must_agree(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "walk")
    file = tmp_path / "a.skeleton"
    file.write_text(ntu([[frame.skeletons[0]] for frame in frames[1:]]))
    with pytest.raises(FormatError, match="joints of the recording's 4 frames, got those of 3"):
        joined(tmp_path / "walk", file)
    file.write_text(ntu([[frame.skeletons[0]] for frame in frames]))
    image = next((tmp_path / "walk" / "depth").iterdir())
    lines = (tmp_path / "walk" / "frames.jsonl").read_text().splitlines(keepends=True)
    (tmp_path / "walk" / "frames.jsonl").write_text("".join([*lines[:2], lines[1], lines[3]]))
    assert image.exists()
    with pytest.raises(FormatError, match="joints are assigned by their order"):
        joined(tmp_path / "walk", file)


@pytest.mark.parametrize("kind", ["number", "index"])
def test_reading_continues_after_a_frame_that_cannot_be_read(tmp_path: Path, kind: str) -> None:
    frames = recorded(tmp_path / "walk")
    if kind == "index":
        file = tmp_path / "a.skeleton"
        file.write_text(ntu([[frame.skeletons[0]] for frame in frames]))
    else:
        file = tmp_path / "a.csv"
        capture.export_joints(frames, file)
    image = sorted((tmp_path / "walk" / "depth").iterdir())[1]
    image.write_bytes(image.read_bytes()[:100])
    uri = f"joints:{tmp_path / 'walk'}#{file}"
    with capture.open_rgbd(uri) as source:
        found = list(source.past_errors())
        assert [one and one.number for one in found] == [0, None, 2, 3]
        assert list(source.errors) == [1]
        assert source.read() is None
    for one, frame in zip(found, frames, strict=True):
        if one is not None:
            assert one.skeletons[0].positions == pytest.approx(
                frame.skeletons[0].positions, abs=1e-5
            )
    source = capture.open_rgbd(uri)
    for _ in range(2):  # a source that has ended begins again
        assert [one.number for one in source._readable()] == [0, 2, 3]
    summary = capture.summarize(source)
    assert (summary.num_frames, summary.num_skeletons) == (3, 3)
    assert summary.counters["damaged"] == 1
    assert capture.record(uri, tmp_path / "copy").frames == 3
    assert capture.export_joints(uri, tmp_path / "copy.csv").frames == 3


def test_joints_of_other_frames_are_an_error_beside_frames_that_cannot_be_read(
    tmp_path: Path,
) -> None:
    frames = recorded(tmp_path / "walk")
    file = tmp_path / "a.csv"
    capture.export_joints([replace(frame, number=frame.number + 50) for frame in frames], file)
    images = sorted((tmp_path / "walk" / "depth").iterdir())
    images[1].write_bytes(images[1].read_bytes()[:100])
    uri = f"joints:{tmp_path / 'walk'}#{file}"
    with pytest.raises(FormatError, match="no frame has the number of any"):
        capture.summarize(capture.open_rgbd(uri))
    for image in images:
        image.write_bytes(b"")
    with pytest.raises(FormatError, match=r"0\.png"):
        capture.summarize(capture.open_rgbd(uri))


def test_joints_by_order_are_refused_after_frames_that_matroska_lost(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    depth = [rng.integers(500, 4000, (48, 64)).astype(np.uint16) for _ in range(10)]
    camera = RgbdCalibration(Intrinsics(64, 48, fx=60, fy=60, cx=31.5, cy=23.5))
    frames = [
        RgbdFrame(image, camera, time_ns=n * 33_000_000, number=n) for n, image in enumerate(depth)
    ]
    capture.record(frames, tmp_path / "walk.mkv")
    data = bytearray((tmp_path / "walk.mkv").read_bytes())
    middle = len(data) // 2
    data[middle : middle + 3000] = bytes(3000)
    (tmp_path / "walk.mkv").write_bytes(data)
    file = tmp_path / "a.skeleton"
    file.write_text(ntu([[bodies()[0]]] * 10))
    with capture.open_rgbd(f"joints:mkv:{tmp_path / 'walk.mkv'}#{file}") as source:
        read = iter(source)
        assert next(read).number == 0
        with pytest.raises(FormatError, match="joints are assigned by their order"):
            list(read)


def test_addresses_without_a_part_or_of_cameras(tmp_path: Path) -> None:
    for uri in ("joints:", "joints:walk", "joints:#a.csv", "joints:walk#"):
        with pytest.raises(InputError, match="uri: expected joints:SOURCE#FILE"):
            capture.open_rgbd(uri)
    recorded(tmp_path / "walk")
    with pytest.raises(FileNotFoundError):
        joined(tmp_path / "walk", tmp_path / "none.csv")


# --- people ---------------------------------------------------------------------------------------


def two_in_a_frame(kind: str, frames: list[RgbdFrame], place: Path) -> Path:
    """A file in which each person occurs twice, with the same id 7 or 5 or 3."""
    bodies = [frame.skeletons[0] for frame in frames]
    if kind == "openpose":
        rows = [rows_of("openpose", body, CAMERA) for body in bodies]
        return openpose(place, [[one, one] for one in rows], person=7)
    if kind == "ntu":
        file = place.with_suffix(".skeleton")
        file.write_text(ntu([[body, body] for body in bodies]))
        return file
    file = place.with_suffix(".json")
    if kind == "azure":
        content = json.loads(azure(frames))
        for frame in content["frames"]:
            frame["bodies"] *= 2
    else:
        rows = [rows_of("coco", body, CAMERA) for body in bodies]
        content = [
            {"image_id": number, "idx": 3, "keypoints": one.ravel().tolist()}
            for number, one in enumerate(rows)
        ] * 2
    file.write_text(json.dumps(content))
    return file


@pytest.mark.parametrize(("kind", "id"), [("openpose", 7), ("ntu", 5), ("azure", 3), ("coco", 3)])
def test_people_of_a_frame_have_ids_of_their_own(tmp_path: Path, kind: str, id: int) -> None:
    frames = recorded(tmp_path / "walk")
    file = two_in_a_frame(kind, frames, tmp_path / "joints")
    found = joined(tmp_path / "walk", file)
    assert [[one.id for one in frame.skeletons] for frame in found] == [[id, 0]] * COUNT
    capture.export_joints(found, tmp_path / "again.csv")
    again = joined(tmp_path / "walk", tmp_path / "again.csv")
    assert [len(frame.skeletons) for frame in again] == [2] * COUNT


def test_an_id_is_not_taken_from_the_person_who_has_it(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "walk")
    rows = rows_of("coco", frames[0].skeletons[0], CAMERA).ravel().tolist()
    given = [{"idx": 4}, {"idx": 4}, {}, {"idx": 0}, {"idx": 1}]
    results = [{"image_id": 0, "keypoints": rows, **one} for one in given]
    (tmp_path / "r.json").write_text(json.dumps(results))
    found = joined(tmp_path / "walk", tmp_path / "r.json")
    assert [one.id for one in found[0].skeletons] == [4, 2, 3, 0, 1]


# --- units ----------------------------------------------------------------------------------------


def test_azure_kinect_s_joints_are_in_millimetres(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "walk")
    content = json.loads(azure(frames))
    for frame in content["frames"]:
        (body,) = frame["bodies"]
        body["joint_positions"] = (np.array(body["joint_positions"]) / 1000).tolist()
    (tmp_path / "m.json").write_text(json.dumps(content))
    with pytest.raises(FormatError, match=r"m\.json: .*expected millimetres.*depth of 2\."):
        joined(tmp_path / "walk", tmp_path / "m.json")


def test_pixels_are_not_shares_of_the_image(tmp_path: Path) -> None:
    frames = recorded(tmp_path / "walk")
    size = (CAMERA.width, CAMERA.height, 1.0)
    people = [[rows_of("openpose", frame.skeletons[0], CAMERA) / size] for frame in frames]
    folder = openpose(tmp_path / "joints", people)
    with pytest.raises(FormatError, match=r"joints: expected joints in pixels .* none beyond 1"):
        joined(tmp_path / "walk", folder)
    shares = rows_of("coco", frames[0].skeletons[0], CAMERA) / size
    results = [{"image_id": 0, "keypoints": shares.ravel().tolist()}]
    (tmp_path / "r.json").write_text(json.dumps(results))
    with pytest.raises(FormatError, match=r"r\.json: expected joints in pixels"):
        joined(tmp_path / "walk", tmp_path / "r.json")


def test_a_file_without_any_joint_that_was_found_has_nobody(tmp_path: Path) -> None:
    recorded(tmp_path / "walk")
    folder = openpose(tmp_path / "joints", [[np.zeros((25, 3))]] * COUNT)
    assert not any(frame.skeletons for frame in joined(tmp_path / "walk", folder))


# --- damage ---------------------------------------------------------------------------------------

HEADER = "frame,time_ns,id,joint,name,x,y,z,state\n"
NTU = ntu([[capsule_body.pose()]])


def changed(old: str, new: str) -> str:
    assert old in NTU
    return NTU.replace(old, new, 1)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.skeleton", "", "line 1: expected the number of frames, found the end"),
        ("a.skeleton", "7\n1\n", "expected the number of frames, 1 to 2, got '7'"),
        ("a.skeleton", NTU + "0\n", "expected 1 frames, found more"),
        ("a.skeleton", changed("\n25\n", "\n20\n"), "line 4: expected the number of joints, 25"),
        ("a.skeleton", changed("0.97 -0.04 2", "0.97 -0.04 3"), "line 5: .*state of a joint"),
        ("a.skeleton", changed("277.6 ", ""), "line 5: expected twelve numbers of a joint, got 11"),
        ("a.skeleton", "\n".join(NTU.splitlines()[:-1]), "found the end of the file"),
        ("a.skeleton", changed("2.44 ", "2440 "), "expected metres of a joint, got '2440'"),
        ("a.csv", "frame,id\n", "expected columns joint, x, y, z, state, each once"),
        ("a.csv", HEADER + "0,0,0,25,x,0,0,0,2\n", "line 2: expected a joint 0 to 24"),
        ("a.csv", HEADER + "0.5,0,0,2,x,0,0,0,2\n", "line 2: expected whole numbers"),
        (
            "a.csv",
            HEADER + "0,0,0,2,x,0,nan,0,2\n",
            "line 2: expected a number as y, got 'nan': write state 0 for a joint that was not",
        ),
        ("a.csv", HEADER + "0,0,0,2,x,,0,0,1\n", "line 2: expected a number as x, got ''"),
        ("a.csv", HEADER + "0,0,0,2,x,0,0,inf,2\n", "line 2: expected x, y, z within 1000 m"),
        ("a.csv", HEADER + "0,0,0,2,x,0,0,0,2\n" * 2, "line 3: expected joint 2 of frame 0 once"),
        (
            "a.csv",
            HEADER + "0,1.7E+18,0,2,x,0,0,0,2\n",
            "line 2: expected whole nanoseconds as time_ns, got '1.7E.18'",
        ),
        (
            "a.csv",
            HEADER + "0,5,0,2,x,0,0,0,2\n0,6,0,3,x,0,0,0,2\n",
            "line 3: expected the time_ns 5 of frame 0, got 6",
        ),
        ("a.json", "{", "expected JSON"),
        ("a.json", "[" * 100_000, "expected JSON"),
        ("a.json", "{}", "the file: expected frames, a list"),
        ("a.json", "[]", "expected results of at least one person"),
        ("a.json", '{"people": []}', "expected the folder of OpenPose's files"),
        (
            "a.json",
            '[{"image_id": "a1.jpg", "keypoints": []}]',
            r"\[0\].image_id: expected the num",
        ),
        ("a.json", '[{"image_id": 1, "keypoints": [1]}]', r"\[0\].keypoints: expected x, y and"),
        ("a.json", '[{"keypoints": 1}]', r"\[0\]: expected keypoints, a list"),
        (
            "a.json",
            '{"frames": [{"timestamp_usec": 1e9}]}',
            r"frames\[0\]: expected timestamp_usec",
        ),
        ("a.txt", "", "expected joints: .skeleton"),
    ],
)
def test_damage_is_named(tmp_path: Path, name: str, text: str, message: str) -> None:
    recorded(tmp_path / "walk")
    (tmp_path / name).write_text(text)
    with pytest.raises(FormatError, match=message) as error:
        joined(tmp_path / "walk", tmp_path / name)
    assert str(tmp_path / name) in str(error.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda one: one.update(pose_keypoints_2d=[0.0] * 54),
            "BODY_25, got those of its model COCO",
        ),
        (lambda one: one.update(pose_keypoints_2d=[0.0] * 76), "expected 25 times 3 numbers"),
        (lambda one: one.update(pose_keypoints_2d=["a"] * 75), "expected 25 times 3 numbers"),
        (lambda one: one.update(pose_keypoints_2d=[float("nan")] * 75), "25 times 3 numbers"),
        (lambda one: one.clear(), r"people\[0\]: expected pose_keypoints_2d, a list"),
    ],
)
def test_damage_of_openpose_s_files(
    tmp_path: Path, change: Callable[[dict[str, Any]], object], message: str
) -> None:
    frames = recorded(tmp_path / "walk")
    rows = [[rows_of("openpose", frame.skeletons[0], CAMERA)] for frame in frames]
    folder = openpose(tmp_path / "joints", rows)
    file = sorted(folder.iterdir())[1]
    content = json.loads(file.read_text())
    change(content["people"][0])
    file.write_text(json.dumps(content))
    with pytest.raises(FormatError, match=message) as error:
        joined(tmp_path / "walk", folder)
    assert str(file) in str(error.value)
    for each in folder.iterdir():
        each.unlink()
    with pytest.raises(FormatError, match=r"expected OpenPose's files, 1 to .*got 0"):
        joined(tmp_path / "walk", folder)


def test_the_layout_of_openpose_is_that_of_its_documentation() -> None:
    """Sides, by a person whose left is at +x."""
    body = capsule_body.pose()
    names = joint_layouts()["openpose"]
    assert (names[2], names[5], names[9], names[12]) == (
        "ShoulderRight", "ShoulderLeft", "HipRight", "HipLeft",
    )  # fmt: skip
    assert (names[19], names[22]) == ("BigToeLeft", "BigToeRight")
    places = np.full((25, 3), np.nan)
    for name, place in seen_by("openpose", body).items():
        places[names.index(name)] = place
    made = skeleton_from(places, layout="openpose")
    for part in ("Shoulder", "Hip", "Foot"):
        assert made.positions[JOINTS.index(f"{part}Left"), 0] > 0

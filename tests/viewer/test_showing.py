"""Everything that can be looked at shows itself: in a page, in a notebook, and on the disk."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from page_content import content

from manip3d import (
    Box,
    InputError,
    Intrinsics,
    LidarFrame,
    Mesh,
    RgbdCalibration,
    RgbdFrame,
    authenticate,
    capture,
    forge,
    simplify,
)
from manip3d.lidar import ScanFormat
from manip3d.viewer import (
    Classes,
    DepthImage,
    DrawnPoints,
    evidence,
    kind_of,
    notebook,
    open_thing,
    opening,
    shown,
)
from manip3d.viewer.points import ALARM, CLEAR, DOUBT, QUIET

CAMERA = Intrinsics(32, 24, 30.0, 30.0, 15.5, 11.5)


def street() -> LidarFrame:
    """A few rings around a scanner."""
    turn = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    rings = [np.column_stack([r * np.cos(turn), r * np.sin(turn), np.full(400, -1.7)])
             for r in (4.0, 6.0, 9.0)]  # fmt: skip
    points = np.concatenate(rings).astype(np.float32)
    return LidarFrame(points, np.linspace(0, 1, 1200).astype(np.float32), origin=(0.0, 0.0, 0.0))


def forged() -> forge.Forgery:
    return forge.ctp(street(), np.eye(3, dtype=np.float32), position=(5.0, 0.0, 0.0))


def truth(cloud: object) -> dict[str, int]:
    assert isinstance(cloud, DrawnPoints)
    first = cloud.columns[0]
    assert isinstance(first, Classes)
    return dict(zip(first.labels, first.counts(), strict=True))


def bumps() -> np.ndarray:
    v, u = np.mgrid[0:24, 0:32]
    return (2.0 + 0.1 * np.sin(u / 3.0) * np.cos(v / 3.0)).astype(np.float32)


# ------------------------------------------------------------------------------- what is shown


def test_a_forgery_shows_what_was_done(bundle: None) -> None:
    cloud = shown(forged())
    assert truth(cloud) == {"untouched": 1200, "added": 3}
    assert isinstance(cloud, DrawnPoints)
    assert [line.name for line in cloud.lines] == ["forged region"]
    assert cloud.name == "forged: ctp"


def test_removed_points_are_shown_where_they_were() -> None:
    cut = forge.subtract(street(), [Box((4.0, 0.0, -1.7), (2.0, 2.0, 1.0))][0])
    cloud = shown(cut)
    assert cut.removed.size > 0
    assert truth(cloud) == {"untouched": 1200 - len(cut.removed), "removed": len(cut.removed)}
    assert isinstance(cloud, DrawnPoints)
    gone = cloud.points[1200 - len(cut.removed) :]
    np.testing.assert_array_equal(gone, street().points[cut.removed])


def test_results_of_simplification_show_their_mesh(quad: Mesh) -> None:
    fewer = simplify.clean(quad)
    assert shown(fewer) is fewer.mesh
    light = simplify.qem4vr(quad, target_faces=1)
    assert shown(light) is light.mesh
    sparse = simplify.cs3(bumps(), CAMERA, 100)
    assert shown(sparse) is sparse.mesh


def test_results_of_detectors_show_the_scan_that_they_judged() -> None:
    found = authenticate.occlusion_consistency(street())
    assert found.scan is not None
    np.testing.assert_array_equal(found.scan.points, street().points)
    cloud = shown(found)
    assert isinstance(cloud, DrawnPoints)
    assert cloud.num_points == 1200
    assert cloud.columns[0].name == "verdict"


def test_what_cannot_be_shown_is_named() -> None:
    with pytest.raises(InputError, match="got str"):
        shown("mesh.obj")
    nothing = authenticate.occlusion_consistency(np.zeros((3, 3), np.float32))
    with pytest.raises(InputError, match="without its scan"):
        shown(nothing)


# ------------------------------------------------------------------------------- evidence


def test_points_are_colored_by_who_suspects_them() -> None:
    box = Box((4.0, 0.0, -1.7), (1.0, 1.0, 1.0))
    cloud = evidence(
        street(),
        verdict="tampered",
        suspected={"I": [1, 2, 3], "II": [], "III": [3, 4]},
        boxes={"I": [box], "II": [], "III": [box, box]},
    )
    assert truth(cloud) == {
        "not suspected": 1196,
        "suspected by I": 2,
        "suspected by III": 1,
        "suspected by several": 1,
    }
    column = cloud.columns[0]
    assert isinstance(column, Classes)
    assert column.is_emphasized().sum() == 4
    assert [(line.name, len(line.ends)) for line in cloud.lines] == [("I", 12), ("III", 24)]
    assert cloud.lines[0].color == column.palette[1] == ALARM
    with pytest.raises(InputError, match=r"expected rows in \[0, 1199\] by I, got 0 to 1200"):
        evidence(street(), verdict="tampered", suspected={"I": [0, 1200]})


def test_suspected_points_may_be_a_mask() -> None:
    mask = np.arange(1200) % 100 == 7
    for rows in (mask, np.flatnonzero(mask)):
        cloud = evidence(street(), verdict="tampered", suspected={"density": rows})
        assert truth(cloud) == {"not suspected": 1188, "suspected by density": 12}
    for wrong in ([3.7], [3.0], mask[1:], np.zeros((2, 1), int)):
        with pytest.raises(InputError, match=r"suspected\['density'\]: expected row numbers"):
            evidence(street(), verdict="tampered", suspected={"density": wrong})


@pytest.mark.parametrize(
    ("verdict", "color"), [("tampered", QUIET), ("undecidable", DOUBT), ("no_trace", CLEAR)]
)
def test_the_verdict_colors_the_points_that_nobody_suspects(verdict: str, color: tuple) -> None:
    cloud = evidence(street(), verdict=verdict, suspected={})
    assert cloud.colors()[0].tolist() == list(color)


def test_an_unknown_verdict_is_refused() -> None:
    with pytest.raises(InputError, match=r"^verdict: expected .*'no_trace'.*, got 'Tampered'"):
        evidence(street(), verdict="Tampered", suspected={})  # type: ignore[arg-type]


# ------------------------------------------------------------------------------- notebooks


def test_scans_and_frames_and_results_show_themselves_in_notebooks(
    bundle: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MANIP3D_RENDERER", "none")
    frame = RgbdFrame((1000 * bumps()).astype(np.uint16), RgbdCalibration(CAMERA))
    for thing in (street(), frame, forged(), simplify.cs3(bumps(), CAMERA, 100)):
        told = thing._repr_mimebundle_()
        assert set(told) == {"text/plain", "text/html"}
        assert str(told["text/html"]).startswith("<iframe")
    assert repr(frame) == "<manip3d.RgbdFrame: 32 x 24 pixels of depth; number 0, t = 0.000 s>"


def test_large_scans_are_thinned_in_notebooks_and_say_so(
    bundle: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MANIP3D_RENDERER", "none")
    monkeypatch.setattr(notebook, "SHOWN_POINTS", 100)
    text = street()._repr_mimebundle_()["text/plain"]
    assert str(text).splitlines() == [repr(street()), "1,200 points, 100 shown"]


def test_results_of_detectors_are_one_line_of_text() -> None:
    nothing = authenticate.occlusion_consistency(np.zeros((3, 3), np.float32))
    told = nothing._repr_mimebundle_()
    assert set(told) == {"text/plain"}
    assert str(told["text/plain"]).startswith("<manip3d.authenticate.OcclusionResult: undecidable")
    assert "\n" not in str(told["text/plain"])


def test_show_writes_a_page(bundle: None, tmp_path: Path) -> None:
    path = street().show(tmp_path / "street.html", title="Street", color_by="intensity")
    page = content(path.read_text())
    assert page["title"] == "Street"
    assert page["models"][0]["points"]["columns"][0]["name"] == "intensity"


# ------------------------------------------------------------------------------- opening


def test_what_a_source_is(tmp_path: Path, quad: Mesh) -> None:
    street().write(tmp_path / "a.pcd")
    street().write(tmp_path / "points.ply")
    quad.write(tmp_path / "faces.ply")
    (tmp_path / "walk" / "depth").mkdir(parents=True)
    (tmp_path / "drive" / "velodyne").mkdir(parents=True)
    names = ["a.pcd", "points.ply", "faces.ply", "walk", "drive", "x.obj", "x.tiff", "x.pcap.gz"]
    kinds = {name: kind_of(tmp_path / name) for name in names}
    assert kinds == {
        "a.pcd": "scan",
        "points.ply": "scan",
        "faces.ply": "mesh",
        "walk": "rgbd",
        "drive": "scan",
        "x.obj": "mesh",
        "x.tiff": "depth",
        "x.pcap.gz": "scan",
    }
    addresses = ("kitti:a", "pcap:b", "mkv:c", "x.mkv", "sim:body", "people:x", "labanotation:y")
    assert [kind_of(name) for name in addresses] == ["scan"] * 2 + ["rgbd"] * 5
    assert capture.rgbd_address("x.mkv") == "mkv:x.mkv"
    assert capture.rgbd_address("C:\\x.obj") is None
    assert capture.scan_address("a.pcap") == "pcap:a.pcap"


def test_packets_beside_the_metadata_of_an_ouster_are_its(tmp_path: Path) -> None:
    recording = str(tmp_path / "a.pcap")
    metadata = tmp_path / "a.json"
    metadata.write_text('{"product": "VLP-16"}')
    assert capture.scan_address(recording) == f"pcap:{recording}"
    metadata.write_text('{"beam_intrinsics": {"beam_altitude_angles": [1.0]}}')
    assert capture.scan_address(recording) == f"ouster:{recording}"
    metadata.write_bytes(metadata.read_bytes() + bytes(1 << 20))
    assert capture.scan_address(recording) == f"pcap:{recording}"


@pytest.mark.parametrize(
    ("name", "metadata", "is_found"),
    [
        ("a.pcap", "a_0.json", True),  # as Ouster's own programs write it
        ("os1_v2_1024x10_lb_n3.pcap", "os1_v2_1024x10.json", True),  # a part that was cut out
        ("a.pcap", "b.json", False),
        ("ab.pcap", "a.json", False),
        ("a.pcap", "a_b.json", False),
    ],
)
def test_metadata_of_an_ouster_is_found_by_its_name(
    tmp_path: Path, name: str, metadata: str, is_found: bool
) -> None:
    recording = str(tmp_path / name)
    (tmp_path / metadata).write_text('{"beam_intrinsics": {"beam_altitude_angles": [1.0]}}')
    scheme = "ouster" if is_found else "pcap"
    assert capture.scan_address(recording) == f"{scheme}:{recording}"


def test_recordings_of_an_ouster_have_its_address(tmp_path: Path) -> None:
    recording = tmp_path / "a.osf"
    assert capture.scan_address(str(recording)) == f"ouster:{recording}"
    recording.touch()
    assert capture.scan_address(f"{recording}#1") == f"ouster:{recording}#1"
    assert kind_of(str(recording)) == "scan"


def test_depth_images_open_with_and_without_a_camera(tmp_path: Path) -> None:
    np.save(tmp_path / "d.npy", bumps())
    opened = open_thing(tmp_path / "d.npy")
    assert opened.kind == "depth"
    assert opened.note.endswith("camera assumed: focal length 26 pixels")
    given = open_thing(tmp_path / "d.npy", intrinsics=CAMERA)
    assert given.note.startswith("depth 1.90 to 2.10 m, unit m")
    assert "assumed" not in given.note
    assert isinstance(given.thing, DepthImage)
    np.testing.assert_array_equal(given.thing.depth, bumps())


def test_units_of_depth_images_are_respected(tmp_path: Path) -> None:
    np.save(tmp_path / "d.npy", np.full((4, 4), 5000, np.uint16))
    for unit, metres in (("mm", 5.0), (5000.0, 1.0), ("tum", 1.0)):
        opened = open_thing(tmp_path / "d.npy", unit=unit)
        cloud = shown(opened.thing)
        assert isinstance(cloud, DrawnPoints)
        np.testing.assert_allclose(cloud.points[:, 2], metres)


def recording(folder: Path) -> Path:
    """Three frames in the layout of ``capture.record``."""
    frames = [
        RgbdFrame(
            np.full((24, 32), 1000 + n, np.uint16), RgbdCalibration(CAMERA), number=n, time_ns=n
        )
        for n in range(3)
    ]
    capture.record(frames, folder)
    return folder


def test_a_frame_of_a_recording_is_chosen_by_its_number(tmp_path: Path) -> None:
    walk = recording(tmp_path / "walk")
    assert repr(open_thing(walk).thing).endswith("number 0, t = 0.000 s>")
    opened = open_thing(walk, frame=2)
    assert isinstance(opened.thing, RgbdFrame)
    assert (opened.kind, opened.thing.number, opened.note) == ("rgbd", 2, "frame 2 of 3")
    with pytest.raises(InputError, match=r"frame: expected at most 2 of .*walk, got 3"):
        open_thing(walk, frame=3)


def test_a_frame_of_a_file_that_holds_one_is_refused(tmp_path: Path, quad: Mesh) -> None:
    quad.write(tmp_path / "a.obj")
    with pytest.raises(InputError, match="frame: expected none for a mesh file"):
        open_thing(tmp_path / "a.obj", frame=1)
    street().write(tmp_path / "a.bin")
    with pytest.raises(InputError, match="frame: expected at most 0"):
        open_thing(tmp_path / "a.bin", frame=1)
    with pytest.raises(InputError, match="frame: expected 0 or more, got -1"):
        open_thing(tmp_path / "a.bin", frame=-1)


@pytest.mark.parametrize(
    ("name", "kind", "option"),
    [
        ("a.obj", "mesh file", {"color": "c.png"}),
        ("a.obj", "mesh file", {"unit": "mm"}),
        ("a.obj", "mesh file", {"intrinsics": CAMERA}),
        ("a.bin", "scan", {"intrinsics": CAMERA}),
        ("a.bin", "scan", {"color": "c.png"}),
        ("a.bin", "scan", {"calibration": "db.xml"}),
        ("d.npy", "depth image", {"calibration": "db.xml"}),
        ("walk", "recording", {"color": "c.png"}),
        ("walk", "recording", {"unit": "mm"}),
        ("a.pcap", "scan", {"unit": 0.001}),
    ],
)
def test_an_option_without_an_effect_is_refused(
    tmp_path: Path, quad: Mesh, name: str, kind: str, option: dict[str, Any]
) -> None:
    quad.write(tmp_path / "a.obj")
    street().write(tmp_path / "a.bin")
    np.save(tmp_path / "d.npy", bumps())
    recording(tmp_path / "walk")
    (tmp_path / "a.pcap").touch()
    with pytest.raises(InputError, match=f"^{next(iter(option))}: expected none for a {kind}, got"):
        open_thing(tmp_path / name, **option)


def test_a_folder_of_scans_is_not_called_a_mesh_file(tmp_path: Path) -> None:
    (tmp_path / "scans").mkdir()
    street().write(tmp_path / "scans" / "a.bin")
    with pytest.raises(
        InputError, match=r"^calibration: expected none for a folder .*, got db.xml"
    ):
        open_thing(tmp_path / "scans", calibration=Path("db.xml"))


def test_the_first_whole_turn_of_packets_is_opened() -> None:
    def turn(points: int, whole: bool) -> LidarFrame:
        return LidarFrame(
            np.ones((points, 3), np.float32),
            format=ScanFormat("velodyne", header={"is_complete": whole}),
        )

    part, whole = turn(9, False), turn(5, True)
    assert opening._first_whole(iter([part, whole]), "x") == (
        whole,
        "frame 1, the first whole turn; 1 before it",
    )
    assert opening._first_whole(iter([whole, part]), "x") == (whole, "frame 0")
    best, note = opening._first_whole(iter([turn(2, False), part]), "x")
    assert best is part
    assert note == "frame 1, a part of a turn: no turn is whole"
    with pytest.raises(InputError, match="x: expected a scan, found none"):
        opening._first_whole(iter([]), "x")

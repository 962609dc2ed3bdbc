"""`estimate_origin` finds the scanner's position in moved scans, and none in fused ones."""

from __future__ import annotations

import dataclasses
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import command_line
import manip3d
from cave_scans import CAVE, ball, cave
from manip3d import InputError, LidarFrame, forge
from manip3d.authenticate import (
    OriginEstimate,
    _origin,
    _sensors,
    _standpoint,
    density_consistency,
    estimate_origin,
    inspect,
    occlusion_consistency,
)
from manip3d.lidar import ScanFormat
from real_data import RealData
from watermark_scans import grid_scan

Points = NDArray[np.float32]
RESOLUTION = 0.25
"""Degrees."""


def moved(points: Points, offset: object) -> Points:
    return (points.astype(np.float64) + offset).astype(np.float32)


SMALL = cave(0.6)
FUSED = np.concatenate([SMALL, moved(SMALL, (2, 1, 0.3))])
"""Two positions, which takes the whole search to find out."""


def scan(name: str, shift: tuple[float, float, float] = (0.0, 0.0, 0.0), rng: int = 0) -> Points:
    """A simulated scan; ``shift`` moves the scanner, not the frame."""
    pytest.importorskip("open3d")
    from manip3d.simulate import scenes
    from manip3d.simulate.terrestrial import terrestrial_scan

    scene = scenes.make(name)
    stand = tuple(float(v) for v in np.asarray(scene.scanner) + shift)
    made = terrestrial_scan(
        dataclasses.replace(scene, scanner=stand), resolution_deg=RESOLUTION, rng=rng
    )
    return moved(made.points, shift)


SCENES = ("indoor-03", "outdoor-05")


@pytest.fixture(scope="module", params=SCENES)
def single(request: pytest.FixtureRequest) -> tuple[str, Points]:
    return request.param, scan(request.param)


def test_a_moved_scan_tells_where_it_was_taken(single: tuple[str, Points]) -> None:
    name, points = single
    offset = np.random.default_rng(len(name)).uniform(-50, 50, 3)
    shuffled = np.random.default_rng(1).permutation(moved(points, offset))
    found = estimate_origin(shuffled)
    assert found.position is not None
    np.testing.assert_allclose(found.position, offset, atol=1e-3)
    assert found.axis == "z"
    assert found.azimuth_deg == pytest.approx(RESOLUTION, rel=1e-3)
    assert found.elevation_deg == pytest.approx(RESOLUTION, rel=1e-3)
    assert found.explained > 0.99
    assert estimate_origin(points).position == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("seed", [1, 7, 13])
def test_a_first_guess_that_is_nearly_right_is_improved(seed: int) -> None:
    """The densest surfaces of a bare room tell the place to centimetres, its grid far better."""
    angles = np.radians(np.mgrid[0:360:RESOLUTION, -40:60:RESOLUTION]).reshape(2, -1)
    azimuth, elevation = angles
    level = np.cos(elevation)
    rays = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    random = np.random.default_rng(seed)
    walls = random.uniform((3, 3, 1.4), (14, 10, 4))
    ranges = (walls / np.maximum(np.abs(rays), 1e-9)).min(axis=1)
    ranges += random.normal(0.0, 0.002, len(ranges))
    place = random.uniform(5, 30, 3)
    found = estimate_origin((rays * ranges[:, None] + place).astype(np.float32))
    assert found.position is not None
    np.testing.assert_allclose(found.position, place, atol=1e-3)


def test_a_pasted_object_does_not_hide_the_place(single: tuple[str, Points]) -> None:
    _, points = single
    forged = forge.ctp(points, ball(0.15, 20_000), position=(2.0, 1.0, -0.3)).points
    offset = np.array([-12.0, 31.0, 7.0])
    found = estimate_origin(moved(forged, offset))
    assert found.position is not None
    np.testing.assert_allclose(found.position, offset, atol=0.05)


@pytest.mark.parametrize(
    ("single", "share", "shift"),
    [
        ("indoor-03", 1.0, 0.6),
        ("outdoor-05", 0.2, 1.0),
        pytest.param("outdoor-05", 1.0, 0.6, marks=pytest.mark.slow),
        pytest.param("indoor-03", 0.2, 1.0, marks=pytest.mark.slow),
        *(pytest.param(name, 1.0, 2.0, marks=pytest.mark.slow) for name in SCENES),
    ],
    indirect=["single"],
)
def test_fused_positions_are_no_position(
    single: tuple[str, Points], share: float, shift: float
) -> None:
    name, points = single
    other = scan(name, (shift, -0.4 * shift, 0.05), rng=7)
    other = other[np.random.default_rng(2).random(len(other)) < share]
    fused = np.concatenate([points, other])
    told: list[float] = []
    found = estimate_origin(
        moved(fused, (20.0, -8.0, 3.0)), progress=lambda fraction, _: told.append(fraction)
    )
    assert told == sorted(told)
    assert told[-1] == 1.0
    assert found.position is None
    assert "position" in found.reason
    known = estimate_origin(fused, known=(0, 0, 0)).position
    assert known == (None if share == 1.0 else (0.0, 0.0, 0.0))  # a fifth is too few to object


def test_detectors_do_not_judge_fused_positions(monkeypatch: pytest.MonkeyPatch) -> None:
    frame = LidarFrame(FUSED)
    told: list[OriginEstimate] = []

    def once(scan: LidarFrame, **options: Any) -> OriginEstimate:
        """Search once for both detectors, because the search takes longest."""
        assert scan is frame
        if not told:
            told.append(estimate_origin(scan, **options))
        return told[0]

    monkeypatch.setattr(_origin, "estimate_origin", once)
    for detect in (density_consistency, occlusion_consistency):
        found = detect(frame)
        assert found.verdict == "undecidable"
        assert "no single position" in found.reason


@pytest.mark.parametrize("sensor", ["auto", "terrestrial"])
def test_a_stated_origin_does_not_clear_fused_positions(sensor: str) -> None:
    """Scans of two positions have no common grid around a stated origin."""
    found = inspect(LidarFrame(FUSED), origin=(0, 0, 0), sensor=sensor, power=False)
    assert found.verdict == "undecidable"


def test_detectors_judge_from_the_place_they_find() -> None:
    offset = np.array([40.0, -25.0, 8.0])
    forged = forge.ctp(CAVE, ball(0.6, 20_000), position=(3, 1, 0)).points
    found = occlusion_consistency(LidarFrame(moved(forged, offset)))
    assert found.verdict == "tampered"
    np.testing.assert_allclose(found.boxes[0].center, np.add(offset, (3, 1, 0)), atol=0.1)
    assert occlusion_consistency(LidarFrame(moved(CAVE, offset))).verdict == "no_trace"
    assert density_consistency(LidarFrame(moved(CAVE, offset))).verdict == "no_trace"


def test_threads_do_not_matter() -> None:
    cloud = moved(SMALL, (1, 2, 3))
    assert estimate_origin(cloud, threads=1) == estimate_origin(cloud, threads=3)


def test_a_known_place_is_judged() -> None:
    cloud = moved(SMALL, (1.0, 2.0, 3.0))
    assert estimate_origin(cloud, known=(1, 2, 3)).position == (1.0, 2.0, 3.0)
    assert estimate_origin(cloud, known=(0, 0, 0)).position is None


@pytest.mark.parametrize(
    "cloud",
    [
        np.zeros((0, 3)),
        np.ones((1, 3)),
        np.ones((5000, 3)),
        np.zeros((5000, 3)),
        np.full((5000, 3), 1e30),
        np.outer(np.linspace(1, 100, 5000), [1.0, 2.0, 3.0]),
        np.random.default_rng(0).normal(size=(50_000, 3)),
        np.random.default_rng(0).normal(size=(5_000, 3)) * 1e18,
        ball(5.0, 40_000),
    ],
    ids=["empty", "one", "same", "zero", "far", "ray", "noise", "huge", "sphere"],
)
def test_clouds_without_a_grid(cloud: Points) -> None:
    assert estimate_origin(np.asarray(cloud, np.float32)).position is None


def test_what_is_refused() -> None:
    with pytest.raises(InputError, match="known"):
        estimate_origin(CAVE, known=(0, 0))
    with pytest.raises(InputError, match="threads"):
        estimate_origin(CAVE, threads=-1)
    bad = CAVE.copy()
    bad[3, 1] = np.inf
    with pytest.raises(InputError, match="row 3"):
        estimate_origin(bad)


def run(*arguments: object) -> tuple[int, dict[str, object]]:
    result = command_line.run(*arguments, "--json", "-q", "--no-power")
    return result.exit_code, json.loads(result.stdout)


def test_inspect_says_where_the_scanner_stood(tmp_path: Path) -> None:
    path = tmp_path / "scan.ply"
    LidarFrame(moved(CAVE, (5, 6, 7))).write(path)
    code, record = run("inspect", path)
    assert code == 0
    np.testing.assert_allclose(record["origin"], (5, 6, 7), atol=1e-3)
    assert record["origin_from"] == "the angular grid"

    fused = tmp_path / "fused.ply"
    LidarFrame(FUSED).write(fused)
    code, record = run("inspect", fused, "-o", tmp_path / "fused.html")
    assert code == 4
    assert record["origin"] is None
    assert "not known" in (tmp_path / "fused.html").read_text()
    code, record = run("inspect", fused, "--origin", 0, 0, 0)
    assert code == 4


# Largest error of the position, metres. The publishers' files and MANIFEST.md put the scanner of
# each scan at (0, 0, 0).
REAL = {
    "riegl_vz400i_forest.ply.xz": 0.02,
    "pump_room_e57.ply.xz": 0.01,
    "room_scan1.ply.xz": 0.001,
    "room_scan2.ply.xz": 0.001,
    "3dtk_dat/scan000.3d.xz": 0.001,
    "3dtk_dat/scan001.3d.xz": 0.001,
    "3dtk_dat/scan002.3d.xz": 0.001,
}


@pytest.mark.parametrize("name", REAL)
def test_real_scans(realdata: RealData, name: str) -> None:
    points = manip3d.io.read_scan(realdata(f"lidar/tls/{name}")).points
    assert estimate_origin(points).position == (0.0, 0.0, 0.0)
    offset = np.random.default_rng(len(name)).uniform(-20, 20, 3)
    found = estimate_origin(moved(points, offset))
    assert found.position is not None
    assert np.linalg.norm(found.position - offset) < REAL[name]
    assert found.axis == ("y" if "3dtk" in name else "z")


def test_two_real_scans_fused(realdata: RealData) -> None:
    paths = [realdata(f"lidar/tls/room_scan{i}.ply.xz") for i in (1, 2)]
    first, second = (manip3d.io.read_scan(path).points for path in paths)
    assert estimate_origin(np.concatenate([first, moved(second, (0.8, 0.5, 0))])).position is None


def test_a_spinning_scanner_stands_on_its_lattice(realdata: RealData) -> None:
    points = manip3d.io.read_scan(realdata("lidar/kitti_object/velodyne/demo.bin.xz")).points
    found = estimate_origin(points)
    assert found.position == (0.0, 0.0, 0.0)
    assert "lattice" in found.reason
    assert estimate_origin(moved(points, (0.5, 0.2, 0.0))).position is None


def test_a_scanner_with_lasers_off_the_grid_stands_on_its_lattice(realdata: RealData) -> None:
    """Five lasers of a VLP-32C are not at multiples of a third of a degree."""
    path = realdata("lidar/packets/reference/vlp32.pcap")
    with manip3d.capture.open(f"pcap:{path}") as source:
        frame = next(f for f in source if f.num_points > 20_000)
    found = estimate_origin(frame.replace(origin=None))
    assert found.position == (0.0, 0.0, 0.0)
    assert "lattice" in found.reason


def test_a_cloud_that_nobody_scanned_is_given_up_soon() -> None:
    """Random points above a flat floor once made the search for a position endless."""
    begin = time.process_time()
    assert estimate_origin(grid_scan(2000), threads=1).position is None
    # A guard against a search that hangs, no measurement: 1.2 s here, 15 s before.
    assert time.process_time() - begin < 8


def on_map(points: Points, sources: object = None, place: float = 5e6) -> LidarFrame:
    """Return a scan as if read from map coordinates, with the flight lines of LAS."""
    to_file = np.eye(4)
    to_file[:3, 3] = place
    fields = {} if sources is None else {"point_source_id": np.asarray(sources, np.uint16)}
    return LidarFrame(points, fields=fields, format=ScanFormat("las", to_file=to_file))


def test_a_map_of_several_flights_has_no_single_place() -> None:
    points = grid_scan(2000)
    lines = np.arange(len(points)) % 3
    frame = on_map(points, lines)
    found = inspect(frame, power=False)
    assert found.verdict == "undecidable"
    assert found.reason.startswith("the file names 3 flight lines or positions")
    assert occlusion_consistency(frame).verdict == "undecidable"
    assert inspect(frame, origin=(0.0, 0.0, 0.0), power=False).origin_from == "argument"
    one = np.zeros(len(points))
    one[: len(points) // 150] = 7  # less than 1 %
    for other in (on_map(points, one), on_map(points, lines, place=0.0), on_map(points)):
        assert "flight lines" not in inspect(other, power=False).reason


def test_a_scan_on_a_map_tells_where_it_was_taken(
    single: tuple[str, Points], monkeypatch: pytest.MonkeyPatch
) -> None:
    """No lattice is looked for around (0, 0, 0) of the map, where the scanner did not stand."""
    name, points = single
    looked_at: list[LidarFrame] = []
    identify = _sensors.identify_and_read

    def looking(frame: LidarFrame, **options: Any) -> Any:
        looked_at.append(frame)
        return identify(frame, **options)

    monkeypatch.setattr(_standpoint, "identify_and_read", looking)
    monkeypatch.setattr(_origin, "generic_consistency", None)
    found = inspect(on_map(moved(points, (12.0, -7.0, 1.0))), power=False)
    assert found.origin == pytest.approx((12.0, -7.0, 1.0), abs=2e-3), name
    assert [frame.origin for frame in looked_at] == [(0.0, 0.0, 0.0)]  # moved there


def test_the_zero_of_a_map_is_not_tried(single: tuple[str, Points]) -> None:
    """The position (0, 0, 0) is tried for plain scans only; on a map the search ends near it."""
    _, points = single
    assert estimate_origin(points).position == (0.0, 0.0, 0.0)
    found = estimate_origin(on_map(points)).position
    assert found is not None
    assert found != (0.0, 0.0, 0.0)
    np.testing.assert_allclose(found, 0.0, atol=0.02)

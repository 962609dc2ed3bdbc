"""The HDL-64E's calibration in db.xml and YAML, and the errors for hostile files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manip3d import FormatError
from manip3d.capture import VelodyneCalibration, read_velodyne_calibration
from velodyne_packets import hdl64e_calibration

yaml = pytest.importorskip("yaml")


def db_xml(c: VelodyneCalibration) -> str:
    """Return a db.xml as Velodyne ships it: degrees and centimetres, rotations to be subtracted."""
    items = ""
    for i in range(len(c.elevation)):
        values = {
            "id_": i,
            "rotCorrection_": -c.azimuth_offset[i],
            "vertCorrection_": c.elevation[i],
            "distCorrection_": 100 * c.range_offset[i],
            "distCorrectionX_": 100 * c.range_offset_x[i],
            "distCorrectionY_": 100 * c.range_offset_y[i],
            "vertOffsetCorrection_": 100 * c.vertical_offset[i],
            "horizOffsetCorrection_": 100 * c.horizontal_offset[i],
        }
        inner = "".join(f"<{key}>{float(value)!r}</{key}>" for key, value in values.items())
        items += f"<item><px class_id='9'>{inner}</px></item>"
    return (
        "<?xml version='1.0'?><!DOCTYPE boost_serialization><boost_serialization><DB>"
        f"<distLSB_>0.2</distLSB_><points_><count>64</count>{items}</points_>"
        "</DB></boost_serialization>"
    )


def ros_yaml(c: VelodyneCalibration) -> str:
    lasers = [
        {
            "laser_id": i,
            "rot_correction": float(-np.radians(c.azimuth_offset[i])),
            "vert_correction": float(np.radians(c.elevation[i])),
            "dist_correction": float(c.range_offset[i]),
            "dist_correction_x": float(c.range_offset_x[i]),
            "dist_correction_y": float(c.range_offset_y[i]),
            "vert_offset_correction": float(c.vertical_offset[i]),
            "horiz_offset_correction": float(c.horizontal_offset[i]),
        }
        for i in range(len(c.elevation))
    ]
    text: str = yaml.safe_dump({"lasers": lasers, "num_lasers": 64, "distance_resolution": 0.002})
    return text


@pytest.mark.parametrize(("name", "make"), [("db.xml", db_xml), ("c.yaml", ros_yaml)])
def test_both_formats_say_the_same(tmp_path: Path, name: str, make: Any) -> None:
    expected = hdl64e_calibration(two_points=True)
    path = tmp_path / name
    path.write_text(make(expected))
    made = read_velodyne_calibration(path)
    np.testing.assert_allclose(made.table(), expected.table(), atol=1e-12)
    assert made.range_unit == pytest.approx(0.002)


def test_offsets_at_one_distance_only(tmp_path: Path) -> None:
    text = "lasers: [{laser_id: 0, rot_correction: 0.1, vert_correction: 0, dist_correction: 1}]"
    (tmp_path / "c.yaml").write_text(text)
    made = read_velodyne_calibration(tmp_path / "c.yaml")
    assert made.two_points.tolist() == [False]
    assert made.azimuth_offset[0] == pytest.approx(-np.degrees(0.1))


FLAG = "two_pt_correction_available"
FAR = "rot_correction: 0.1, vert_correction: 0, dist_correction: 1.2"
NEAR = "dist_correction_x: 1.1, dist_correction_y: 1.3"


@pytest.mark.parametrize(
    ("laser", "two_points"),
    [
        (f"{FAR}, {NEAR}, two_pt_correction_available: false", False),
        (f"{FAR}, {NEAR}, two_pt_correction_available: true", True),
        (f"{FAR}, {NEAR}, two_pt_correction_available: 1", True),
        (f"{FAR}, {NEAR}", True),
        (f"{FAR}, dist_correction_x: 0.0, dist_correction_y: 0.0", False),
        (f"{FAR}, dist_correction_x: 1.1, dist_correction_y: 0.0", False),
        (f"{FAR}, dist_correction_x: 1.1", False),
        (f"{FAR}, two_pt_correction_available: false", False),
    ],
)
def test_lasers_with_offsets_at_two_distances(tmp_path: Path, laser: str, two_points: bool) -> None:
    text = f"lasers: [{{laser_id: 0, {laser}}}, {{laser_id: 1, {FAR}}}]"
    (tmp_path / "c.yaml").write_text(text)
    made = read_velodyne_calibration(tmp_path / "c.yaml")
    assert made.two_points.tolist() == [two_points, False]
    assert made.two_points.dtype == np.bool_


def test_a_db_xml_of_zeros_has_offsets_at_one_distance(tmp_path: Path) -> None:
    (tmp_path / "db.xml").write_text(db_xml(hdl64e_calibration(two_points=False)))
    assert not read_velodyne_calibration(tmp_path / "db.xml").two_points.any()


BOMB = (
    '<!DOCTYPE a [<!ENTITY b "'
    + "x" * 1000
    + '">'
    + "".join(f'<!ENTITY b{i} "{f"&b{i - 1};" * 100 if i else "&b;" * 100}">' for i in range(6))
    + "]><a>&b5;</a>"
)
LASER = "{laser_id: 0, rot_correction: 0, vert_correction: 0, dist_correction: 0}"


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("a.xml", BOMB, "entities and external DTDs are refused"),
        ("a.xml", '<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]><a>&b;</a>', "entities"),
        ("a.xml", "<a>" * 100, "nested deeper than 64"),
        ("a.xml", "<a><b></a>", "not well-formed XML"),
        ("a.xml", "", "not well-formed XML"),
        ("a.xml", "<a/>", "lasers numbered 0, 1, 2"),
        ("a.xml", "<a>" + "x" * (17 << 20), "at most 16777216 bytes"),
        ("a.xml", "<a><points_><px><id_>0</id_></px></points_></a>", "a laser without vertCorr"),
        ("a.xml", "<a><points_><px><id_>nan</id_></px></points_></a>", "expected a finite number"),
        ("a.yaml", "a: &a [1]\nb: [*a, *a]", "aliases are refused"),
        ("a.yaml", "[" * 5000, "not YAML"),
        ("a.yaml", "lasers: [" + ", ".join([LASER] * 2) + "]", "lasers numbered 0, 1, 2"),
        ("a.yaml", "lasers: [{laser_id: 0}]", "a laser without vert_correction"),
        ("a.yaml", "lasers: [{laser_id: .inf}]", "expected a finite number"),
        ("a.yaml", "lasers: 5", "expected a list of lasers"),
        ("a.yaml", f"lasers: [{{laser_id: 0, {FAR}, {FLAG}: maybe}}]", "expected true or false"),
        ("a.yaml", f"lasers: [{{laser_id: 0, {FAR}, {FLAG}: [1]}}]", "expected true or false"),
        ("a.yaml", f"lasers: [{{laser_id: 0, {FAR}, {FLAG}: true}}]", "without dist_correction_x"),
        ("a.yaml", "!!python/object/apply:os.system [ls]", "not YAML"),
        ("a.yaml", "a: b: c", "not YAML"),
        ("a.yaml", "a: !!bool x", "not YAML"),
        ("a.yaml", 'a: !!int ""', "not YAML"),
        ("a.yaml", "a: !!timestamp x", "not YAML"),
        ("a.yaml", '"\\UFFFFFFFF"', "not YAML"),
        ("a.yaml", "x" * (200 << 10), "at most 131072 bytes"),
        ("a.yaml", "", "expected a list of lasers"),
    ],
)
def test_hostile_calibrations(tmp_path: Path, name: str, text: str, reason: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(FormatError, match=reason) as caught:
        read_velodyne_calibration(tmp_path / name)
    assert caught.value.file == str(tmp_path / name)

"""Calibration of an HDL-64E, from Velodyne's ``db.xml`` or from ROS's YAML version of that file."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d._util.reprs import short_repr
from manip3d._util.text_files import parse_xml, parse_yaml
from manip3d.errors import FormatError

if TYPE_CHECKING:
    from numpy.typing import NDArray

_MAX_LASERS = 128  # largest number of lasers in a calibration

# Names of the attributes, in db.xml and in YAML. db.xml has degrees and centimetres, YAML radians
# and metres. Both define rotCorrection with the opposite sign of `azimuth_offset`: it is subtracted
# from the rotor's azimuth.
_NAMES = (
    ("elevation", "vertCorrection_", "vert_correction"),
    ("azimuth_offset", "rotCorrection_", "rot_correction"),
    ("range_offset", "distCorrection_", "dist_correction"),
    ("range_offset_x", "distCorrectionX_", "dist_correction_x"),
    ("range_offset_y", "distCorrectionY_", "dist_correction_y"),
    ("vertical_offset", "vertOffsetCorrection_", "vert_offset_correction"),
    ("horizontal_offset", "horizOffsetCorrection_", "horiz_offset_correction"),
)
_ANGLES = ("elevation", "azimuth_offset")
_FLAG = "two_pt_correction_available"  # in YAML only
_OPTIONAL = ("range_offset_x", "range_offset_y", "vertical_offset", "horizontal_offset")


@dataclass(frozen=True, eq=False)
class VelodyneCalibration:
    """Directions and range corrections of the lasers, in the terms of the HDL-64E's db.xml.

    Attributes
    ----------
    elevation, azimuth_offset : (L,) float64
        Degrees; the azimuth offset is added to the rotor's azimuth, clockwise seen from above.
    range_offset : (L,) float64
        Metres, added to the range; for lasers with ``two_points`` it is valid at 25.04 m.
    two_points : (L,) bool
        Whether the laser's range offset was measured at two distances.
    range_offset_x, range_offset_y : (L,) float64
        Range offsets in metres at the nearer distance, 2.4 m along x and 1.93 m along y.
    vertical_offset, horizontal_offset : (L,) float64
        Offsets of the laser, metres, at right angles to its beam.
    range_unit : float
        Metres per unit of the ranges in the packets.
    """

    elevation: NDArray[np.float64]
    azimuth_offset: NDArray[np.float64]
    range_offset: NDArray[np.float64]
    two_points: NDArray[np.bool_]
    range_offset_x: NDArray[np.float64]
    range_offset_y: NDArray[np.float64]
    vertical_offset: NDArray[np.float64]
    horizontal_offset: NDArray[np.float64]
    range_unit: float = 0.002

    __repr__ = short_repr

    def table(self) -> NDArray[np.float64]:
        """Return the attributes except ``range_unit`` as columns in their order, (L, 8) float64."""
        columns = [
            self.elevation,
            self.azimuth_offset,
            self.range_offset,
            self.two_points,
            self.range_offset_x,
            self.range_offset_y,
            self.vertical_offset,
            self.horizontal_offset,
        ]
        return np.ascontiguousarray(np.column_stack(columns), np.float64)


@checked
def read_velodyne_calibration(path: str | os.PathLike[str]) -> VelodyneCalibration:
    """Read an HDL-64E's calibration: Velodyne's ``db.xml``, or ROS's YAML version of it.

    Parameters
    ----------
    path : path
        The file; it is read as YAML unless its name ends in ``.xml``.

    Returns
    -------
    VelodyneCalibration
        Directions, offsets and corrections of each laser, in metres and degrees. ``two_points`` is
        the laser's ``two_pt_correction_available`` in YAML. Where that is not stated, it is true if
        the offsets at the nearer distance along x and along y are both there and not 0, as in the
        program that writes ROS's YAML files: files for lasers without these offsets hold zeros.

    Raises
    ------
    FormatError
        The file is damaged or hostile (entities and external DTDs are refused), or a laser is
        missing; a laser with ``two_pt_correction_available`` has no offsets at the nearer distance.
    MissingExtraError
        PyYAML is not installed and the file is YAML: ``pip install 'manip3d[velodyne]'``.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d import capture
    >>> laser = "{laser_id: 0, rot_correction: 0.1, vert_correction: -0.1, dist_correction: 1.2}"
    >>> _ = Path("hdl.yaml").write_text(f"{{lasers: [{laser}]}}")
    >>> found = capture.read_velodyne_calibration("hdl.yaml")
    >>> found.elevation.round(2).tolist(), found.range_offset.tolist()
    ([-5.73], [1.2])
    """
    return VelodyneCalibration(**_read(path_of(path)))


def _read(path: Path) -> dict[str, Any]:
    """Return the attributes of `VelodyneCalibration`."""
    if path.suffix.lower() == ".xml":
        return _read_xml(path)
    return _read_yaml(path)


def _read_xml(path: Path) -> dict[str, Any]:
    root = parse_xml(path)
    lasers = [item for points in root.iter("points_") for item in points.iter("px")]
    unit = root.find(".//distLSB_")
    # Models with fewer lasers use the same file, with unused entries at its end.
    count = sum(_number(c, path) != 0.0 for c in root.findall(".//enabled_/item"))
    by_id = _by_id([(_child(item, "id_", path), item) for item in lasers], path)
    table = _table(
        [by_id[i] for i in range(min(len(by_id), count) if count else len(by_id))],
        lambda item, key: _optional_child(item, key, path),
        1,
        path,
    )
    metres = 0.01
    for name, values in table.items():
        if name not in (*_ANGLES, "two_points"):
            values *= metres
    return table | {"range_unit": 0.002 if unit is None else metres * _number(unit, path)}


def _child(item: Element, name: str, path: Path) -> float:
    value = _optional_child(item, name, path)
    if value is None:
        raise FormatError(f"a laser without {name}", file=str(path))
    return value


def _optional_child(item: Element, name: str, path: Path) -> float | None:
    child = item.find(name)
    return None if child is None else _number(child, path)


def _number(element: Element, path: Path) -> float:
    return _finite(element.text, element.tag, path)


def _finite(text: Any, name: str, path: Path) -> float:
    try:
        value = float(text)
    except (TypeError, ValueError, OverflowError):
        value = math.nan
    if not math.isfinite(value):
        raise FormatError(f"{name}: expected a finite number, got {text!r:.40}", file=str(path))
    return value


def _read_yaml(path: Path) -> dict[str, Any]:
    data = parse_yaml(path, extra="velodyne")
    lasers = data.get("lasers") if isinstance(data, Mapping) else None
    if not isinstance(lasers, list) or not all(isinstance(item, Mapping) for item in lasers):
        raise FormatError("expected a list of lasers", file=str(path))

    def number(item: Mapping[str, Any], key: str) -> float | None:
        return _finite(item[key], key, path) if key in item else None

    by_id = _by_id(
        [(_finite(item.get("laser_id"), "laser_id", path), item) for item in lasers], path
    )
    in_order = [by_id[i] for i in range(len(by_id))]
    table = _table(in_order, number, 2, path)
    for i, laser in enumerate(in_order):
        if _FLAG in laser:
            table["two_points"][i] = _flag(laser, path)
    for name in _ANGLES:
        table[name] = np.degrees(table[name])
    return table | {"range_unit": _finite(data.get("distance_resolution", 0.002), "unit", path)}


def _flag(laser: Mapping[str, Any], path: Path) -> bool:
    """Return whether a laser's YAML says that its range offset was measured at two distances."""
    value = laser[_FLAG]
    if value not in (True, False):  # also 0 and 1
        raise FormatError(f"{_FLAG}: expected true or false, got {value!r:.40}", file=str(path))
    if value and not {"dist_correction_x", "dist_correction_y"} <= laser.keys():
        raise FormatError(
            f"a laser with {_FLAG}, without dist_correction_x and dist_correction_y", file=str(path)
        )
    return bool(value)


def _by_id(items: list[tuple[float, Any]], path: Path) -> dict[int, Any]:
    by_id = {int(number): item for number, item in items if 0 <= number < _MAX_LASERS}
    if not items or len(items) > _MAX_LASERS or sorted(by_id) != list(range(len(items))):
        raise FormatError(
            f"expected lasers numbered 0, 1, 2, ... (at most {_MAX_LASERS}), got {len(items)}",
            file=str(path),
        )
    return by_id


def _table(
    lasers: list[Any], number: Callable[[Any, str], float | None], column: int, path: Path
) -> dict[str, Any]:
    table: dict[str, Any] = {}
    for names in _NAMES:
        values = [number(laser, names[column]) for laser in lasers]
        if names[0] not in _OPTIONAL and None in values:
            raise FormatError(f"a laser without {names[column]}", file=str(path))
        table[names[0]] = np.array([0.0 if v is None else v for v in values])
    table["two_points"] = (table["range_offset_x"] != 0.0) & (table["range_offset_y"] != 0.0)
    table["azimuth_offset"] = -table["azimuth_offset"]
    return table

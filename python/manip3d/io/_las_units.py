"""Unit of length that the coordinate reference system of a LAS file states."""

from __future__ import annotations

import re
from typing import Any

FOOT = "feet"
"""Name of the unit in `manip3d.lidar.ScanFormat.header`, for international and US survey feet."""
DEGREES = "degrees"
"""Name of the unit if x and y are longitudes and latitudes."""

_LINEAR_KEYS = (3076, 4099)
"""GeoTIFF keys ProjLinearUnits and VerticalUnits."""
_FEET = (9002, 9003)
"""EPSG codes of the international foot and of the US survey foot."""
_MODEL, _GEOGRAPHIC = 1024, 2
"""GeoTIFF key GTModelType, and its value for longitudes and latitudes."""
_GEO_KEYS, _WKT = 34735, 2112  # record ids of GeoKeyDirectoryTag and of OGC WKT (LAS 1.4)
_FOOT_IN_WKT = re.compile(r'UNIT\s*\[\s*"[^"]*"\s*,\s*0?\.3048')
_METRE_IN_WKT = re.compile(r'UNIT\s*\[\s*"met(?:re|er)s?"', re.IGNORECASE)
_PROJECTED_IN_WKT = re.compile(r"PROJ(?:CS|CRS|ECTEDCRS)\s*\[", re.IGNORECASE)
_GEOGRAPHIC_IN_WKT = re.compile(
    r"GEOG(?:CS|CRS|RAPHICCRS)\s*\[|\bCS\s*\[\s*ellipsoidal", re.IGNORECASE
)
_SYSTEM_IN_WKT = re.compile(r"CRS\s*\[", re.IGNORECASE)
_AXES_IN_WKT = re.compile(r"\bCS\s*\[", re.IGNORECASE)


def stated_unit(header: Any) -> str:
    """Return the unit that a LAS header states, if it is not the metre; else ''.

    Degrees are recognised by the kind of the coordinate system, feet by their EPSG code or factor.
    A system that is named only by an EPSG code has no known unit, because manip3d has no table of
    these codes. If horizontal and vertical units differ, no unit holds for the scan.

    Parameters
    ----------
    header : laspy.LasHeader
        Header with its variable length records.
    """
    feet = metres = 0
    degrees = False
    for record in header.vlrs:
        if record.user_id != "LASF_Projection":
            continue
        if record.record_id == _GEO_KEYS:
            keys = getattr(record, "geo_keys", ())
            degrees |= any((key.id, key.value_offset) == (_MODEL, _GEOGRAPHIC) for key in keys)
            units = [key.value_offset for key in keys if key.id in _LINEAR_KEYS]
            feet += sum(unit in _FEET for unit in units)
            metres += sum(unit not in _FEET for unit in units)
        elif record.record_id == _WKT:
            text = getattr(record, "string", "")
            degrees |= bool(_GEOGRAPHIC_IN_WKT.search(text) and not _PROJECTED_IN_WKT.search(text))
            axes = _axes_in_wkt(text)
            feet += len(_FOOT_IN_WKT.findall(axes))
            metres += len(_METRE_IN_WKT.findall(axes))
    if degrees:
        return DEGREES
    return FOOT if feet and not metres else ""


def _axes_in_wkt(text: str) -> str:
    """Return the parts of a system's text that state its axes.

    In ISO 19162 (WKT 2) the ellipsoid and the parameters of a projection have units, too. The axes
    follow them, after ``CS[``. OGC's older WKT has units of axes only.
    """
    systems = _SYSTEM_IN_WKT.split(text)
    axes = [part for system in systems for part in _AXES_IN_WKT.split(system)[1:]]
    return " ".join(axes) if axes else text

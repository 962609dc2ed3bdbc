"""The unit that the coordinate system of a LAS file states."""

from __future__ import annotations

import re
from typing import Any

FOOT = "feet"
"""The name of the unit, in `manip3d.lidar.ScanFormat.header`; international and US survey feet."""
DEGREES = "degrees"
"""The name where x and y are longitudes and latitudes."""

_LINEAR_KEYS = (3076, 4099)
"""Keys of GeoTIFF: units of projected and of vertical coordinates."""
_FEET = (9002, 9003)
"""EPSG's numbers of the two."""
_MODEL, _GEOGRAPHIC = 1024, 2
"""Key of GeoTIFF for the kind of the system, and its value for longitudes and latitudes."""
_GEO_KEYS, _WKT = 34735, 2112
_FOOT_IN_WKT = re.compile(r'UNIT\s*\[\s*"[^"]*"\s*,\s*0?\.3048')
_METRE_IN_WKT = re.compile(r'UNIT\s*\[\s*"met(?:re|er)s?"', re.IGNORECASE)
_PROJECTED_IN_WKT = re.compile(r"PROJ(?:CS|CRS|ECTEDCRS)\s*\[", re.IGNORECASE)
_GEOGRAPHIC_IN_WKT = re.compile(r"GEOG(?:CS|CRS|RAPHICCRS)\s*\[", re.IGNORECASE)


def stated_unit(header: Any) -> str:
    """The unit that a LAS header states, if it is not the metre; else ''.

    Degrees are told by the kind of the system, feet by number or factor. A projected system that is
    named by a number of EPSG alone states no unit: the tables of systems are not part of this
    package. Where horizontal and vertical lengths have different units, none holds for the scan.

    Parameters
    ----------
    header : laspy.LasHeader
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
            feet += len(_FOOT_IN_WKT.findall(text))
            metres += len(_METRE_IN_WKT.findall(text))
    if degrees:
        return DEGREES
    return FOOT if feet and not metres else ""

"""The unit of length that the coordinate system of a LAS file states."""

from __future__ import annotations

import re
from typing import Any

FOOT = "feet"
"""The name of the unit, in `manip3d.lidar.ScanFormat.header`; international and US survey feet."""

_LINEAR_KEYS = (3076, 4099)
"""Keys of GeoTIFF: units of projected and of vertical coordinates."""
_FEET = (9002, 9003)
"""EPSG's numbers of the two."""
_GEO_KEYS, _WKT = 34735, 2112
_FOOT_IN_WKT = re.compile(r'UNIT\s*\[\s*"[^"]*"\s*,\s*0?\.3048')
_METRE_IN_WKT = re.compile(r'UNIT\s*\[\s*"met(?:re|er)s?"', re.IGNORECASE)


def stated_unit(header: Any) -> str:
    """The unit that a LAS header states by number or factor, if it is not the metre; else ''.

    A header that names its system by a number of EPSG alone states none: the tables of systems are
    not part of this package. Where horizontal and vertical units differ, none holds for the scan.

    Parameters
    ----------
    header : laspy.LasHeader
    """
    feet = metres = 0
    for record in header.vlrs:
        if record.user_id != "LASF_Projection":
            continue
        if record.record_id == _GEO_KEYS:
            keys = getattr(record, "geo_keys", ())
            units = [key.value_offset for key in keys if key.id in _LINEAR_KEYS]
            feet += sum(unit in _FEET for unit in units)
            metres += sum(unit not in _FEET for unit in units)
        elif record.record_id == _WKT:
            text = getattr(record, "string", "")
            feet += len(_FOOT_IN_WKT.findall(text))
            metres += len(_METRE_IN_WKT.findall(text))
    return FOOT if feet and not metres else ""

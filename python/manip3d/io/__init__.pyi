from __future__ import annotations

from manip3d.io._bvh import Motion, read_bvh
from manip3d.io._depth_files import DEPTH_SUFFIXES, is_color_png, read_depth, read_pixel_map
from manip3d.io._depth_units import (
    DEPTH_UNITS,
    DepthReading,
    describe_unit,
    guess_depth_unit,
    read_depth_guessing,
)
from manip3d.io._images import texture_path
from manip3d.io._limits import ReadLimits
from manip3d.io._lods import write_lods
from manip3d.io._mesh_files import (
    READABLE,
    WRITABLE,
    ReadReport,
    read_mesh,
    read_mesh_bytes,
    read_report,
    write_mesh,
)
from manip3d.io._range_grids import RangeGrid, read_range_grid
from manip3d.io._remote import is_url, local_copy, local_output
from manip3d.io._scan_files import SCAN_SUFFIXES, read_scan, read_scans, write_scan, write_scans
from manip3d.io._scenes import Deformation, Scene, SceneNode, read_scene, write_scene

__all__ = [
    "DEPTH_SUFFIXES",
    "DEPTH_UNITS",
    "READABLE",
    "SCAN_SUFFIXES",
    "WRITABLE",
    "Deformation",
    "DepthReading",
    "Motion",
    "RangeGrid",
    "ReadLimits",
    "ReadReport",
    "Scene",
    "SceneNode",
    "describe_unit",
    "guess_depth_unit",
    "is_color_png",
    "is_url",
    "local_copy",
    "local_output",
    "read_bvh",
    "read_depth",
    "read_depth_guessing",
    "read_mesh",
    "read_mesh_bytes",
    "read_pixel_map",
    "read_range_grid",
    "read_report",
    "read_scan",
    "read_scans",
    "read_scene",
    "texture_path",
    "write_lods",
    "write_mesh",
    "write_scan",
    "write_scans",
    "write_scene",
]

"""Reading and writing of mesh, scan and depth files.

Readers are safe on hostile input. A damaged file, an index out of range, or a header that claims
more data than the file holds raises a `FormatError`, which names the file and the line or byte.
"""

from __future__ import annotations

from manip3d._util.lazy import lazily

__getattr__, __dir__, __all__ = lazily(
    __name__,
    {
        "_bvh": "Motion read_bvh",
        "_depth_files": "DEPTH_SUFFIXES is_color_png read_depth read_pixel_map",
        "_depth_units": (
            "DEPTH_UNITS DepthReading describe_unit guess_depth_unit read_depth_guessing"
        ),
        "_images": "texture_path",
        "_limits": "ReadLimits",
        "_lods": "write_lods",
        "_mesh_files": (
            "READABLE WRITABLE ReadReport read_mesh read_mesh_bytes read_report write_mesh"
        ),
        "_range_grids": "RangeGrid read_range_grid",
        "_remote": "is_url local_copy local_output",
        "_scan_files": "SCAN_SUFFIXES read_scan read_scans write_scan write_scans",
        "_scenes": "Deformation Scene SceneNode read_scene write_scene",
    },
)

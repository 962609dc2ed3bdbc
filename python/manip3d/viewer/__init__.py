"""Pictures and interactive views of meshes and scans."""

from manip3d.viewer.page import html, iframe, view
from manip3d.viewer.pictures import comparison, picture, png_bytes
from manip3d.viewer.points import scan_mesh, view_scan
from manip3d.viewer.renderer import renderer

__all__ = [
    "comparison",
    "html",
    "iframe",
    "picture",
    "png_bytes",
    "renderer",
    "scan_mesh",
    "view",
    "view_scan",
]

"""Pictures and interactive views of meshes."""

from manip3d.viewer.page import html, iframe, view
from manip3d.viewer.pictures import comparison, picture, png_bytes
from manip3d.viewer.renderer import renderer

__all__ = ["comparison", "html", "iframe", "picture", "png_bytes", "renderer", "view"]

"""Pictures and interactive views of meshes."""

from manip3d.viewer.pictures import comparison, picture, png_bytes
from manip3d.viewer.renderer import renderer

__all__ = ["comparison", "picture", "png_bytes", "renderer"]

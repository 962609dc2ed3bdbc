from manip3d.viewer.evidence_points import evidence, forgery_points
from manip3d.viewer.frame_pictures import rgbd_picture, sheet
from manip3d.viewer.opening import Opened, kind_of, open_thing
from manip3d.viewer.page import figure, film, has_display, html, iframe, play, view
from manip3d.viewer.pictures import comparison, picture, png_bytes, points_picture
from manip3d.viewer.points import (
    Classes,
    Colors,
    DrawnPoints,
    Lines,
    Scale,
    box_lines,
    drawn_points,
)
from manip3d.viewer.renderers import renderer
from manip3d.viewer.scene import Pose
from manip3d.viewer.sensor_points import (
    DepthImage,
    depth_points,
    rgbd_points,
    scan_points,
    skeleton_lines,
)
from manip3d.viewer.showing import shown
from manip3d.viewer.timing import FrameTimes, frame_times

__all__ = [
    "Classes",
    "Colors",
    "DepthImage",
    "DrawnPoints",
    "FrameTimes",
    "Lines",
    "Opened",
    "Pose",
    "Scale",
    "box_lines",
    "comparison",
    "depth_points",
    "drawn_points",
    "evidence",
    "figure",
    "film",
    "forgery_points",
    "frame_times",
    "has_display",
    "html",
    "iframe",
    "kind_of",
    "open_thing",
    "picture",
    "play",
    "png_bytes",
    "points_picture",
    "renderer",
    "rgbd_picture",
    "rgbd_points",
    "scan_points",
    "sheet",
    "shown",
    "skeleton_lines",
    "view",
]

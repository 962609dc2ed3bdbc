"""Pictures and interactive views of meshes, scans, depth images, RGB-D frames and results."""

from __future__ import annotations

from manip3d._util.lazy import lazily

__getattr__, __dir__, __all__ = lazily(
    __name__,
    {
        "evidence_points": "evidence forgery_points",
        "frame_pictures": "rgbd_picture sheet",
        "opening": "Opened kind_of open_thing",
        "page": "figure film has_display html iframe play view",
        "pictures": "comparison picture png_bytes points_picture",
        "points": "Classes Colors DrawnPoints Lines Scale box_lines drawn_points",
        "renderers": "renderer",
        "scene": "Pose",
        "sensor_points": "DepthImage depth_points rgbd_points scan_points skeleton_lines",
        "showing": "shown",
        "timing": "FrameTimes frame_times",
    },
)

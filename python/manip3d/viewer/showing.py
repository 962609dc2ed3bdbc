"""Conversion of each kind of object to a mesh or points for the viewer."""

from __future__ import annotations

from functools import singledispatch
from typing import Any

from manip3d._util.checked import checked
from manip3d._util.texts import counted
from manip3d.authenticate import DensityResult, GenericResult, Inspection, OcclusionResult
from manip3d.errors import InputError
from manip3d.forge import Forgery
from manip3d.lidar import Box, LidarFrame
from manip3d.mesh import Mesh
from manip3d.rgbd import RgbdFrame
from manip3d.simplify import (
    CleanResult,
    DepthMesh,
    JointSimplification,
    QualityResult,
    SimplifyResult,
)
from manip3d.viewer.evidence_points import evidence, forgery_points
from manip3d.viewer.points import DrawnPoints
from manip3d.viewer.sensor_points import DepthImage, rgbd_points, scan_points

Shown = Mesh | DrawnPoints


@checked
@singledispatch
def shown(thing: Any) -> Shown:
    """Return the mesh or the points that show an object.

    Parameters
    ----------
    thing : Mesh, DrawnPoints
        Returned unchanged.
    thing : LidarFrame, RgbdFrame, DepthImage
        Shown as points, with the bones of people.
    thing : SimplifyResult, QualityResult, CleanResult, DepthMesh, JointSimplification
        Shown by its mesh.
    thing : Forgery
        Shown as the forged scan with emphasised points that were added, moved and removed.
    thing : Inspection, DensityResult, OcclusionResult, GenericResult
        Shown as the scan that was judged, with suspected points and boxes.

    Returns
    -------
    Mesh or DrawnPoints

    Raises
    ------
    InputError
        The object is none of these, or a result without its scan.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import LidarFrame, viewer
    >>> viewer.shown(LidarFrame(np.ones((5, 3), np.float32))).detail
    '5 points'
    """
    raise InputError(
        "thing: expected a Mesh, a LidarFrame, a RgbdFrame, a DrawnPoints, a Forgery or the result "
        f"of a simplification, got {type(thing).__name__}"
    )


@shown.register
def _(thing: Mesh) -> Shown:
    return thing


@shown.register
def _(thing: DrawnPoints) -> Shown:
    return thing


@shown.register
def _(thing: LidarFrame) -> Shown:
    return scan_points(thing)


@shown.register
def _(thing: RgbdFrame) -> Shown:
    return rgbd_points(thing)


@shown.register
def _(thing: DepthImage) -> Shown:
    return thing.drawn()


@shown.register
def _(thing: Forgery) -> Shown:
    return forgery_points(thing)


@shown.register(QualityResult)
@shown.register(SimplifyResult)
@shown.register(CleanResult)
@shown.register(DepthMesh)
@shown.register(JointSimplification)
def _(thing: Any) -> Shown:
    mesh: Mesh = thing.mesh
    return mesh


@shown.register(DensityResult)
@shown.register(OcclusionResult)
@shown.register(GenericResult)
def _(thing: DensityResult | OcclusionResult | GenericResult) -> Shown:
    if thing.scan is None:
        raise InputError(f"thing: {type(thing).__name__} without its scan cannot be shown")
    boxes: tuple[Box, ...]
    if isinstance(thing, GenericResult):
        boxes = tuple(region.box for region in thing.regions)
    else:
        boxes = thing.boxes
    name = DETECTORS[type(thing)]
    return evidence(
        thing.scan,
        verdict=thing.verdict,
        suspected={name: thing.suspected},
        boxes={name: boxes},
    )


@shown.register
def _(thing: Inspection) -> Shown:
    if thing.scan is None:
        raise InputError("thing: an Inspection without its scan cannot be shown")
    return evidence(
        thing.scan,
        verdict=thing.verdict,
        suspected={NAMES[report.name]: report.suspected for report in thing.detectors},
        boxes={NAMES[report.name]: report.boxes for report in thing.detectors},
    )


NAMES = {
    "density": "detector I",
    "occlusion": "detector II",
    "generic": "detector III",
    "turns": "detector IV",
    "reflectance": "detector V",
    "watermark": "watermark",
}


def text_of(thing: Any) -> str:
    """Return a line about an object: its repr, or a short text for results with large arrays."""
    if isinstance(thing, Inspection):
        told = [f"{report.title}: {report.verdict}" for report in thing.detectors]
        return f"<manip3d.authenticate.Inspection: {'; '.join([thing.verdict, *told])}>"
    if type(thing) not in DETECTORS:
        return repr(thing)
    points = counted(len(thing.suspected), "point", separator=",")
    told = [thing.verdict, f"{points} suspected"]
    if reason := getattr(thing, "reason", ""):
        told.append(reason)
    return f"<manip3d.authenticate.{type(thing).__name__}: {'; '.join(told)}>"


DETECTORS: dict[type, str] = {
    DensityResult: "detector I",
    OcclusionResult: "detector II",
    GenericResult: "detector III",
}

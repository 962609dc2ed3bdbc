"""Conversion of other trackers' skeletons to the Kinect V2's 25 joints.

``joint_layouts.csv`` lists the joints of each tracker in the tracker's order. ``joint_maps.csv``
gives each of the 25 joints as a weighted sum of a tracker's joints.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Literal

import numpy as np

from manip3d._util.arrays import rows
from manip3d._util.checked import checked
from manip3d._util.mappings import ReadOnlyMapping
from manip3d.errors import InputError
from manip3d.rgbd import INFERRED, JOINTS, NO_BODY, NOT_TRACKED, TRACKED, Skeleton

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

JointLayout = Literal[
    "kinect-v2", "kinect-v1", "azure-kinect", "mediapipe", "coco", "openpose", "coco-wholebody"
]

_AT_BEST = {"tracked": TRACKED, "inferred": INFERRED}


@dataclass(frozen=True)
class _Rule:
    """One of the 25 joints as a weighted sum of another tracker's joints.

    ``at_best`` is the best state that the joint can have, even if all ``sources`` are tracked.
    """

    joint: int
    at_best: int
    sources: NDArray[np.intp]
    weights: NDArray[np.float64]


def _table(name: str) -> list[dict[str, str]]:
    text = files("manip3d.modify").joinpath(name).read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines()))


@cache
def joint_layouts() -> Mapping[str, tuple[str, ...]]:
    """Return the names of the joints of each tracker that `skeleton_from` knows, in its order.

    Returns
    -------
    mapping of str to tuple of str
        ``kinect-v2`` (25), ``kinect-v1`` (20), ``azure-kinect`` (32), ``mediapipe`` (33), ``coco``
        (17), ``openpose`` (its model BODY_25) and ``coco-wholebody`` (133). Left and right are the
        person's own.
    """
    others = {row["layout"]: tuple(row["joints"].split()) for row in _table("joint_layouts.csv")}
    return ReadOnlyMapping({"kinect-v2": JOINTS} | others)


@cache
def _rules(layout: str) -> tuple[_Rule, ...]:
    """Return the rules of a layout; of several rules for one joint the better comes first."""
    names = joint_layouts()[layout]
    if layout == "kinect-v2":
        return tuple(_Rule(j, TRACKED, np.array([j]), np.ones(1)) for j in range(len(JOINTS)))
    rules = []
    for row in _table("joint_maps.csv"):
        if row["layout"] != layout:
            continue
        terms = [term.split(":") for term in row["from"].split()]
        rules.append(
            _Rule(
                joint=JOINTS.index(row["joint"]),
                at_best=_AT_BEST[row["at_best"]],
                sources=np.array([names.index(name) for name, _ in terms]),
                weights=np.array([float(weight) for _, weight in terms]),
            )
        )
    return tuple(rules)


@checked
def skeleton_from(
    joints: ArrayLike,
    states: ArrayLike | None = None,
    *,
    layout: JointLayout,
    axes: Literal["camera", "kinect"] = "camera",
    id: int = 0,
    body: int = NO_BODY,
) -> Skeleton:
    """Convert the joints of another tracker to the Kinect V2's 25 joints.

    Parameters
    ----------
    joints : (J, 3), metres
        Positions in the order of `joint_layouts`. A joint that is not finite counts as not tracked.
    states : (J,), optional
        `NOT_TRACKED`, `INFERRED` or `TRACKED` for each joint; default: all are tracked.
    layout : str
        Tracker of ``joints``: a key of `joint_layouts`.
    axes : str
        Axes of ``joints``. ``camera``: x right, y down, z ahead; ``kinect``: x left, y up,
        z ahead, as in the Kinect's SDKs.
    id, body : int
        Person's number and value in the body index, as in `Skeleton`.

    Returns
    -------
    Skeleton
        In camera axes, without orientations.

    Raises
    ------
    InputError
        An unknown layout or state, or a wrong number of joints.

    Notes
    -----
    A joint that the tracker does not have is a weighted sum of its neighbours. A midpoint of two
    joints has the worse of their two states. A joint placed by a proportion of the body (the neck
    at 0.35 of the way from shoulders to head, the middle of the spine, the tips of MediaPipe's
    fingers) is `INFERRED` at best. If a source joint is not tracked, the next rule for the joint
    is tried (the nose for the head if an ear is hidden). A joint that no rule gives is
    `NOT_TRACKED`: hand tips and thumbs of Kinect V1, hands and feet of COCO, hands of OpenPose. The
    spine joint of Kinect V1 is taken over unchanged; it lies lower than the Kinect V2's SpineMid.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import modify
    >>> sides = [(20, 45), (25, 15), (28, -10), (12, 0), (13, -45), (14, -90)]  # centimetres
    >>> rows = [(0, 70), (3, 73), (-3, 73), (7, 70), (-7, 70)]  # nose, eyes, ears; then
    >>> rows += [(side * x, y) for x, y in sides for side in (1, -1)]
    >>> joints = np.array([(x, -y, 200) for x, y in rows]) / 100  # 2 m before the camera
    >>> person = modify.skeleton_from(joints, layout="coco")
    >>> person.positions[4].astype(float).round(2).tolist()  # the left shoulder
    [0.2, -0.45, 2.0]
    >>> len(person.positions), int((person.states == 0).sum())  # joints, and those not known
    (25, 8)
    """
    num_joints = len(joint_layouts()[layout])
    given = rows(joints, 3, np.float64, "joints")
    if len(given) != num_joints:
        raise InputError(f"joints: expected {num_joints} rows for {layout}, got {len(given)}")
    trust = _checked_states(states, num_joints)
    trust[~np.isfinite(given).all(axis=1)] = NOT_TRACKED
    if axes == "kinect":
        given = given * [-1.0, -1.0, 1.0]

    positions = np.zeros((len(JOINTS), 3))
    found = np.zeros(len(JOINTS), np.uint8)
    for rule in _rules(layout):
        state = min(rule.at_best, trust[rule.sources].min())
        if found[rule.joint] == NOT_TRACKED and state != NOT_TRACKED:
            positions[rule.joint] = _weighted_sum(rule.weights, given[rule.sources])
            found[rule.joint] = state
    return Skeleton(positions.astype(np.float32), states=found, id=id, body=body)


def _weighted_sum(weights: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum the weighted points one term at a time, so that rounding is the same with every BLAS.

    A BLAS with fused multiply-add need not return 0 for the weighted sum of x and -x, and the sign
    of a coordinate in the middle of the body would depend on the machine.
    """
    total = np.zeros(3)
    for weight, point in zip(weights, points, strict=True):
        total += weight * point
    return total


def _checked_states(states: ArrayLike | None, num_joints: int) -> NDArray[np.uint8]:
    if states is None:
        return np.full(num_joints, TRACKED, np.uint8)
    given = np.asarray(states)
    if given.shape != (num_joints,):
        raise InputError(f"states: expected shape ({num_joints},), got {given.shape}")
    if not np.isin(given, (NOT_TRACKED, INFERRED, TRACKED)).all():
        raise InputError(f"states: expected 0, 1 or 2, got {given}")
    return given.astype(np.uint8)

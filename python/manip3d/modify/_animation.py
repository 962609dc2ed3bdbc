"""A person's depth mesh that follows another skeleton (dissertation section 5.1.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from manip3d import _core
from manip3d._util.arrays import as_array, rows
from manip3d._util.checked import checked
from manip3d._util.reprs import short_repr
from manip3d.camera import Intrinsics
from manip3d.errors import InputError
from manip3d.rgbd import Skeleton

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

Skinning = Literal["spherical", "rigid", "lbs"]
PoseScope = Literal["limbs", "body"]


@dataclass(frozen=True, eq=False)
class AnimationMesh:
    """Mesh of a person's labelled pixels whose bones can move apart at the joints.

    Attributes
    ----------
    vertices : (n, 3) float32
        Positions in metres, in row-major order of the pixels.
    pixels : (n, 2) int32
        Column and row of each vertex.
    labels : (n,) uint8
        Bone of each vertex, 1 to 24.
    faces : (m, 3) int32
        Triangles, whose front faces the camera.
    """

    vertices: NDArray[np.float32]
    pixels: NDArray[np.int32]
    labels: NDArray[np.uint8]
    faces: NDArray[np.int32]

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class Animated:
    """A person in another pose.

    Attributes
    ----------
    vertices : (n, 3) float32
        Moved vertices, metres.
    skeleton : Skeleton
        The moved skeleton; bones keep their lengths.
    """

    vertices: NDArray[np.float32]
    skeleton: Skeleton

    __repr__ = short_repr


@checked
def animation_mesh(
    depth: NDArray[np.uint16 | np.float32],
    intrinsics: Intrinsics,
    labels: NDArray[np.uint8],
    skeleton: Skeleton | None = None,
    *,
    by_label: bool = True,
    joint_reach: float = 0.15,
    max_step: float = 0.0,
) -> AnimationMesh:
    """Triangulate the pixels of a segmented person for animation.

    Parameters
    ----------
    depth : (H, W) uint16 in millimetres or float32 in metres
    intrinsics : Intrinsics
    labels : (H, W) uint8
        Bone of each pixel, as returned by `segment_body`; 0: not the person.
    skeleton : Skeleton, optional
        Joints for ``joint_reach``; without a skeleton ``joint_reach`` has no effect.
    by_label : bool
        Allow a triangle between two bones only if they meet at a joint. If false, a limb that
        touches another part of the body in the image drags that part along (figure 5.5).
    joint_reach : float, metres
        Two bones with one bone between them (upper arm and chest) may share a triangle within
        this distance of the joint between them. 0: never, as published.
    max_step : float, metres
        Largest change of depth within a triangle. 0: the sum of z / f tan 78 degrees (z: depth,
        f: focal length in pixels) and three standard deviations of a Kinect's noise.

    Returns
    -------
    AnimationMesh
        One vertex for each pixel that has a bone; no triangle joins bones that do not meet.

    Raises
    ------
    InputError
        A wrong shape or dtype, a label above 24, or an option out of range.

    Notes
    -----
    Cells of 2 x 2 pixels are cut along the shorter diagonal, as by `simplify.dense_mesh`.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, modify
    >>> sides = [(20, 45), (25, 15), (28, -10), (12, 0), (13, -45), (14, -90)]  # centimetres
    >>> rows = [(0, 70), (3, 73), (-3, 73), (7, 70), (-7, 70)]  # nose, eyes, ears; then
    >>> rows += [(side * x, y) for x, y in sides for side in (1, -1)]
    >>> joints = np.array([(x, -y, 200) for x, y in rows]) / 100  # 2 m before the camera
    >>> person = modify.skeleton_from(joints, layout="coco")
    >>> camera = Intrinsics(fx=100, fy=100, cx=79.5, cy=99.5, width=160, height=200)
    >>> depth = np.zeros((200, 160), np.uint16)
    >>> depth[60:150, 65:95] = 2000  # millimetres
    >>> labels = modify.segment_body(depth, camera, person).labels
    >>> mesh = modify.animation_mesh(depth, camera, labels, person)
    >>> len(mesh.vertices), len(mesh.faces)  # two for each square of four pixels
    (2700, 4918)
    """
    options = _core.AnimationMeshOptions()
    options.by_label, options.joint_reach = bool(by_label), joint_reach
    step = _core.DepthStepOptions()
    step.max_step = max_step
    options.step = step
    image = np.ascontiguousarray(as_array(depth, "depth"))
    bones = np.ascontiguousarray(labels)
    if bones.dtype != np.uint8:
        raise InputError(f"labels: expected uint8, got {bones.dtype}")
    return AnimationMesh(*_core.animation_mesh(image, bones, intrinsics, skeleton, options))


@checked
def animate(
    vertices: ArrayLike,
    labels: NDArray[np.uint8],
    skeleton: Skeleton,
    pose: Skeleton,
    *,
    method: Skinning = "lbs",
    scope: PoseScope = "limbs",
) -> Animated | None:
    """Move the vertices of a person so that their bones point in the directions of a pose's bones.

    Parameters
    ----------
    vertices : (n, 3), metres
        Vertices in the coordinate frame of ``skeleton``; the array is not changed.
    labels : (n,) uint8
        Bone of each vertex, 1 to 24.
    skeleton : Skeleton
        The pose of the vertices.
    pose : Skeleton
        Target pose, of any person at any place: only the directions of its bones are used.
    method : {"lbs", "rigid", "spherical"}
        ``spherical``: as published; the polar angle from the optical axis and the azimuth of each
        vertex about its joint change by the same angles as those of its bone. This is a rigid
        motion if the bone moves in the image plane, but not if it moves towards the camera.
        ``rigid``: each vertex turns with its bone. ``lbs``: linear blend skinning, like ``rigid``
        but blended linearly with the next bone over the last fifth of a bone.
    scope : {"limbs", "body"}
        ``limbs``: arms and legs take the pose's directions relative to the trunk, and the trunk
        keeps its place; ``body``: all bones take them, and the body turns too.

    Returns
    -------
    Animated or None
        None: the torso of ``skeleton`` or ``pose`` is not tracked.

    Raises
    ------
    InputError
        A wrong shape, a label out of range, or an unknown method or scope.

    Notes
    -----
    Angles are applied to ``skeleton``, so that bones keep their lengths (section 5.1.2). From the
    trunk outwards, each bone first turns with its parent bone, then by the shortest rotation to
    its new direction. A bone that is not tracked in ``skeleton`` or in ``pose`` moves with its
    parent.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Skeleton, modify
    >>> sides = [(20, 45), (25, 15), (28, -10), (12, 0), (13, -45), (14, -90)]  # centimetres
    >>> rows = [(0, 70), (3, 73), (-3, 73), (7, 70), (-7, 70)]  # nose, eyes, ears; then
    >>> rows += [(side * x, y) for x, y in sides for side in (1, -1)]
    >>> joints = np.array([(x, -y, 200) for x, y in rows]) / 100  # 2 m before the camera
    >>> person = modify.skeleton_from(joints, layout="coco")
    >>> raised = person.positions.copy()
    >>> raised[5:7] = raised[4] - [[0.3, 0, 0], [0.6, 0, 0]]  # left elbow and wrist
    >>> moved = modify.animate(raised[[6]], np.uint8([6]), Skeleton(raised), person)
    >>> off = np.linalg.norm(moved.vertices - person.positions[6])  # bones keep their lengths
    >>> round(float(off), 2)
    0.04
    """
    bones = np.ascontiguousarray(labels)
    if bones.dtype != np.uint8:
        raise InputError(f"labels: expected uint8, got {bones.dtype}")
    moved = _core.animate(
        rows(vertices, 3, np.float32, "vertices"),
        bones,
        skeleton,
        pose,
        _core.PoseScope.__members__[scope.upper()],
        _core.Skinning.__members__[method.upper()],
    )
    return None if moved is None else Animated(moved[0], Skeleton(**moved[1]))

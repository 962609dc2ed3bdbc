"""Virtual enhancement: an avatar of the user that moves further than the user does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import _core
from manip3d._util.arrays import rows
from manip3d._util.checked import checked
from manip3d._util.options import threads_of
from manip3d._util.reprs import short_repr
from manip3d.errors import InputError
from manip3d.rgbd import JOINTS, Skeleton

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

POSABLE_JOINTS: tuple[str, ...] = tuple(
    name for joint, name in enumerate(JOINTS) if _core.is_posable(joint)
)
"""Joints that `repose` accepts gains and limits for: neck, shoulders, elbows, wrists, hips, knees,
ankles."""


@dataclass(frozen=True, eq=False)
class Reposed:
    """A person in another pose.

    Attributes
    ----------
    vertices : (V, 3) float32 or float64, metres
        Vertices, in the dtype of the input.
    skeleton : Skeleton
        The moved skeleton: bones keep their lengths, and orientations turn with the bones.
    """

    vertices: NDArray[Any]
    skeleton: Skeleton

    __repr__ = short_repr


@checked
def repose(
    vertices: ArrayLike,
    skeleton: Skeleton,
    *,
    gains: Mapping[str, float] | None = None,
    limits: Mapping[str, float] | None = None,
    rest: Skeleton | None = None,
    blended: bool = True,
    band: float = 0.08,
    threads: int = 0,
) -> Reposed | None:
    """Turn joints of a person further from their rest pose, or less far.

    Parameters
    ----------
    vertices : (V, 3), metres
        Vertices of the person's mesh, in the frame of the skeleton. Dtypes other than float32
        become float64. The array is not changed.
    skeleton : Skeleton
        The pose of the vertices.
    gains : mapping of str to float, optional
        Factor of the angle from rest, by the joint's name in `POSABLE_JOINTS`; 0 to 100. Default: 1
        for all joints, which leaves every bit as it is.
    limits : mapping of str to float, degrees, optional
        Largest angle from rest after the gain is applied, by the joint's name.
    rest : Skeleton, optional
        The rest pose. Default: a standing person whose arms and legs hang along the spine, whose
        feet point ahead and whose head is up.
    blended : bool
        Move a vertex near a joint with all bones that meet there, blended by dual quaternions. If
        false, each vertex moves with its nearest bone alone, and the skin opens at joints.
    band : float, metres
        A bone farther from a vertex than the nearest bone by this distance has no weight.
    threads : int
        Number of threads; 0: ``MANIP3D_THREADS`` if it is set, otherwise all cores.

    Returns
    -------
    Reposed or None
        None: the torso of ``skeleton`` or ``rest`` is not tracked.

    Raises
    ------
    InputError
        A joint that is not posable, a number out of range, or a wrong shape.

    Notes
    -----
    The torso of the rest pose is aligned with the current torso. From the torso outwards, the angle
    of a joint is that of the shortest rotation from the direction that its bone would have at rest
    to its current direction. Twist about a bone is kept. Blending: Kavan et al., "Geometric
    skinning with approximate dual quaternion blending", ACM Transactions on Graphics 2008; weights
    come from distances to the bones.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import modify
    >>> sides = [(20, 45), (25, 15), (28, -10), (12, 0), (13, -45), (14, -90)]  # centimetres
    >>> rows = [(0, 70), (3, 73), (-3, 73), (7, 70), (-7, 70)]  # nose, eyes, ears; then
    >>> rows += [(side * x, y) for x, y in sides for side in (1, -1)]
    >>> joints = np.array([(x, -y, 200) for x, y in rows]) / 100  # 2 m before the camera
    >>> person = modify.skeleton_from(joints, layout="coco")
    >>> wrist = person.positions[[6]]
    >>> further = modify.repose(wrist, person, gains={"ShoulderLeft": 3})
    >>> bool(further.vertices[0, 0] > wrist[0, 0] + 0.1)  # further from the body
    True
    """
    points = np.asarray(vertices)
    dtype: type[Any] = np.float32 if points.dtype == np.float32 else np.float64
    options = _core.ReposeOptions()
    options.gain = _by_joint(gains, options.gain, "gains")
    options.limit = _by_joint(
        {name: np.deg2rad(limit) for name, limit in (limits or {}).items()}, options.limit, "limits"
    )
    options.blended, options.band, options.num_threads = bool(blended), band, threads_of(threads)
    moved = _core.repose(rows(points, 3, dtype, "vertices"), skeleton, rest, options)
    return None if moved is None else Reposed(moved[0], Skeleton(**moved[1]))


def _by_joint(given: Mapping[str, float] | None, defaults: Any, name: str) -> list[float]:
    values = list(defaults)
    for joint, value in (given or {}).items():
        if joint not in POSABLE_JOINTS:
            known = ", ".join(POSABLE_JOINTS)
            raise InputError(f"{name}: expected one of {known}, got {joint!r}")
        values[JOINTS.index(joint)] = float(value)
    return values

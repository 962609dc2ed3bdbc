"""The meshes of the comparison and their targets."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from manip3d import InputError, Mesh, datasets, read_mesh


@dataclass(frozen=True)
class Model:
    """A mesh and how many faces it shall keep.

    Attributes
    ----------
    name : str
    load : callable () -> Mesh
    target_faces : int or None
        None: a tenth of the faces of the mesh as loaded.
    """

    name: str
    load: Callable[[], Mesh]
    target_faces: int | None = None

    def target(self, mesh: Mesh) -> int:
        """The number of faces to keep."""
        return mesh.num_faces // 10 if self.target_faces is None else self.target_faces


def _registered(stand_in: datasets.StandIn) -> Model:
    published = {"RockerArm": 8174, "Head": 1844}  # dissertation, tables 2.2 and 2.4
    target = published.get(stand_in.published) if stand_in.same_file else None
    cleaned = "" if stand_in.cleaning == "stored" else f" {stand_in.cleaning}"
    return Model(
        stand_in.mesh + cleaned,
        lambda: datasets.load_mesh(stand_in.mesh, cleaning=stand_in.cleaning),
        target,
    )


def _rotation(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """The matrix of a quaternion (x, y, z, w)."""
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    cross: NDArray[np.float64] = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix: NDArray[np.float64] = np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross
    return matrix


def happy_stand() -> Mesh:
    """The 15 range scans of the Happy Buddha beside each other: 2.1 million triangles.

    Each scan is triangulated on its pixel grid and placed as ``happyStandRight.conf`` says
    (``bmesh FILE tx ty tz qx qy qz qw``; the rotation is the inverse of the quaternion's).
    """
    root = datasets.data_root()
    if root is None:
        raise datasets.DataMissingError("range scans: $MANIP3D_DATA is not set")
    folder = root / "range_scans" / "happy_stand"
    vertices, faces, offset = [], [], 0
    for line in (folder / "happyStandRight.conf").read_text().splitlines():
        kind, *fields = line.split()
        if kind != "bmesh":
            continue
        scan = read_mesh(folder / f"{fields[0]}.xz")
        pose = np.array(fields[1:], dtype=float)
        vertices.append(scan.vertices @ _rotation(pose[3:]) + pose[:3])
        faces.append(scan.faces + offset)
        offset += scan.num_vertices
    return Mesh(np.concatenate(vertices), np.concatenate(faces))


_ALL = (*map(_registered, datasets.STAND_INS), Model("happy_stand", happy_stand))
MODELS: Mapping[str, Model] = {model.name: model for model in _ALL}


def get(name: str) -> Model:
    """The model of that name.

    Raises
    ------
    InputError
    """
    if name not in MODELS:
        raise InputError(f"model: expected one of {', '.join(MODELS)}, got {name!r}")
    return MODELS[name]

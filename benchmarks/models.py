"""Meshes of the comparison and their target numbers of faces."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from manip3d import InputError, Mesh, datasets, read_mesh


@dataclass(frozen=True)
class Model:
    """A mesh and the number of faces to keep.

    Attributes
    ----------
    name : str
    load : callable () -> Mesh
        Function that loads the mesh.
    target_faces : int or None
        Number of faces to keep; None: a tenth of the loaded mesh.
    """

    name: str
    load: Callable[[], Mesh]
    target_faces: int | None = None

    def target(self, mesh: Mesh) -> int:
        """Return the number of faces to keep."""
        return mesh.num_faces // 10 if self.target_faces is None else self.target_faces


def _registered(stand_in: datasets.StandIn) -> Model:
    published = {"RockerArm": 8174, "Head": 1844}  # from the dissertation's tables 2.2 and 2.4
    target = published.get(stand_in.published) if stand_in.same_file else None
    cleaned = "" if stand_in.cleaning == "stored" else f" {stand_in.cleaning}"
    return Model(
        stand_in.mesh + cleaned,
        lambda: datasets.load_mesh(stand_in.mesh, cleaning=stand_in.cleaning),
        target,
    )


def happy_stand() -> Mesh:
    """Return the 15 range scans of the Happy Buddha in one mesh of 2.1 million triangles.

    Each scan is triangulated on its pixel grid and placed by its pose in ``happyStandRight.conf``.
    The scans are not merged.
    """
    vertices, faces, offset = [], [], 0
    for name in datasets.scan_names("happy_stand"):
        pose = datasets.load_scan(name).pose
        scan = read_mesh(datasets.scan_path(name))
        vertices.append(scan.vertices @ pose[:3, :3].T + pose[:3, 3])
        faces.append(scan.faces + offset)
        offset += scan.num_vertices
    return Mesh(np.concatenate(vertices), np.concatenate(faces))


def _subdivide(
    vertices: NDArray[np.float64], faces: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Split each face into four, then move each vertex halfway to the mean of its neighbours.

    A neighbour counts once for each face that contains both vertices.
    """
    ends = np.sort(np.concatenate([faces[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    edges, number = np.unique(ends, axis=0, return_inverse=True)
    ab, bc, ca = number.reshape(3, -1) + len(vertices)
    a, b, c = faces.T
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    fine = np.concatenate([np.stack(corners, axis=1) for corners in quarters])
    points = np.concatenate([vertices, vertices[edges].mean(axis=1)])
    sums, count = np.zeros_like(points), np.bincount(fine.ravel(), minlength=len(points))
    for i in range(3):
        np.add.at(sums, fine[:, i], points[fine[:, (i + 1) % 3]])
    return 0.5 * points + 0.5 * sums / count[:, None], fine.astype(np.int32)


def relief(waves: int = 12, per_diagonal: float = 40.0, seed: int = 0) -> Mesh:
    """Return RockerArm subdivided to 1 285 664 faces (16 times as many), with waves on its surface.

    The waves displace vertices along the normals by 2e-4 of the diagonal (root mean square divided
    by sqrt(2)). Vertices and faces are sorted along a Morton curve, because meshoptimizer is slow
    on unsorted ones.
    """
    mesh = datasets.load_mesh("rockerArm")
    vertices, faces = mesh.vertices, mesh.faces
    for _ in range(2):
        vertices, faces = _subdivide(vertices, faces)
    p, q, r = (vertices[faces[:, i]] for i in range(3))
    normals = np.zeros_like(vertices)
    for i in range(3):
        np.add.at(normals, faces[:, i], np.cross(q - p, r - p))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    rng = np.random.default_rng(seed)
    height = np.zeros(len(vertices))
    for _ in range(waves):
        wave = rng.normal(size=3)
        wave *= 2 * np.pi * per_diagonal / (diagonal * np.linalg.norm(wave))
        height += np.sin(vertices @ wave + rng.uniform(0, 2 * np.pi))
    vertices = vertices + normals * (2e-4 * diagonal / np.sqrt(waves) * height)[:, None]
    cell = (vertices - vertices.min(axis=0)) / np.ptp(vertices, axis=0).max() * 1023
    code = np.zeros(len(vertices), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= (cell[:, axis].astype(np.int64) >> bit & 1) << (3 * bit + axis)
    order = np.argsort(code, kind="stable")
    rank = np.empty(len(order), dtype=np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    faces = rank[faces]
    return Mesh(vertices[order], faces[np.argsort(faces.min(axis=1), kind="stable")])


_ALL = (
    *map(_registered, datasets.STAND_INS),
    Model("happy_stand", happy_stand),
    Model("relief", relief),
    Model("rough relief", partial(relief, 24, 120.0, 1)),
)
MODELS: Mapping[str, Model] = {model.name: model for model in _ALL}

WILD = (
    "ExplodingBarrel.glb",
    "clothFolds.glb",
    "panel/panel.obj.xz",
    "m2000/m2000.obj.xz",
    "interior/interior.obj.xz",
    "HarleyDavidson/Harley-Davidson.obj.xz",
    "alligator.obj.xz",
    "woody.obj.xz",
    "beast.obj.xz",
    "igl_truck.obj.xz",
)
"""Files of ``meshes/wild`` in the data folder, on which the published method failed."""


def names_of_every_mesh() -> list[str]:
    """Return the names of all meshes of `every_mesh`, whether their files are here or not."""
    registered = [name for name, found in datasets.registry().items() if found.kind == "mesh"]
    return [*registered, *(Path(path).name.partition(".")[0] for path in WILD)]


def every_mesh() -> dict[str, Callable[[], Mesh]]:
    """Return the loaders of all available meshes of the data folder, by name."""
    loaders: dict[str, Callable[[], Mesh]] = {
        name: partial(datasets.load_mesh, name)
        for name, found in datasets.registry().items()
        if found.kind == "mesh" and datasets.is_here(found)
    }
    root = datasets.data_root()
    for path in WILD:
        if root is not None and (file := root / "meshes" / "wild" / path).exists():
            loaders[file.name.partition(".")[0]] = partial(read_mesh, file)
    return loaders


def get(name: str) -> Model:
    """Return the model of a name.

    Raises
    ------
    InputError
        There is no model of this name.
    """
    if name not in MODELS:
        raise InputError(f"model: expected one of {', '.join(MODELS)}, got {name!r}")
    return MODELS[name]

"""The meshes of the comparison and their targets."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

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


def happy_stand() -> Mesh:
    """The 15 range scans of the Happy Buddha beside each other: 2.1 million triangles.

    Each scan is triangulated on its pixel grid and placed as ``happyStandRight.conf`` says.
    """
    vertices, faces, offset = [], [], 0
    for name in datasets.scan_names("happy_stand"):
        pose = datasets.load_scan(name).pose
        scan = read_mesh(datasets.scan_path(name))
        vertices.append(scan.vertices @ pose[:3, :3].T + pose[:3, 3])
        faces.append(scan.faces + offset)
        offset += scan.num_vertices
    return Mesh(np.concatenate(vertices), np.concatenate(faces))


_ALL = (*map(_registered, datasets.STAND_INS), Model("happy_stand", happy_stand))
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
"""Files of ``meshes/wild`` in the data folder: on these the published method fell down."""


def every_mesh() -> dict[str, Callable[[], Mesh]]:
    """All meshes of the data folder that are here, the wild ones included: name -> loader."""
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
    """The model of that name.

    Raises
    ------
    InputError
    """
    if name not in MODELS:
        raise InputError(f"model: expected one of {', '.join(MODELS)}, got {name!r}")
    return MODELS[name]

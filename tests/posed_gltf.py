"""An arm of two joints with a morph target as glTF, and a reader of its own that poses it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gltf_files import Scene, glb_parts

RINGS, SIDES = 61, 24
SCALE = 100.0  # of the nodes above the joints: files in centimetres have such


def tube() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """A tube of radius 1 along z, from 0 to 10."""
    z, angle = np.meshgrid(np.linspace(0, 10, RINGS), np.arange(SIDES) / SIDES * 2 * np.pi)
    vertices = np.stack([np.cos(angle).T, np.sin(angle).T, z.T], axis=2).reshape(-1, 3)
    ring, side = (i.reshape(-1) for i in np.meshgrid(np.arange(RINGS - 1), np.arange(SIDES)))
    a, b = ring * SIDES + side, ring * SIDES + (side + 1) % SIDES
    return vertices, np.concatenate(
        [np.stack(f, 1) for f in ((a, b, a + SIDES), (b, b + SIDES, a + SIDES))]
    )


def elbow(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """(V,) share of the second joint: from 0 at z = 4 to 1 at z = 6."""
    return np.asarray(np.clip((vertices[:, 2] - 4.0) / 2.0, 0.0, 1.0))


def swelling(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """(V, 3) what the morph target adds: the lower end swells."""
    amount = np.clip(1.0 - vertices[:, 2] / 3.0, 0.0, None)
    return np.asarray(vertices * [1, 1, 0] * amount[:, None])


def arm(**changes: Any) -> Scene:
    """The tube, moved by two joints below a node that scales, and by a morph target."""
    vertices, faces = tube()
    share = elbow(vertices)
    none = np.zeros_like(share)
    made = Scene()
    bind = np.tile(np.eye(4), (2, 1, 1)) / SCALE
    bind[:, 3, 3] = 1.0
    bind[1, 2, 3] = -5.0 / SCALE
    attributes = {
        "POSITION": made.accessor(vertices),
        "JOINTS_0": made.accessor(np.tile([0, 1, 0, 0], (len(vertices), 1)), "u1"),
        "WEIGHTS_0": made.accessor(np.stack([1 - share, share, none, none], axis=1)),
    }
    made.primitive(
        attributes,
        indices=made.accessor(faces.reshape(-1), "u2"),
        targets=[{"POSITION": made.accessor(swelling(vertices))}],
    )
    matrices = made.accessor(bind.transpose(0, 2, 1).reshape(2, 16))
    times, weights = made.accessor([0, 1]), made.accessor([0, 1])
    made.json |= {
        "nodes": [
            {"name": "arm", "mesh": 0, "skin": 0},
            {"name": "armature", "scale": [SCALE] * 3, "children": [2]},
            {"name": "upper", "children": [3]},
            {"name": "lower", "translation": [0, 0, 5.0 / SCALE]},
        ],
        "skins": [{"joints": [2, 3], "inverseBindMatrices": matrices}],
        "animations": [
            {
                "samplers": [{"input": times, "output": weights}],
                "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}],
            }
        ],
    }
    made.json["meshes"][0]["extras"] = {"targetNames": ["swelling"]}
    made.json |= changes
    return made


class PosedGltf:
    """A GLB as its joints and morph targets show it; reads what it needs with numpy alone."""

    def __init__(self, path: Path) -> None:
        self.json, self._buffer = glb_parts(path.read_bytes())

    def _rows(self, view: int, dtype: str, columns: int, count: int) -> NDArray[Any]:
        start = self.json["bufferViews"][view].get("byteOffset", 0)
        rows = np.frombuffer(self._buffer, dtype, count * columns, start)
        return rows.reshape(count, columns)

    def accessor(self, index: int) -> NDArray[np.float64]:
        given = self.json["accessors"][index]
        dtype = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}[given["componentType"]]
        columns = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}[given["type"]]
        values = np.zeros((given["count"], columns))
        if "bufferView" in given:
            values[:] = self._rows(given["bufferView"], dtype, columns, given["count"])
        if sparse := given.get("sparse"):
            assert sparse["indices"]["componentType"] == 5125
            rows = self._rows(sparse["indices"]["bufferView"], "<u4", 1, sparse["count"])[:, 0]
            moved = self._rows(sparse["values"]["bufferView"], dtype, columns, sparse["count"])
            values[rows] = moved
        np.testing.assert_allclose(given.get("max", values.max(0)), values.max(0), atol=1e-6)
        np.testing.assert_allclose(given.get("min", values.min(0)), values.min(0), atol=1e-6)
        return values

    def posed(
        self, bend: float = 0.0, swollen: float = 0.0, node: int = 0
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Vertices and faces of the arm, the lower joint turned by `bend` (radians) about x."""
        shown = self.json["nodes"][node]
        (primitive,) = self.json["meshes"][shown["mesh"]]["primitives"]
        attributes = primitive["attributes"]
        (target,) = primitive["targets"]
        at = self.accessor(attributes["POSITION"]) + swollen * self.accessor(target["POSITION"])
        c, s = np.cos(bend), np.sin(bend)
        scale = np.diag([SCALE, SCALE, SCALE, 1.0])
        lower = np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 5.0 / SCALE], [0, 0, 0, 1]])
        bind = self.json["skins"][shown["skin"]]["inverseBindMatrices"]
        inverse = self.accessor(bind).reshape(-1, 4, 4).transpose(0, 2, 1)
        places = np.stack([scale @ inverse[0], scale @ lower @ inverse[1]])
        joints = self.accessor(attributes["JOINTS_0"]).astype(int)
        weights = self.accessor(attributes["WEIGHTS_0"])
        homogeneous = np.concatenate([at, np.ones((len(at), 1))], axis=1)
        moved = np.einsum("vj,vjik,vk->vi", weights, places[joints], homogeneous)[:, :3]
        return moved, self.accessor(primitive["indices"]).astype(int).reshape(-1, 3)

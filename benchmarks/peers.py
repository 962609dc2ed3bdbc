"""Simplification by several libraries under one signature: ``peer(mesh, target_faces) -> mesh``.

A peer works in three steps, so that only the library's own work is timed: `prepare` converts the
mesh to the library's representation, `run` simplifies it, and `finish` converts it back.
"""

from __future__ import annotations

import importlib
import json
import struct
import subprocess
import tempfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

import manip3d
from manip3d import Mesh
from measuring import Cost, measure

Placement = Literal["subset", "optimal"]
PROGRAMS = Path(__file__).parents[1] / "build" / "peers"


class NotInstalledError(Exception):
    """The peer is not installed."""


class RefusedError(Exception):
    """The peer cannot process this mesh; the message says why."""


@dataclass(frozen=True)
class Peer:
    """Simplification by a library.

    Attributes
    ----------
    name : str
    placement : 'subset' or 'optimal'
        Whether output vertices are input vertices, or are placed to minimise the error.
    texture : bool
        Whether the result has texture coordinates.
    measured : callable (mesh, target_faces) -> (mesh, Cost)
        Function that simplifies a mesh and measures the cost.
    """

    name: str
    placement: Placement
    texture: bool
    measured: Callable[[Mesh, int], tuple[Mesh, Cost]]

    def __call__(self, mesh: Mesh, target_faces: int) -> Mesh:
        """Simplify a mesh.

        Raises
        ------
        NotInstalledError
            The library is not installed.
        RefusedError
            The library cannot process this mesh.
        """
        return self.measured(mesh, target_faces)[0]


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise NotInstalledError(name) from error


def _python_peer(
    name: str,
    placement: Placement,
    prepare: Callable[[Mesh], Any],
    run: Callable[[Any, int], Any],
    finish: Callable[[Any, Mesh], Mesh],
    *,
    texture: bool = False,
) -> Peer:
    def measured(mesh: Mesh, target_faces: int) -> tuple[Mesh, Cost]:
        native = prepare(mesh)
        result, cost = measure(run, native, target_faces)
        return finish(result, mesh), cost

    return Peer(name, placement, texture, measured)


# --- manip3d ----------------------------------------------------------------------------------


def _manip3d(method: str, name: str, **options: Any) -> Peer:
    simplify = manip3d.simplify.METHODS[method]

    def finish(result: Any, _: Mesh) -> Mesh:
        if result.stop == manip3d.simplify.StopReason.REFUSED:
            raise RefusedError(result.message)
        mesh: Mesh = result.mesh
        return mesh

    return _python_peer(
        name,
        "subset",
        lambda mesh: mesh,
        lambda mesh, target: simplify(mesh, target_faces=target, **options),
        finish,
        texture=True,
    )


def _shape_only(mesh: Mesh) -> Mesh:
    """Return the mesh without texture coordinates and materials, which most peers do not accept."""
    return Mesh(mesh.vertices, mesh.faces)


def _mode(
    name: str,
    mode: manip3d.simplify.Mode,
    prepare: Callable[[Mesh], Mesh] = lambda mesh: mesh,
    *,
    texture: bool = True,
) -> Peer:
    return _python_peer(
        name,
        "optimal",
        prepare,
        lambda mesh, target: manip3d.simplify.simplify(mesh, mode, target_faces=target),
        lambda result, _: result.mesh,
        texture=texture,
    )


# --- PyMeshLab --------------------------------------------------------------------------------

_MESHLAB = {"qualitythr": 0.3, "boundaryweight": 1.0}


def _to_meshlab(mesh: Mesh) -> Any:
    pymeshlab = _module("pymeshlab")
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.faces))
    return meshes


def _from_meshlab(meshes: Any, _: Mesh) -> Mesh:
    result = meshes.current_mesh()
    return Mesh(result.vertex_matrix(), result.face_matrix())


def _png(pixel: bytes) -> bytes:
    """Return a PNG image of one RGB pixel."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    header = struct.pack(">IIBBBBB", 1, 1, 8, 2, 0, 0, 0)
    rows = zlib.compress(b"\0" + pixel)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")
    )


def _to_textured_meshlab(mesh: Mesh) -> Any:
    """Convert by a file with images, because MeshLab refuses coordinates without a texture."""
    pymeshlab = _module("pymeshlab")
    if mesh.face_texcoords is None:
        raise RefusedError("needs texture coordinates")
    material = _materials(mesh)
    images = tuple(
        manip3d.Material(
            name=f"m{i}", textures={"base_color": manip3d.Texture(data=_png(bytes((i, i, i))))}
        )
        for i in range(material.max() + 1)
    )
    meshes = pymeshlab.MeshSet()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "mesh.obj")
        mesh.replace(
            face_material=material, materials=images, normals=None, face_normals=None, source=None
        ).write(path)
        meshes.load_new_mesh(str(path))
    if not np.array_equal(meshes.current_mesh().face_matrix(), mesh.faces):
        raise RefusedError("its reader changed the faces")
    # Material of each face, and whether it has texture coordinates, as a number that the filter
    # preserves.
    look = 2 * material + (mesh.face_texcoords >= 0).all(axis=1)
    meshes.current_mesh().add_face_custom_scalar_attribute(look.astype(float), "look")
    return meshes


def _from_textured_meshlab(meshes: Any, original: Mesh) -> Mesh:
    result = meshes.current_mesh()
    faces = result.face_matrix()
    look = np.rint(result.face_custom_scalar_attribute_array("look")).astype(np.int32)
    face_texcoords = np.arange(faces.size, dtype=np.int32).reshape(-1, 3)
    face_texcoords[look % 2 == 0] = -1  # the filter sets (0, 0) for faces without coordinates
    return Mesh(
        result.vertex_matrix(),
        faces,
        texcoords=result.wedge_tex_coord_matrix(),
        face_texcoords=face_texcoords,
        face_material=look // 2,
        materials=original.materials,
    )


def _meshlab(name: str, placement: Placement, **options: Any) -> Peer:
    def run(meshes: Any, target_faces: int) -> Any:
        meshes.meshing_decimation_quadric_edge_collapse(
            targetfacenum=target_faces,
            optimalplacement=placement == "optimal",
            **_MESHLAB,
            **options,
        )
        return meshes

    return _python_peer(name, placement, _to_meshlab, run, _from_meshlab)


def _meshlab_texture(name: str, **options: Any) -> Peer:
    def run(meshes: Any, target_faces: int) -> Any:
        meshes.meshing_decimation_quadric_edge_collapse_with_texture(
            targetfacenum=target_faces, optimalplacement=False, **_MESHLAB, **options
        )
        return meshes

    return _python_peer(
        name,
        "subset",
        _to_textured_meshlab,
        run,
        _from_textured_meshlab,
        texture=True,
    )


def _materials(mesh: Mesh) -> NDArray[np.int32]:
    if mesh.face_material is None:
        return np.zeros(mesh.num_faces, dtype=np.int32)
    return mesh.face_material


# --- MeshLib, Open3D, VTK, fast-simplification, pyfqmr ----------------------------------------


def _to_meshlib(mesh: Mesh) -> Any:
    _module("meshlib.mrmeshpy")
    numpy_bridge = _module("meshlib.mrmeshnumpy")
    return numpy_bridge.meshFromFacesVerts(mesh.faces, mesh.vertices)


def _run_meshlib(native: Any, target_faces: int) -> Any:
    meshlib = _module("meshlib.mrmeshpy")
    settings = meshlib.DecimateSettings()
    settings.maxDeletedFaces = native.topology.numValidFaces() - target_faces
    settings.packMesh = True
    meshlib.decimateMesh(native, settings)
    return native


def _from_meshlib(native: Any, _: Mesh) -> Mesh:
    bridge = _module("meshlib.mrmeshnumpy")
    return Mesh(bridge.getNumpyVerts(native), bridge.getNumpyFaces(native.topology))


def _to_open3d(mesh: Mesh) -> Any:
    open3d = _module("open3d")
    return open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(mesh.vertices), open3d.utility.Vector3iVector(mesh.faces)
    )


def _from_open3d(native: Any, _: Mesh) -> Mesh:
    return Mesh(np.asarray(native.vertices), np.asarray(native.triangles))


def _to_vtk(mesh: Mesh) -> Any:
    data_model = _module("vtkmodules.vtkCommonDataModel")
    core = _module("vtkmodules.vtkCommonCore")
    to_vtk = _module("vtkmodules.util.numpy_support").numpy_to_vtk
    points = core.vtkPoints()
    points.SetData(to_vtk(mesh.vertices, deep=True))
    cells = data_model.vtkCellArray()
    cells.SetData(3, to_vtk(mesh.faces.ravel(), deep=True, array_type=core.VTK_INT))
    native = data_model.vtkPolyData()
    native.SetPoints(points)
    native.SetPolys(cells)
    return native


def _run_vtk(native: Any, target_faces: int) -> Any:
    decimation = _module("vtkmodules.vtkFiltersCore").vtkQuadricDecimation()
    decimation.SetInputData(native)
    decimation.SetTargetReduction(1.0 - target_faces / native.GetNumberOfPolys())
    decimation.Update()
    return decimation.GetOutput()


def _from_vtk(native: Any, _: Mesh) -> Mesh:
    to_numpy = _module("vtkmodules.util.numpy_support").vtk_to_numpy
    faces = to_numpy(native.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    return Mesh(to_numpy(native.GetPoints().GetData()), faces)


def _to_fast_simplification(mesh: Mesh) -> Any:
    return _module("fast_simplification"), mesh.vertices, mesh.faces


def _run_fast_simplification(native: Any, target_faces: int) -> Any:
    library, vertices, faces = native
    return library.simplify(vertices, faces, target_count=target_faces)


def _run_pyfqmr(native: Any, target_faces: int) -> Any:
    native.simplify_mesh(target_count=target_faces, verbose=0)
    return native.getMesh()[:2]


def _to_pyfqmr(mesh: Mesh) -> Any:
    simplifier = _module("pyfqmr").Simplify()
    simplifier.setMesh(mesh.vertices, mesh.faces)
    return simplifier


# --- The programs of benchmarks/cpp -----------------------------------------------------------


def _program_peer(
    name: str, placement: Placement, program: str, method: str, *, texture: bool = False
) -> Peer:
    def measured(mesh: Mesh, target_faces: int) -> tuple[Mesh, Cost]:
        path = PROGRAMS / program
        if not path.exists():
            raise NotInstalledError(program)
        with tempfile.TemporaryDirectory() as folder:
            source, output = Path(folder, "input.ply"), Path(folder, "output.ply")
            # Pass materials by name only, because textures would be copied but are not used.
            names = tuple(manip3d.Material(name=m.name) for m in mesh.materials)
            mesh.replace(materials=names, normals=None, face_normals=None).write(source)
            command = [str(path), method, str(source), str(target_faces), str(output)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode != 0:
                raise RefusedError(f"failed: {done.stderr.strip() or done.returncode}")
            report = json.loads(done.stdout)
            if "refused" in report:
                raise RefusedError(report["refused"])
            return manip3d.read_mesh(output), Cost(**report)

    return Peer(name, placement, texture, measured)


_ALL = (
    _mode("manip3d", "quality"),
    _mode("manip3d, shape only", "quality", _shape_only, texture=False),
    _mode("manip3d fast", "fast"),
    _manip3d("qem4vr", "manip3d QEM4VR"),
    _manip3d("qem-orig", "manip3d QEM_ORIG"),
    _manip3d("qem-bp", "manip3d QEM_BP"),
    _manip3d("qem-tp", "manip3d QEM_TP"),
    _manip3d("qem-btp", "manip3d QEM_BTP"),
    _meshlab("PyMeshLab subset", "subset"),
    _meshlab("PyMeshLab subset, boundary kept", "subset", preserveboundary=True),
    _meshlab("PyMeshLab optimal", "optimal"),
    _meshlab_texture("PyMeshLab texture"),
    _meshlab_texture("PyMeshLab texture, boundary kept", preserveboundary=True),
    _python_peer("MeshLib", "optimal", _to_meshlib, _run_meshlib, _from_meshlib),
    _python_peer(
        "Open3D",
        "optimal",
        _to_open3d,
        lambda native, target: native.simplify_quadric_decimation(target),
        _from_open3d,
    ),
    _python_peer("VTK", "optimal", _to_vtk, _run_vtk, _from_vtk),
    _python_peer(
        "fast-simplification",
        "optimal",
        _to_fast_simplification,
        _run_fast_simplification,
        lambda result, _: Mesh(*result),
    ),
    _python_peer("pyfqmr", "optimal", _to_pyfqmr, _run_pyfqmr, lambda result, _: Mesh(*result)),
    _program_peer("CGAL Garland-Heckbert", "optimal", "peer_cgal", "garland-heckbert"),
    _program_peer("CGAL Lindstrom-Turk", "optimal", "peer_cgal", "lindstrom-turk"),
    _program_peer("meshoptimizer subset", "subset", "peer_meshoptimizer", "subset"),
    _program_peer(
        "meshoptimizer attributes", "subset", "peer_meshoptimizer", "attributes", texture=True
    ),
    _program_peer("meshoptimizer update", "optimal", "peer_meshoptimizer", "update", texture=True),
)

PEERS: Mapping[str, Peer] = {peer.name: peer for peer in _ALL}

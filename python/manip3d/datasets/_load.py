"""Loading of the meshes of data sets, with the cleanings that experiments use."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from manip3d._util.checked import checked
from manip3d.datasets._registry import file_sha256, get, is_here, require
from manip3d.errors import InputError
from manip3d.io import read_mesh
from manip3d.mesh import Mesh

if TYPE_CHECKING:
    from numpy.typing import NDArray

Cleaning = Literal["stored", "welded", "any-unwelded", "any-welded"]

CLEANINGS: dict[str, str] = {
    "stored": "as stored",
    "welded": "welded, exact duplicates removed",
    "any-unwelded": "unwelded, one face of each coincident set kept",
    "any-welded": "welded, one face of each coincident set kept",
}
"""Names of the cleanings, and what each does. All except ``stored`` also remove unreferenced
vertices, and faces with a repeated index."""

_OPTIONS: dict[str, dict[str, Any]] = {
    "welded": {"weld": True, "duplicates": "same"},
    "any-unwelded": {"weld": False, "duplicates": "any"},
    "any-welded": {"weld": True, "duplicates": "any"},
}


@checked
def apply_cleaning(mesh: Mesh, cleaning: Cleaning) -> Mesh:
    """Return the mesh after one of `CLEANINGS`.

    Parameters
    ----------
    mesh : Mesh
        The mesh.
    cleaning : str
        One of `CLEANINGS`; ``stored`` changes nothing.

    Returns
    -------
    Mesh
        The cleaned mesh.

    Raises
    ------
    InputError
        ``cleaning`` is none of `CLEANINGS`.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Mesh, datasets
    >>> twice = np.vstack([np.eye(3), np.eye(3)])  # two triangles, and each vertex is there twice
    >>> mesh = Mesh(twice, [[0, 1, 2], [3, 5, 4]])
    >>> sorted(datasets.CLEANINGS), len(datasets.apply_cleaning(mesh, "welded").vertices)
    (['any-unwelded', 'any-welded', 'stored', 'welded'], 3)
    """
    if cleaning == "stored":
        return mesh
    from manip3d import simplify

    cleaned: Mesh = simplify.clean(mesh, **_OPTIONS[cleaning]).mesh
    return cleaned


def with_uv_only(mesh: Mesh) -> Mesh:
    """Return the mesh without faces that have a corner without a texture coordinate."""
    if mesh.face_texcoords is None:
        raise InputError("mesh: expected texture coordinates, got none")
    keep: NDArray[np.bool_] = np.all(mesh.face_texcoords >= 0, axis=1)
    per_face = ("faces", "face_texcoords", "face_normals", "face_material")
    kept = {name: getattr(mesh, name) for name in per_face}
    return mesh.replace(**{k: v[keep] for k, v in kept.items() if v is not None})


DERIVED: dict[str, tuple[str, Callable[[Mesh], Mesh]]] = {
    "BAe-125-uv": ("BAe-125", with_uv_only),
}
"""Derived meshes by name: the data set, and the function that is applied to its mesh."""


@checked
def source_of(name: str) -> str:
    """Return the name of the data set from which a mesh is derived; of others, the name itself.

    Parameters
    ----------
    name : str
        Name of a mesh. It is not looked up: `get` refuses names of no data set.

    Returns
    -------
    str
        Name of a data set; ``name`` if it is not the name of a derived mesh.

    Raises
    ------
    InputError
        ``name`` is not a str.

    Examples
    --------
    >>> from manip3d import datasets
    >>> datasets.source_of("BAe-125-uv"), datasets.source_of("spot")
    ('BAe-125', 'spot')
    """
    return DERIVED[name][0] if name in DERIVED else name


@checked
def load_mesh(name: str, *, cleaning: Cleaning = "stored") -> Mesh:
    """Open a registered mesh after verifying its checksum.

    Parameters
    ----------
    name : str
        A data set of kind ``mesh``, or a derived mesh (``BAe-125-uv``: BAe-125 without its 374
        faces that have no texture coordinates).
    cleaning : str
        One of `CLEANINGS`.

    Returns
    -------
    Mesh
        The mesh after the cleaning.

    Raises
    ------
    InputError
        ``name`` is no mesh, or ``cleaning`` is none of `CLEANINGS`.
    DataMissingError
        The file is not on this computer.
    ChecksumError
        The file has another SHA-256 than the registered one.

    Examples
    --------
    >>> from manip3d import datasets
    >>> len(datasets.load_mesh("spot").faces)  # doctest: +SKIP
    5856
    """
    data_set = get(source_of(name))
    if data_set.kind != "mesh":
        raise InputError(f"data set: expected a mesh, got {data_set.name!r} ({data_set.kind})")
    mesh = read_mesh(require(data_set.files[0], data_set.name))
    derive = DERIVED[name][1] if name in DERIVED else None
    return apply_cleaning(derive(mesh) if derive else mesh, cleaning)


@checked
def provenance(name: str) -> dict[str, Any]:
    """Return a record of a data set's origin, its licence and the checksums of its files.

    Parameters
    ----------
    name : str
        A data set, or a mesh derived from one.

    Returns
    -------
    dict
        ``name``, ``title``, ``origin``, ``page``, ``licence`` and ``files``. ``files`` has the
        SHA-256 of each file by its path in the data folder, and is empty if a file is missing on
        this computer.

    Raises
    ------
    InputError
        There is no such data set.
    ChecksumError
        A file has another SHA-256 than the registered one.

    Examples
    --------
    >>> from manip3d import datasets
    >>> sorted(datasets.provenance("spot"))
    ['files', 'licence', 'name', 'origin', 'page', 'title']
    """
    data_set = get(source_of(name))
    files = data_set.files if is_here(data_set) else ()
    return {
        "name": data_set.name,
        "title": data_set.title,
        "origin": data_set.origin,
        "page": data_set.page,
        "licence": data_set.licence,
        "files": {file.path: file_sha256(require(file, data_set.name)) for file in files},
    }

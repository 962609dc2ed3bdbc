"""Results folder: the row of each case is stored under the case's key and verified when read.

::

    DIR/cases/KEY.json       the row, with checksums of the row and of its files
    DIR/files/KEY-NAME.npz   meshes of the row; KEY-NAME.bin: other bytes
    DIR/results.json         everything, for the report
    DIR/results.csv          the rows
    DIR/figures, DIR/pictures
"""

from __future__ import annotations

import hashlib
import io
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.lib.npyio import NpzFile

from manip3d._util.archives import NPZ_ERRORS
from manip3d._util.checked import checked
from manip3d._util.json import sealed, unsealed
from manip3d.errors import InputError
from manip3d.experiments._model import Row
from manip3d.io._files import atomic_write
from manip3d.mesh import Mesh

_ARRAYS = (
    "vertices",
    "faces",
    "texcoords",
    "face_texcoords",
    "normals",
    "face_normals",
    "colors",
    "face_material",
)


@checked
def pack_mesh(mesh: Mesh) -> bytes:
    """Return a mesh's arrays as an npz archive, without the materials.

    Parameters
    ----------
    mesh : Mesh

    Returns
    -------
    bytes

    Raises
    ------
    InputError
        ``mesh`` is not a mesh.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Mesh
    >>> from manip3d.experiments import pack_mesh, unpack_mesh
    >>> mesh = Mesh(np.eye(3), [[0, 1, 2]])
    >>> unpack_mesh(pack_mesh(mesh), mesh).faces.tolist()
    [[0, 1, 2]]
    """
    stream = io.BytesIO()
    present = {name: getattr(mesh, name) for name in _ARRAYS}
    np.savez_compressed(stream, **{k: v for k, v in present.items() if v is not None})
    return stream.getvalue()


@checked
def unpack_mesh(data: bytes, like: Mesh) -> Mesh:
    """Return the mesh that `pack_mesh` packed, with the materials of ``like``.

    Parameters
    ----------
    data : bytes
        Result of `pack_mesh`.
    like : Mesh
        Mesh with the materials, such as the original of a simplified mesh.

    Returns
    -------
    Mesh

    Raises
    ------
    InputError
        An argument has another type, or ``data`` is damaged or holds no mesh.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Mesh
    >>> from manip3d.experiments import pack_mesh, unpack_mesh
    >>> mesh = Mesh(np.eye(3), [[0, 1, 2]])
    >>> unpack_mesh(pack_mesh(mesh), mesh).vertices.shape
    (3, 3)
    """
    try:
        archive = np.load(io.BytesIO(data), allow_pickle=False)
        if not isinstance(archive, NpzFile):
            raise TypeError("a single array")
        with archive:
            arrays = {name: archive[name] for name in _ARRAYS if name in archive}
    except NPZ_ERRORS as error:
        raise InputError(f"data: expected the bytes of pack_mesh, got others: {error}") from error
    if missing := {"vertices", "faces"} - set(arrays):
        raise InputError(f"data: expected arrays of a mesh, found no {', '.join(sorted(missing))}")
    return Mesh(**arrays, materials=like.materials, source=like.source)


@dataclass(frozen=True)
class Store:
    """The results folder of a run.

    Attributes
    ----------
    folder : Path
    overwrite : bool
        Load no rows, so that all are made again.
    """

    folder: Path
    overwrite: bool = False

    def save(self, key: str, row: Row) -> Row:
        """Store a case's row; meshes and bytes are written to files and replaced by their names.

        Parameters
        ----------
        key : str
            Key of the case.
        row : dict
            Result of the case.

        Returns
        -------
        dict
            The row that `load` will return.
        """
        plain, files = dict(row), {}
        for name, value in row.items():
            if isinstance(value, Mesh | bytes):
                data = pack_mesh(value) if isinstance(value, Mesh) else value
                relative = f"files/{key}-{name}.{'npz' if isinstance(value, Mesh) else 'bin'}"
                self.write(relative, data)
                files[relative] = hashlib.sha256(data).hexdigest()
                plain[name] = relative
        text = json.dumps(sealed({"key": key, "row": plain, "files": files}), indent=1)
        self.write(f"cases/{key}.json", text)
        stored: Row = json.loads(text)["row"]  # equal to what a resumed run reads, without tuples
        return stored

    def load(self, key: str) -> Row | None:
        """Return the stored row, or None if there is none, a byte has changed, or ``overwrite``.

        Parameters
        ----------
        key : str
            Key of the case.

        Returns
        -------
        dict or None
        """
        if self.overwrite:
            return None
        try:
            record = unsealed((self.folder / f"cases/{key}.json").read_bytes())
            if (
                record is None
                or record["key"] != key
                or not all(
                    hashlib.sha256((self.folder / name).read_bytes()).hexdigest() == digest
                    for name, digest in record["files"].items()
                )
            ):
                return None
        except (OSError, KeyError, TypeError, AttributeError):
            return None  # the file is not a stored row: the case runs again
        row: Row = record["row"]
        return row

    def write(self, name: str, data: str | bytes) -> Path:
        """Write a file of the results folder atomically.

        Parameters
        ----------
        name : str
            Path within the folder.
        data : str or bytes

        Returns
        -------
        Path
        """
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(path, data)
        return path

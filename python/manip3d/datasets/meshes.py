"""Registry entries of the public meshes of chapter 2's experiments and of the benchmarks.

``meshes.csv`` and ``companions.csv`` hold names, checksums, licences, sources, and counts that were
measured on the stored files: boundary and non-manifold edges as stored and welded (welding merges
vertices with bit-identical coordinates), where a polygon of n corners counts as n - 2 faces. The
meshes themselves are not part of the package.
"""

from __future__ import annotations

from pathlib import PurePosixPath

from manip3d.datasets._registry import DataFile, DataSet
from manip3d.datasets._tables import data_file, table

# Provided here because the OBJ refers to this file and its source does not contain it.
_HEAD_MTL = """\
# written for this copy; the OBJ names this file but the source repository does not ship it
newmtl defaultMat
Kd 1 1 1
map_Kd Map-COL.jpg
"""
_TEXTS = {"lee_perry_smith_head/Infinite-Level_02.mtl": _HEAD_MTL}

_FACTS = (
    "vertices",
    "faces",
    "polygons",
    "boundary_edges",
    "boundary_edges_welded",
    "non_manifold_edges",
    "non_manifold_edges_welded",
    "vertices_welded",
    "materials_used",
    "texcoords",
    "faces_without_uv",
    "multi_uv_vertices",
    "degenerate_faces",
    "duplicate_faces",
    "duplicate_faces_welded",
    "components_welded",
)


def _file(row: dict[str, str]) -> DataFile:
    return data_file("meshes", row, _TEXTS.get(row["path"], ""))


def _data_set(row: dict[str, str], companions: list[DataFile]) -> DataSet:
    main = _file(row)
    folder = PurePosixPath(main.path).parent
    beside = [file for file in companions if PurePosixPath(file.path).parent == folder]
    facts = {name: int(row[name]) for name in _FACTS} | {"closed": int(row["closed"] == "yes")}
    return DataSet(
        name=row["name"],
        title=row["title"],
        kind="mesh",
        files=(main, *beside),
        licence=row["licence"],
        origin=f"{row['origin']}; this copy: {row['copy']}",
        page=row["page"],
        facts=facts,
    )


def _data_sets() -> tuple[DataSet, ...]:
    companions = [_file(row) for row in table("companions.csv")]
    return tuple(_data_set(row, companions) for row in table("meshes.csv"))


DATA_SETS = _data_sets()

"""Writing of levels of detail: one glTF file with MSFT_lod, or a folder with a manifest."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from manip3d._util.checked import checked
from manip3d.errors import InputError
from manip3d.io._files import atomic_folder, refuse_other_files
from manip3d.io._mesh_files import write_gltf, write_mesh
from manip3d.io._scenes import Scene, write_scene
from manip3d.mesh import Mesh

_OWN_FILE = re.compile(r"level_\d+\.glb|lods\.json")


@checked
def write_lods(
    levels: Sequence[Mesh] | Sequence[Scene],
    path: str | os.PathLike[str],
    *,
    coverages: Sequence[float] | None = None,
    errors: Sequence[float] | None = None,
    error_measure: str = "",
    max_vertices: int | None = None,
    quantize: bool = False,
) -> None:
    """Write levels of detail: one ``.glb`` or ``.gltf``, or a folder with a GLB for each.

    Parameters
    ----------
    levels : sequence of Mesh or of Scene
        The levels, finest first, all with the same materials, or all of the same scene.
    path : path-like
        A file that ends in ``.glb`` or ``.gltf``, or a folder. The file uses the extension
        ``MSFT_lod``; readers without support for it show the finest level. The folder gets
        ``level_0.glb`` and so on, and a manifest ``lods.json`` with the name, faces, vertices,
        coverage and error of each level.
    coverages : sequence of float in [0, 1], optional
        Smallest share of the screen at which each level is shown, descending. Default: the next
        level is shown as soon as it has as many faces per pixel as the finest level has at full
        screen.
    errors : sequence of float, optional
        Error of each level, in the file's unit, for the manifest.
    error_measure : str
        Name of the measure of the errors, for the manifest.
    max_vertices : int, optional
        See `write_mesh`.
    quantize : bool
        See `write_mesh`, or `write_scene` for levels of a scene.

    Raises
    ------
    InputError
        There are no levels, the coverages or errors do not fit them, the suffix is another one, or
        `write_mesh` refuses a level.
    OSError
        The output cannot be written; an existing file or folder stays unchanged.

    Notes
    -----
    Levels of a scene keep its nodes (`write_scene`). The manifest then states the number of faces
    that are drawn (``faces``) and that are stored (``stored_faces``).

    Examples
    --------
    >>> from manip3d import io, simplify, simulate
    >>> chain = simplify.lod_chain(simulate.models.head(faces=2000), 3)
    >>> io.write_lods([level.mesh for level in chain.levels], "head.glb")
    >>> io.read_mesh("head.glb").num_faces
    1932
    """
    if not levels:
        raise InputError("levels: expected at least one, got none")
    scenes = [level for level in levels if isinstance(level, Scene)]
    meshes = [level for level in levels if isinstance(level, Mesh)]
    if coverages is None:
        counts = [level.num_faces for level in levels]
        if any(finer < coarser for finer, coarser in pairwise(counts)):
            raise InputError(f"levels: expected the finest first, got {counts} faces")
        coverages = [*(count / max(1, counts[0]) for count in counts[1:]), 0.0]
    shares = [float(share) for share in coverages]
    _check_shares(shares, len(levels))
    if errors is not None:
        errors = [float(error) for error in errors]
        if len(errors) != len(levels) or not all(map(math.isfinite, errors)):
            raise InputError(f"errors: expected {len(levels)} finite numbers, got {errors}")
    suffix = Path(path).suffix.lower()
    if suffix in (".glb", ".gltf"):
        if scenes:
            write_scene(
                scenes[0],
                path,
                coarser=scenes[1:],
                coverages=shares,
                max_vertices=max_vertices,
                quantize=quantize,
            )
        else:
            write_gltf(meshes, path, shares, max_vertices, quantize)
    elif suffix:
        raise InputError(
            f"path: expected .glb, .gltf or a folder's name without suffix, got {path}"
        )
    else:
        refuse_other_files(Path(path), is_file_of_lods)
        with atomic_folder(path) as folder:
            manifest = _write_folder(
                [*scenes, *meshes], folder, shares, errors, max_vertices, quantize
            )
            made: dict[str, Any] = {"levels": manifest}
            if errors is not None and error_measure:
                made = {"error_measure": error_measure, **made}
            (folder / "lods.json").write_text(json.dumps(made, indent=1) + "\n")


def _check_shares(shares: Sequence[float], num_levels: int) -> None:
    if len(shares) != num_levels or not all(0.0 <= share <= 1.0 for share in shares):
        raise InputError(f"coverages: expected {num_levels} numbers in [0, 1], got {shares}")
    if any(finer < coarser for finer, coarser in pairwise(shares)):
        raise InputError(f"coverages: expected them in descending order, got {shares}")


def is_file_of_lods(name: str) -> bool:
    """Return whether `write_lods` writes a file of this name into its folder."""
    return bool(_OWN_FILE.fullmatch(name))


def _write_folder(
    levels: Sequence[Mesh | Scene],
    folder: Path,
    coverages: Sequence[float],
    errors: Sequence[float] | None,
    max_vertices: int | None,
    quantize: bool,
) -> list[dict[str, str | float]]:
    manifest = []
    for i, (level, coverage) in enumerate(zip(levels, coverages, strict=True)):
        name = f"level_{i}.glb"
        entry: dict[str, str | float] = {
            "file": name,
            "faces": level.num_faces,
            "vertices": level.num_vertices,
            "screen_coverage": coverage,
        }
        if isinstance(level, Scene):
            write_scene(level, folder / name, max_vertices=max_vertices, quantize=quantize)
            entry["stored_faces"] = level.num_stored_faces
        else:
            write_mesh(level, folder / name, max_vertices=max_vertices, quantize=quantize)
        if errors is not None:
            entry["max_error"] = errors[i]
        manifest.append(entry)
    return manifest

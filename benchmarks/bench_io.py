"""Reading speed of OBJ and PLY compared with trimesh, Open3D and PyMeshLab, one thread.

``python benchmarks/bench_io.py [--rounds N]`` writes the section `reading` of the results.
"""

from __future__ import annotations

import argparse
import importlib
import lzma
import statistics
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from measuring import measure, one_thread

FILES = (
    ("rockerArm", "binary PLY"),
    ("bun_zipper", "ASCII PLY"),
    ("armadillo_86k", "OBJ, positions only"),
    ("CG-57", "OBJ, UVs, polygons, 19 materials"),
)
Reader = Callable[[Path], Any]


def _pymeshlab(path: Path) -> Any:
    meshes = importlib.import_module("pymeshlab").MeshSet()
    meshes.load_new_mesh(str(path))
    return meshes


def readers() -> dict[str, Reader]:
    """Return the readers of the libraries that are installed."""
    import manip3d

    found: dict[str, Reader] = {"manip3d": manip3d.read_mesh}
    others: dict[str, tuple[str, Callable[[Any], Reader]]] = {
        "trimesh": ("trimesh", lambda t: lambda path: t.load(path, process=False)),
        "Open3D": ("open3d", lambda o: lambda path: o.io.read_triangle_mesh(str(path))),
        "PyMeshLab": ("pymeshlab", lambda _: _pymeshlab),
    }
    for name, (module, reader) in others.items():
        try:
            found[name] = reader(importlib.import_module(module))
        except ImportError:
            continue
    return found


def unpacked(name: str, folder: Path) -> Path:
    """Write an uncompressed copy of a registered mesh, with material library but without images."""
    from manip3d import datasets

    data_set = datasets.get(name)
    mesh, *companions = [datasets.require(file, name) for file in data_set.files]
    target = folder / mesh.name.removesuffix(".xz")
    content = mesh.read_bytes()
    target.write_bytes(lzma.decompress(content) if mesh.suffix == ".xz" else content)
    for file in companions:
        if file.suffix == ".mtl":
            (folder / file.name).write_bytes(file.read_bytes())
    return target


def main() -> None:
    """Measure and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    one_thread()
    import tables

    known = readers()
    body = []
    for name, kind in FILES:
        with tempfile.TemporaryDirectory() as folder:
            path = unpacked(name, Path(folder))
            seconds: dict[str, list[float]] = {reader: [] for reader in known}
            for _ in range(rounds):
                for reader, read in known.items():
                    seconds[reader].append(measure(read, path)[1].cpu_s)
            megabytes = path.stat().st_size / 1e6
            speeds = [f"{megabytes / statistics.median(s):.0f}" for s in seconds.values()]
            body.append([f"{path.name} ({kind}, {megabytes:.1f} MB)", *speeds])
    tables.write_section("reading", tables.table(["MB/s", *known], body))


if __name__ == "__main__":
    main()

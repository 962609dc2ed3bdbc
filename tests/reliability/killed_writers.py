"""Kills writers at any moment, and looks at what they leave: ``python killed_writers.py KILLS``.

Each trial forks a process that writes two contents in turn to one place until it is killed. Every
file must then be one of the two, whole; after the next write to that folder nothing else is there.
Of a pair, the file that tells about the other may be missing, but never be that of another write.
"""

from __future__ import annotations

import json
import logging
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np

import exact_models
import kernels
import lattice_scans
from manip3d import LidarFrame, authenticate, experiments, forge, io, viewer
from manip3d.cli.forge import truth_of
from manip3d.io._files import atomic_folder, atomic_pair, atomic_path, atomic_write
from watermark_scans import grid_scan

Write = Callable[[Path, int], object]
"""Writes one of two contents into a folder."""

meshes = (exact_models.pipe(24, 8), exact_models.pipe(20, 12))
rng = np.random.default_rng(0)
scans = tuple(
    LidarFrame(
        (4 * rng.random((count, 3))).astype(np.float32), rng.random(count).astype(np.float32)
    )
    for count in (4000, 5000)
)
forged = tuple(forge.ctp(scan, scan.points[:9], position=(1, 1, 1)) for scan in scans)
lattices = (lattice_scans.lattice(), lattice_scans.lattice(32))


def _signed(*, with_picture: bool) -> tuple[authenticate.Watermarked, ...]:
    with tempfile.TemporaryDirectory() as place:
        marker = authenticate.Watermarker(authenticate.KeyFile.create(Path(place) / "a.key"))
    picture = np.full((128, 200), 128, np.uint8) if with_picture else None
    frames = (LidarFrame(grid_scan(2000, seed), np.zeros(2000, np.float32)) for seed in (0, 1))
    return tuple(marker.embed(frame, picture=picture) for frame in frames)


signed, carried = _signed(with_picture=False), _signed(with_picture=True)


def _folder(place: Path, which: int) -> None:
    with atomic_folder(place / "made") as new:
        for number in range(6):
            (new / f"{number}.txt").write_text(f"{which}" * 5000)


def _slowly(place: Path, which: int) -> None:
    with atomic_path(place / "a.png") as new, new.open("wb") as file:
        for _ in range(20):
            file.write(bytes([which]) * 1000)
            file.flush()


def _store(place: Path, which: int) -> None:
    experiments.Store(place).save("0" * 64, {"which": which, "text": "x" * 5000})


def _mesh(suffix: str) -> Write:
    return lambda place, which: meshes[which].write(place / f"a{suffix}")


def _scan(suffix: str) -> Write:
    return lambda place, which: io.write_scan(scans[which], place / f"a{suffix}")


def _page(place: Path, which: int) -> None:
    viewer.view(meshes[which], place / "a.html")


def _forged(place: Path, which: int) -> None:
    with atomic_pair(place / "a.bin", place / "a.bin.truth.json") as (scan, truth):
        forged[which].write(scan)
        truth.write_text(json.dumps(truth_of(forged[which], place / "a.bin")))


WRITERS: dict[str, Write] = {
    **{
        name: _mesh(name)
        for name in (".obj", ".obj.gz", ".ply", ".off.xz", ".stl", ".glb", ".gltf")
    },
    **{name: _scan(name) for name in (".pcd", ".bin", ".ply.gz", ".3d", ".xyz", ".npy")},
    **({name: _scan(name) for name in (".las", ".laz")} if find_spec("laspy") else {}),
    **({".e57": _scan(".e57")} if find_spec("pye57") else {}),
    "text": lambda place, which: atomic_write(place / "a.md", f"{which}" * 50_000),
    "forgery": lambda place, which: forged[which].write(place / "a.bin"),
    "lattice": lambda place, which: lattices[which].save(place / "a.json"),
    "page": _page,
    "result of an experiment": _store,
    "file by another library": _slowly,
    "folder": _folder,
    "scan and record": lambda place, which: authenticate.write_watermarked(
        signed[which], place / "a.bin"
    ),
    "scan and its picture": lambda place, which: authenticate.write_watermarked(
        carried[which], place / "a.bin"
    ),
    "forgery and its truth": _forged,
}

COMPANIONS = {
    "scan and record": "a.bin.wm",
    "scan and its picture": "a.bin.png",
    "forgery and its truth": "a.bin.truth.json",
}
"""The second file of each pair, which describes the first one."""


def contents(folder: Path) -> dict[str, object]:
    """Return the content of all files by name."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def gltf(folder: Path) -> dict[str, object]:
    """Return the mesh only: older buffers stay beside it, as an old file may name them."""
    return {"a.gltf": kernels.hash_of(io.read_mesh(folder / "a.gltf").replace(source=None))}


def e57(folder: Path) -> dict[str, object]:
    """Return the points only, since each file has a new identifier."""
    return {"a.e57": io.read_scan(folder / "a.e57").points.tobytes()}


LOOKS: dict[str, Callable[[Path], dict[str, object]]] = {".gltf": gltf, ".e57": e57}
"""Functions that compare results of writers whose bytes differ from write to write."""


def is_ours(name: str) -> bool:
    """Whether a name is a temporary one of a writer."""
    return any(part.startswith(".manip3d-") for part in Path(name).parts)


def killed(write: Write, folder: Path, seconds: float) -> None:
    """Write in a child process that is killed after so many seconds."""
    child = os.fork()
    if child == 0:
        try:
            which = 1
            while True:
                write(folder, which)
                which = 1 - which
        finally:
            os._exit(1)  # it should have been killed
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    assert os.WIFSIGNALED(os.waitpid(child, 0)[1]), "the writer failed"


def whole(name: str, which: int) -> dict[str, object]:
    """Return the result of an undisturbed writer."""
    with tempfile.TemporaryDirectory() as place:
        WRITERS[name](Path(place), which)
        return look(name, Path(place))


def look(name: str, folder: Path) -> dict[str, object]:
    """Return the results of a writer in a folder, without its temporary files."""
    if name in LOOKS:
        return LOOKS[name](folder)
    return {file: data for file, data in contents(folder).items() if not is_ours(file)}


def left_by(folder: Path) -> int:
    """Count temporary files and folders."""
    return sum(path.name.startswith(".manip3d-") for path in folder.rglob("*"))


def torn_and_left(name: str, kills: int) -> tuple[int, int]:
    """Count torn or missing files, and temporary files that outlive the next write."""
    write, chance = WRITERS[name], random.Random(name)
    expected = [whole(name, 0), whole(name, 1)]
    begin = time.perf_counter()
    whole(name, 0)
    longest = 3 * (time.perf_counter() - begin)  # so that each moment of a write is hit
    torn = left = litter = 0
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        write(folder, 0)
        for _ in range(kills):
            killed(write, folder, chance.uniform(0.0, longest))
            found = look(name, folder)
            litter += left_by(folder) > 0
            companion = COMPANIONS.get(name)
            needed = (set(expected[0]) & set(expected[1])) - {companion}
            torn += len(needed - set(found))
            torn += companion in found and found not in expected
            torn += sum(data not in [e.get(file) for e in expected] for file, data in found.items())
            write(folder, 0)
            left += left_by(folder)
    print(f"{name:24} {kills:5} kills {litter:5} with litter, {torn} torn, {left} left", flush=True)
    return torn, left


def main() -> int:
    """Share the kills among the writers."""
    logging.getLogger("manip3d").setLevel(logging.ERROR)  # what formats cannot hold
    share = -(-int(sys.argv[1]) // len(WRITERS))
    results = [torn_and_left(name, share) for name in WRITERS]
    return int(any(torn or left for torn, left in results))


if __name__ == "__main__":
    sys.exit(main())

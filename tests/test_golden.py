"""The same input gives the same bits: on every machine, in every run, for any number of threads.

Each case is kept as one hash over everything it returns. After an intended change,
``pytest -m golden --update-golden`` writes the hashes anew; say in the commit why they changed.
"""

from __future__ import annotations

import dataclasses
import hashlib
import tempfile
from collections.abc import Callable
from enum import Enum
from pathlib import Path

import numpy as np
import pytest

import capsule_body
import exact_models as models
import lattice_scans
import velodyne_packets
from manip3d import (
    Box,
    Intrinsics,
    Mesh,
    Registration,
    _core,
    authenticate,
    capture,
    forge,
    metrics,
    modify,
    simplify,
)

pytestmark = pytest.mark.golden

Case = Callable[[int], object]


_LATER = {
    "distance_bound": None,
    "emissive": (0.0, 0.0, 0.0),
    "cloth": 0.0,
    "hidden": 0.0,
    "stray": 0.0,
    "outside": 0.0,
    "chose": True,
    "outside_charts": 0.0,
    "unsure_pixels": 0,
}
"""Fields that were added after the hashes were made; they are left out at these values."""


def feed(digest: hashlib._Hash, value: object) -> None:
    """Add a value to the hash: arrays with type and shape, results field by field."""
    if isinstance(value, np.ndarray):
        digest.update(f"{value.dtype.str}{value.shape}".encode())
        digest.update(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, Mesh):
        for name in value.__slots__:
            feed(digest, getattr(value, name))
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        for field in dataclasses.fields(value):
            member = getattr(value, field.name)
            if not (
                field.name.startswith("_")
                or (field.name in _LATER and member == _LATER[field.name])
            ):
                feed(digest, member)
    elif isinstance(value, dict):
        feed(digest, sorted(value.items()))
    elif isinstance(value, tuple | list):
        digest.update(f"{len(value)}".encode())
        for item in value:
            feed(digest, item)
    elif isinstance(value, Enum):
        feed(digest, value.value)
    elif isinstance(value, float):
        digest.update(value.hex().encode())
    else:
        assert value is None or isinstance(value, str | bytes | int), type(value)
        digest.update(repr(value).encode())


def halved(mesh: Mesh) -> Mesh:
    """Return a coarser mesh to measure against, with every other vertex on its predecessor."""
    return mesh.replace(faces=mesh.faces // 2 * 2)


def written(mesh: Mesh, suffix: str) -> list[bytes]:
    """Return the bytes of the written files, in the order of their names."""
    with tempfile.TemporaryDirectory() as folder:
        mesh.write(Path(folder) / f"mesh{suffix}")
        return [path.read_bytes() for path in sorted(Path(folder).iterdir())]


_NEWER = ("down", "down_source")
"""Fields of a phantom that came after the hashes were made; their values need libm."""

_TRUSTED = ("quality", "plane", "color", "phantom_color")
"""Fields of a phantom that the published method does not have."""


def phantom(
    limb: modify.Limb,
    mode: modify.MirrorMode,
    segmentation: modify.Segmentation = "skin",
    plane: modify.PlaneRule = "joints",
) -> list[object]:
    """Return all but the times of three frames; in the third the intact limb is hidden."""
    pipeline = modify.PhantomPipeline(limb, mode=mode, segmentation=segmentation, plane=plane)
    kept: list[object] = []
    for number in range(3):
        result = pipeline.process(capsule_body.painted(number, hidden=number == 2))
        fields = {f.name: getattr(result, f.name) for f in dataclasses.fields(result)}
        left_out = {"seconds", *_NEWER} if plane == "trunk" else {"seconds", *_NEWER, *_TRUSTED}
        kept.append({name: value for name, value in fields.items() if name not in left_out})
    return kept


def velodyne(model: str) -> list[object]:
    """Return every column of every frame of a recording."""
    own = velodyne_packets.plain_calibration() if model == "hdl64e" else None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "r.pcap"
        path.write_bytes(velodyne_packets.whole_recording(model))
        frames = list(capture.open(f"pcap:{path}", calibration=own))
    return [[f.points, f.intensity, f.ring, dict(f.fields)] for f in frames]


# Meshes are small: a case that is wrong in one bit is wrong at any size.
hill, ball, pipe, floor, soup = (
    models.hill(),
    simplify.clean(models.ball()).mesh,
    models.pipe(),
    models.floor(),
    models.soup(),
)


def forgery() -> np.ndarray:
    """Return a scan with points moved off the lattice and others taken away."""
    points = lattice_scans.scan(np.random.default_rng(0))
    points[20_000:20_300] += np.float32(0.01)
    return np.delete(points, slice(70_000, 71_000), axis=0)


scanner, forged_scan = lattice_scans.lattice(), forgery()
nothing = np.zeros((0, 3), np.float32)

# In whole millimetres: waves from libm would differ in the last bits between CPUs.
V, U = np.mgrid[0:90, 0:120]
DEPTH = (
    1200 + ((U - 60) ** 2 + (V - 45) ** 2) // 20 + np.random.default_rng(0).integers(0, 4, U.shape)
)
DEPTH = np.where((U - 60) ** 2 + (V - 45) ** 2 < 1900, DEPTH, 0).astype(np.uint16)
CAMERA = Intrinsics(120, 90, 110.0, 110.0, 59.5, 44.5, distortion=(0.1, -0.05, 0.001, 0.001, 0.0))


def depth_mesh(mesh: simplify.DepthMesh) -> list[object]:
    """Return the arrays of a depth mesh, without the seconds it took."""
    return [mesh.vertices, mesh.faces, mesh.pixels, mesh.texcoords]


# Whole numbers over 512: no sine of NumPy's, whose last bits differ between CPUs.
cloud = (np.random.default_rng(1).integers(-8192, 8192, (12_000, 3)) / 512).astype(np.float32)
hoax = (np.random.default_rng(2).integers(-512, 512, (2_000, 3)) / 512).astype(np.float32)
box = Box((4.0, 1.0, 0.0), (6.0, 5.0, 4.0), 0.5)
rings = forge.Lattice([[k / 64, 0.125] for k in range(-24, 8)], 2**-8)


def truth(forged: forge.Forgery) -> tuple[object, ...]:
    """Return all results of an attack."""
    place = (forged.box.center, forged.box.size, forged.transform)
    return (forged.points, forged.added, forged.moved, forged.moved_from, forged.removed, place)


def judged(threads: int) -> tuple[object, ...]:
    """Run both detectors on a cloud with a dense heap in it."""
    points = np.concatenate([cloud, hoax * np.float32(0.25) + np.float32([4, 1, 0])])
    first = authenticate.density_consistency(points, threads=threads)
    grid = authenticate.AngularGrid(2.0, 2.0)
    second = authenticate.occlusion_consistency(points, grid=grid, threads=threads)
    return (first.signal, first.fit, first.suspected, first.verdict, second.mask, second.suspected)


CASES: dict[str, Case] = {
    "dense mesh": lambda threads: depth_mesh(
        simplify.dense_mesh(DEPTH, CAMERA, registration=Registration(CAMERA), threads=threads)
    ),
    **{
        f"cs3 {variant}": lambda threads, variant=variant: depth_mesh(
            simplify.cs3(DEPTH, CAMERA, 250, variant=variant, threads=threads)
        )
        for variant in ("cios", "lios", "cnms", "lnms")
    },
    "cs3 distance dependent": lambda threads: depth_mesh(
        simplify.cs3(DEPTH, CAMERA, 250, distance_dependent=True, max_edge=0.1, threads=threads)
    ),
    "summary soup": lambda _: soup.summary(),
    "summary pipe": lambda _: pipe.summary(),
    "clean soup same": lambda _: simplify.clean(soup),
    "clean soup any": lambda _: simplify.clean(soup, duplicates="any"),
    "clean soup keep": lambda _: simplify.clean(soup, duplicates="keep"),
    "clean soup unwelded": lambda _: simplify.clean(soup, weld=False),
    "clean ball": lambda _: simplify.clean(models.ball()),
    "qem4vr hill": lambda _: simplify.qem4vr(hill, ratio=0.1),
    "qem4vr ball": lambda _: simplify.qem4vr(ball, ratio=0.1),
    "qem4vr pipe": lambda _: simplify.qem4vr(pipe, ratio=0.1),
    "qem4vr floor": lambda _: simplify.qem4vr(floor, ratio=0.1),
    "qem4vr soup": lambda _: simplify.qem4vr(soup, ratio=0.3),
    "qem4vr error limit": lambda _: simplify.qem4vr(hill, max_error=0.01),
    "qem4vr pipe paper": lambda _: simplify.qem4vr(
        pipe, ratio=0.1, curvature="paper", seam_mode="paper"
    ),
    "qem4vr floor lock": lambda _: simplify.qem4vr(floor, ratio=0.1, seam_mode="lock"),
    "qem4vr quality": lambda _: simplify.qem4vr(hill, ratio=0.1, quality_threshold=0.3),
    "qem_orig ball": lambda _: simplify.qem_orig(ball, ratio=0.1),
    "qem_orig hill": lambda _: simplify.qem_orig(hill, ratio=0.1),
    "qem_bp hill freeze": lambda _: simplify.qem_bp(hill, ratio=0.1),
    "qem_bp hill weight": lambda _: simplify.qem_bp(hill, ratio=0.1, boundary="weight"),
    "qem_tp pipe": lambda _: simplify.qem_tp(pipe, ratio=0.1),
    "qem_btp pipe": lambda _: simplify.qem_btp(pipe, ratio=0.1),
    "qem_tp floor refused": lambda _: simplify.qem_tp(floor, ratio=0.1),
    "level of detail": lambda _: simplify.qem4vr(hill, ratio=0.05).level_of_detail(300),
    "closest points": lambda threads: metrics.closest_points(ball, hill.vertices, threads=threads),
    "metro hill vertex": lambda threads: metrics.metro(hill, halved(hill), threads=threads),
    "metro hill area": lambda threads: metrics.metro(
        hill, halved(hill), sampling="area", threads=threads
    ),
    "metro soup area": lambda threads: metrics.metro(
        soup, halved(soup), sampling="area", rng=7, threads=threads
    ),
    "texture error pipe": lambda threads: metrics.texture_error(
        pipe, halved(pipe), samples=5000, threads=threads
    ),
    "texture error floor": lambda threads: metrics.texture_error(
        floor, halved(floor), samples=5000, threads=threads
    ),
    "boundary gap pipe": lambda threads: metrics.boundary_gap(pipe, halved(pipe), threads=threads),
    "boundary gap soup": lambda threads: metrics.boundary_gap(
        soup, halved(soup), weld=False, threads=threads
    ),
    "nearest distances": lambda threads: metrics.nearest_distances(cloud, threads=threads),
    "nearest distances tree": lambda threads: metrics.nearest_distances(
        cloud, origin=None, threads=threads
    ),
    "forge ctp": lambda threads: truth(
        forge.ctp(cloud, hoax, position=(4, 1, 0), rotation=0.7, scale=0.5, threads=threads)
    ),
    "forge crtp": lambda threads: truth(
        forge.crtp(cloud, hoax, position=(4, 1, 0), spacing=0.2, rng=3, threads=threads)
    ),
    "forge crtp finer": lambda threads: truth(
        forge.crtp(cloud, hoax, position=(4, 1, 0), spacing=0.05, rng=3, threads=threads)
    ),
    "forge deform": lambda threads: truth(
        forge.deform(cloud, box, amplitude=0.2, rng=3, threads=threads)
    ),
    "forge insert": lambda threads: truth(
        forge.insert_occluding(
            cloud, hoax, position=(6, 1, 0), lattice=rings, range_noise=0.01, threads=threads
        )
    ),
    "forge snap": lambda threads: truth(
        forge.snap_to_lattice(
            forge.ctp(cloud, hoax, position=(4, 1, 0)), rings, along="ray", threads=threads
        )
    ),
    "forge rotation": lambda threads: truth(
        forge.rotation(cloud, box, allow_collision=True, threads=threads)
    ),
    "forge segments": lambda _: forge.segment(cloud).label,
    "detectors of chapter 6": judged,
    "lattice reading": lambda threads: scanner.read(forged_scan, threads=threads),
    "generic consistency": lambda threads: _core.generic_consistency(
        forged_scan,
        scanner.table,
        4000,
        0.002,
        0.001,
        0.002,
        0.12,
        0.0,
        forged_scan[::-1].copy(),
        np.zeros((0, 3), np.float32),
        threads,
    ),
    **{
        f"velodyne {model}": lambda _, model=model: velodyne(model)
        for model in ("hdl64e", "hdl32e", "vlp16", "vlp32c")
    },
    "phantom arm": lambda _: phantom("right_arm", "reflection"),
    "phantom arm by the trunk": lambda _: phantom("right_arm", "reflection", plane="trunk"),
    "phantom leg": lambda _: phantom("left_leg", "paper"),
    "phantom arm by eq. 4.1": lambda _: phantom("left_arm", "reflection", "paper"),
    "write obj": lambda _: written(pipe, ".obj"),
    "write ply": lambda _: written(pipe, ".ply"),
    "write off": lambda _: written(floor, ".off"),
    "write stl": lambda _: written(pipe, ".stl"),
    "write glb": lambda _: written(floor, ".glb"),
    "write gltf": lambda _: written(pipe, ".gltf"),
}


@pytest.mark.parametrize("threads", [1, 2, 4])
@pytest.mark.parametrize("name", CASES)
def test_same_bits(name: str, threads: int, golden: Callable[[str, object], None]) -> None:
    digest = hashlib.sha256()
    feed(digest, CASES[name](threads))
    golden(name, digest.hexdigest())


@pytest.mark.parametrize("mesh", [hill, ball], ids=["hill", "ball"])
def test_fmpd_to_twelve_digits(mesh: Mesh, golden: Callable[..., None]) -> None:
    """FMPD is only compared to 12 digits, because libm differs in the last bits between CPUs."""
    results = [metrics.fmpd(mesh, halved(mesh), threads=threads) for threads in (1, 2, 4)]
    assert results[0] == results[1] == results[2]
    golden(
        f"fmpd {mesh.num_faces} faces",
        [results[0].roughness_original, results[0].roughness_simplified],
        rel=1e-12,
    )

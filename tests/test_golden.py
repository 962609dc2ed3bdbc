"""The same input gives the same bits: on every machine, in every run, for any number of threads.

Each case is kept as one hash over everything it returns. After an intended change,
``pytest -m golden --update-golden`` writes the hashes anew; say in the commit why they changed.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable
from enum import Enum

import numpy as np
import pytest

import exact_models as models
from manip3d import Mesh, metrics, simplify

pytestmark = pytest.mark.golden

Case = Callable[[int], object]


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
            feed(digest, getattr(value, field.name))
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
    """A coarser mesh to measure against: every other vertex moved onto its predecessor."""
    return mesh.replace(faces=mesh.faces // 2 * 2)


CASES: dict[str, Case] = {
    "summary soup": lambda _: models.soup().summary(),
    "summary pipe": lambda _: models.pipe().summary(),
    "clean soup same": lambda _: simplify.clean(models.soup()),
    "clean soup any": lambda _: simplify.clean(models.soup(), duplicates="any"),
    "clean soup keep": lambda _: simplify.clean(models.soup(), duplicates="keep"),
    "clean soup unwelded": lambda _: simplify.clean(models.soup(), weld=False),
    "clean ball": lambda _: simplify.clean(models.ball()),
    "closest points": lambda threads: metrics.closest_points(
        models.ball(), models.hill().vertices, threads=threads
    ),
    "metro hill vertex": lambda threads: metrics.metro(
        models.hill(), halved(models.hill()), threads=threads
    ),
    "metro hill area": lambda threads: metrics.metro(
        models.hill(), halved(models.hill()), sampling="area", threads=threads
    ),
    "metro soup area": lambda threads: metrics.metro(
        models.soup(), halved(models.soup()), sampling="area", rng=7, threads=threads
    ),
    "texture error pipe": lambda threads: metrics.texture_error(
        models.pipe(), halved(models.pipe()), samples=5000, threads=threads
    ),
    "texture error floor": lambda threads: metrics.texture_error(
        models.floor(), halved(models.floor()), samples=5000, threads=threads
    ),
    "boundary gap pipe": lambda threads: metrics.boundary_gap(
        models.pipe(), halved(models.pipe()), threads=threads
    ),
    "boundary gap soup": lambda threads: metrics.boundary_gap(
        models.soup(), halved(models.soup()), weld=False, threads=threads
    ),
}


@pytest.mark.parametrize("threads", [1, 2, 4])
@pytest.mark.parametrize("name", CASES)
def test_same_bits(name: str, threads: int, golden: Callable[[str, object], None]) -> None:
    digest = hashlib.sha256()
    feed(digest, CASES[name](threads))
    golden(name, digest.hexdigest())

"""`metrics.compare` is its parts, and says how far it is."""

from __future__ import annotations

import numpy as np
import pytest

from manip3d import Mesh, metrics
from manip3d.metrics import _compare


def meshes() -> tuple[Mesh, Mesh]:
    """A bent strip of 2 x 20 cells, and one of 2 x 5."""

    def strip(cells: int) -> Mesh:
        x = np.linspace(0.0, 3.0, cells + 1)
        rows = [np.stack([x, np.full_like(x, y), np.sin(x)], -1) for y in (0.0, 1.0)]
        near, far = np.arange(cells), np.arange(cells) + cells + 1
        faces = np.vstack(
            [np.stack([near, near + 1, far], -1), np.stack([near + 1, far + 1, far], -1)]
        )
        return Mesh(np.vstack(rows), faces)

    return strip(20), strip(5)


def test_it_is_its_parts() -> None:
    original, light = meshes()
    found = metrics.compare(original, light, rng=3)
    assert found.faces == (40, 10)
    assert found.metro_vertex == metrics.metro(original, light)
    assert found.metro_area == metrics.metro(original, light, sampling="area", rng=3)
    assert found.fmpd == metrics.fmpd(original, light)
    assert found.boundary_gap == metrics.boundary_gap(original, light)
    assert found.texture_error is None
    assert found.metro_vertex.max > 0


def test_progress_grows_to_one() -> None:
    told: list[float] = []
    metrics.compare(*meshes(), progress=lambda fraction, message: told.append(fraction))
    assert told == sorted(told)
    assert told[-1] == 1.0
    assert len(set(told)) >= 5


def test_all_parts_use_as_many_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    used: dict[str, int] = {}
    for name in ("metro", "fmpd", "boundary_gap"):
        part = getattr(_compare, name)

        def spied(*meshes: Mesh, name: str = name, part: object = part, **options: object):
            used[name] = options["threads"]
            return part(*meshes, **options)

        monkeypatch.setattr(_compare, name, spied)
    metrics.compare(*meshes(), threads=1)
    assert used == {"metro": 1, "fmpd": 1, "boundary_gap": 1}

"""The tables of the benchmarks: what a part of the measurements may say."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
ROW = {"mesh": "a", "ratio": 0.5, "target": 500, "faces": 500, "area": 1e-5, "cpu_s": 0.1,
       "status": "ok", "has_uv": False, "keeps_uv": True}  # fmt: skip
ENVIRONMENT = {"cpu": "", "cores": 2, "memory_gib": 1, "system": "", "python": "", "versions": {}}


@pytest.fixture(scope="module")
def tables() -> dict[str, Any]:
    if not BENCHMARKS.is_dir():
        pytest.skip("the benchmarks are not here")
    return runpy.run_path(str(BENCHMARKS / "tables.py"))


def test_an_aim_without_a_case_is_neither_met_nor_missed(tables: dict[str, Any]) -> None:
    """A run of one mesh without peers said of 0 of 0 cases that the aim does not hold."""
    results = {"environment": ENVIRONMENT, "rows": [ROW | {"peer": tables["OURS"]}]}
    text = tables["every_mesh"](results)
    assert "does not hold" not in text
    assert "0 of 0, " not in text
    assert "| UV error at most the best peer's: 90 % | – | – |" in text
    assert "1 of 1, 100.0 % | holds |" in text


def test_results_of_some_meshes_are_not_those_of_every_mesh(tables: dict[str, Any]) -> None:
    """A run of one mesh replaced the tables of all of them."""
    peers = tables["EVERY_MESH_PEERS"]
    rows = [ROW | {"peer": peer} for peer in peers]
    missing = tables["missing_of_every_mesh"]
    assert missing({"rows": rows}, ["a"]) == []
    assert missing({"rows": rows}, ["a", "b"]) == ["b"]
    assert missing({"rows": rows[:-1]}, ["a"]) == ["a"]

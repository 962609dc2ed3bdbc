"""``manip3d info``: what a mesh or a depth image is made of."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from manip3d.cli.sources import open_mesh
from manip3d.cli.terminal import Terminal, count, table

if TYPE_CHECKING:
    from rich.console import Console


_LABELS = {
    "non_manifold_edges": "non-manifold edges",
    "zero_area_faces": "zero-area faces",
    "texcoords": "texture coordinates",
    "faces_without_uv": "faces without UV",
    "multi_uv_vertices": "multi-UV vertices",
}


def summary(source: str, terminal: Terminal) -> dict[str, Any]:
    """All counts of the mesh, its materials and their textures."""
    mesh = open_mesh(source, terminal)
    materials = [
        {"name": m.name, "textures": {role: t.path for role, t in m.textures.items()}}
        for m in mesh.materials
    ]
    return {"file": source} | asdict(mesh.summary()) | {"materials": materials}


def show(console: Console, record: dict[str, Any]) -> None:
    """The counts, as stored beside welded where both exist."""
    rows = []
    for name, value in record.items():
        if name.endswith("_welded") or not isinstance(value, int):
            continue
        welded = record.get(f"{name}_welded")
        rows.append(
            (
                _LABELS.get(name, name.replace("_", " ")),
                _cell(value),
                "" if welded is None else _cell(welded),
            )
        )
    table(console, rows, (PurePath(record["file"]).name, "as stored", "welded"))
    low, high = record["bounds"]
    console.print(
        "bounds  " + "  ".join(f"{a:.6g}..{b:.6g}" for a, b in zip(low, high, strict=True))
    )
    for material in record["materials"]:
        textures = ", ".join(path for path in material["textures"].values() if path)
        console.print(f"material  {material['name']}{'  ' + textures if textures else ''}")


def _cell(value: int) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return count(value)


def depth_summary(source: str, units_per_metre: float | None) -> dict[str, Any]:
    """Size, unit, measured pixels and distances of a depth image."""
    import numpy as np

    from manip3d.io import read_depth

    stored = read_depth(source)
    unit = (units_per_metre or 1000.0) if stored.dtype == np.uint16 else 1.0
    metres = stored / unit
    measured = metres[np.isfinite(metres) & (metres > 0.0)]
    distances = np.percentile(measured, [0.0, 50.0, 100.0]).tolist() if measured.size else None
    return {
        "file": source,
        "width": stored.shape[1],
        "height": stored.shape[0],
        "units_per_metre": unit,
        "measured": int(measured.size),
        "pixels": int(stored.size),
        "range": distances and [distances[0], distances[2]],
        "median": distances and distances[1],
    }


def show_depth(console: Console, record: dict[str, Any]) -> None:
    """The image, its unit, and how far away things are."""
    console.print(f"depth   {record['width']} x {record['height']} pixels")
    share = record["measured"] / record["pixels"]
    console.print(f"measured  {count(record['measured'])} pixels, {share:.0%} of all")
    if record["range"] is not None:
        near, far = record["range"]
        console.print(f"range   {near:.3f}..{far:.3f} m, median {record['median']:.3f} m")
    console.print(f"unit    {record['units_per_metre']:g} per metre")

"""Summaries of meshes and depth images, for ``manip3d info``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from manip3d.cli.sources import open_mesh
from manip3d.cli.terminal import Terminal, count, table

if TYPE_CHECKING:
    from rich.console import Console

    from manip3d.mesh import Texture


_LABELS = {
    "non_manifold_edges": "non-manifold edges",
    "zero_area_faces": "zero-area faces",
    "texcoords": "texture coordinates",
    "faces_without_uv": "faces without UV",
    "multi_uv_vertices": "multi-UV vertices",
}


def summary(source: str, terminal: Terminal) -> dict[str, Any]:
    """Return all counts of a mesh, its materials and their textures."""
    mesh = open_mesh(source, terminal, may_be_empty=True)
    materials = [
        {"name": m.name, "textures": {role: _place(t) for role, t in m.textures.items()}}
        for m in mesh.materials
    ]
    return {"file": source} | asdict(mesh.summary()) | {"materials": materials}


def _place(texture: Texture) -> str | None:
    if texture.path is None and texture.data is not None:
        return f"embedded ({len(texture.data)} bytes)"
    return texture.path


def show(console: Console, record: dict[str, Any]) -> None:
    """Print the counts, as stored and welded if both exist, then bounds and materials."""
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


def depth_summary(source: str, unit: str) -> dict[str, Any]:
    """Return size, unit, number of measured pixels and depth range of a depth image."""
    from manip3d.io import read_depth_guessing

    reading = read_depth_guessing(source, unit=unit)
    height, width = reading.depth.shape
    return {
        "file": source,
        "width": width,
        "height": height,
        "measured": reading.num_measured,
        "pixels": width * height,
        "range": reading.range_m,
        "unit": reading.unit,
        "unit_guessed": reading.guessed,
        "told": reading.sentence,
    }


def show_depth(console: Console, record: dict[str, Any]) -> None:
    """Print the image's size, the share of measured pixels, unit and depth range."""
    share = record["measured"] / record["pixels"]
    console.print(f"{record['width']} x {record['height']} pixels, {share:.0%} of them measured")
    console.print(record["told"])

"""Decoding of Draco streams (glTF's extension KHR_draco_mesh_compression) through DracoPy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from manip3d._util.extras import imported

if TYPE_CHECKING:
    from numpy.typing import NDArray


def decode_draco(stream: bytes) -> tuple[NDArray[Any], dict[int, NDArray[Any]]] | str:
    """Return faces (F, 3) and vertex attributes (V, C) by unique id, or an error message."""
    DracoPy = imported("DracoPy", "draco")
    try:
        mesh = DracoPy.decode(stream)
    except MemoryError:
        return "the Draco stream takes more memory than there is"
    except Exception as error:  # DracoPy raises various types for damaged streams
        return f"damaged Draco stream: {str(error)[:200]}"
    if not hasattr(mesh, "faces"):
        return "expected a mesh, got the point cloud of a Draco stream"
    return mesh.faces, {found["unique_id"]: found["data"] for found in mesh.attributes}

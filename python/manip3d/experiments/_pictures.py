"""Pictures of original meshes and of each method's result, from the same camera."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from manip3d._util.json import canonical_json
from manip3d.experiments._model import Row, Sheet
from manip3d.experiments._simplification import METHOD_TITLES, open_model
from manip3d.experiments._store import unpack_mesh
from manip3d.io._files import atomic_write

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from manip3d.mesh import Mesh

_SIZE = (480, 400)
_QUALITY = 82  # quality of WebP files: about 15 kB per picture, no visible loss
_STYLES: dict[str, dict[str, Any]] = {
    "shaded": {"texture": False, "shading": "flat"},
    "textured": {"texture": True, "shading": "smooth"},
}


def sheets(rows: Sequence[Row]) -> dict[str, Sheet]:
    """Return a sheet of pictures for each model that was simplified to its table's target.

    Returns
    -------
    dict of str to Sheet
        Sheets by the name of the model.
    """
    methods: dict[str, dict[str, str]] = {}
    found: dict[str, Sheet] = {}
    for row in rows:
        if row.get("simplified"):
            of_model = methods.setdefault(row["model"], {})
            of_model[row["method"]] = row["simplified"]
            options = {name: row[name] for name in ("mesh", "simulated_faces")}
            about = f"{row['role']} · {row['cleaning_does']}"
            found[row["model"]] = Sheet(about, draw, options | {"methods": of_model})
    return found


def draw(folder: str, options: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Draw the original and each method's mesh, in grey and with its materials.

    Existing pictures are not drawn again, because their names are hashes of their content.

    Returns
    -------
    list of dict
        ``label``, ``faces``, and by style the file in the results folder.

    Raises
    ------
    RenderError
        No renderer works on this machine.
    """
    root = Path(folder)
    original = open_model(options)
    packed = [(root / name).read_bytes() for name in options["methods"].values()]
    meshes = [original, *(unpack_mesh(data, like=original) for data in packed)]
    labels = ["original", *(METHOD_TITLES[method] for method in options["methods"])]
    identity = [
        options["mesh"],
        options["simulated_faces"],
        *(hashlib.sha256(d).hexdigest() for d in packed),
    ]
    return draw_set(root, identity, labels, meshes, _STYLES if original.materials else ["shaded"])


def draw_set(
    root: Path,
    identity: Sequence[Any],
    labels: Sequence[str],
    meshes: Sequence[Mesh],
    styles: Iterable[str],
    **view: Any,
) -> list[dict[str, Any]]:
    """Draw meshes from the camera that frames the first one; existing pictures are kept.

    Parameters
    ----------
    root : Path
        The results folder.
    identity : sequence of JSON values
        Values that determine the pictures; their hash names the files.
    labels, meshes : sequences of the same length
    styles : iterable of str
        ``shaded``, ``textured``.
    view
        Options of `manip3d.viewer.comparison`.

    Returns
    -------
    list of dict
        ``label``, ``faces``, and by style the file in the results folder.
    """
    items: list[dict[str, Any]] = [
        {"label": label, "faces": mesh.num_faces}
        for label, mesh in zip(labels, meshes, strict=True)
    ]
    for style in styles:
        options = _STYLES[style] | view
        digest = hashlib.sha256(canonical_json([*identity, style, _SIZE])).hexdigest()[:24]
        names = [f"pictures/{digest}-{number}.webp" for number in range(len(meshes))]
        if not all((root / name).exists() for name in names):
            (root / "pictures").mkdir(exist_ok=True)
            drawn = draw_alike(meshes, size=_SIZE, **options)
            for name, image in zip(names, drawn, strict=True):
                atomic_write(root / name, webp(image))
        for item, name in zip(items, names, strict=True):
            item[style] = name
    return items


def draw_alike(
    meshes: Sequence[Mesh], *, size: tuple[int, int], **options: Any
) -> list[NDArray[np.uint8]]:
    """Draw each mesh from the camera that frames the first one.

    ``options`` are those of `viewer.comparison`.
    """
    from manip3d import viewer

    sheet = viewer.comparison(meshes, columns=1, size=size, **options)
    height = len(sheet) // len(meshes)
    return [sheet[(n + 1) * height - size[1] : (n + 1) * height] for n in range(len(meshes))]


def webp(image: NDArray[np.uint8]) -> bytes:
    """Encode a picture as a WebP file."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(image).save(stream, "WEBP", quality=_QUALITY)
    return stream.getvalue()


def read_picture(path: Path) -> NDArray[np.uint8]:
    """Read a picture file as (H, W, 3) uint8."""
    import numpy as np
    from PIL import Image

    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))

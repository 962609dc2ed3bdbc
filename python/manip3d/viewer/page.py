"""The interactive viewer: one HTML page that holds its meshes and loads nothing."""

from __future__ import annotations

import base64
import functools
import hashlib
import html as html_text
import json
import os
import tempfile
import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import simplify
from manip3d._util.paths import path_of
from manip3d.errors import InputError, RenderError
from manip3d.io import write_mesh
from manip3d.io._files import atomic_write
from manip3d.mesh import Material, Mesh, Texture
from manip3d.viewer.pictures import comparison, picture, png_bytes
from manip3d.viewer.scene import (
    CLAY,
    Style,
    boundary_edges,
    check_view,
    linear,
    texture_bytes,
    with_shading_normals,
)

if TYPE_CHECKING:
    from manip3d.viewer.scene import Camera, Points, Shading, Up

BUNDLE = Path(__file__).parent / "dist" / "viewer.js"
VIEW = {"azimuth": 30.0, "elevation": 20.0, "up": "y"}
MAX_FACES = 200_000  # 10 MB of page; a phone still turns it smoothly


@functools.cache
def _bundle() -> str:
    try:
        script = BUNDLE.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise RenderError(
            f"the viewer is not built ({BUNDLE} is missing): run 'make setup', or "
            f"'npm ci && npm run build' in {BUNDLE.parents[1]}"
        ) from None
    return script.replace("</script", "<\\/script")


def document(title: str, page: dict[str, Any]) -> str:
    """The page around its content. Nothing but its own script may run, nothing is fetched."""
    script = _bundle()
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = (
        f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; "
        "img-src blob: data:; connect-src blob:"
    )
    content = json.dumps(page).replace("<", "\\u003c")
    # ASCII throughout: a host page of another encoding would change the script, and its hash.
    name = html_text.escape(title).encode("ascii", "xmlcharrefreplace").decode()
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{name}</title>\n</head>\n<body>\n"
        "<noscript>The view needs JavaScript.</noscript>\n"
        f'<script type="application/json" id="manip3d-page">{content}</script>\n'
        f"<script>{script}</script>\n</body>\n</html>\n"
    )


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode("ascii")


@dataclass(frozen=True)
class Placement:
    """Moves meshes to the origin and to unit size, where float32 and depth buffers are exact."""

    center: Points
    scale: float

    @classmethod
    def of(cls, mesh: Mesh) -> Placement:
        """That puts ``mesh`` there."""
        if not mesh.num_faces:
            return cls(np.zeros(3), 1.0)
        low, high = mesh.bounds
        return cls(0.5 * (low + high), 1.0 / (mesh.diagonal or 1.0))

    def __call__(self, points: Points) -> Points:
        return (points - self.center) * self.scale


def _dressed(mesh: Mesh) -> Mesh:
    """Every face with a material, and each material with what the viewer shows of it."""
    contents = {
        texture: texture_bytes(mesh, texture)
        for texture in dict.fromkeys(m.textures.get("base_color") for m in mesh.materials)
        if texture is not None
    }
    materials = []
    for material in mesh.materials:
        texture = material.textures.get("base_color")
        content = None if texture is None else contents[texture]
        shown = {} if content is None else {"base_color": Texture(data=content)}
        materials.append(replace(material, textures=shown))
    red, green, blue = (1.0, 1.0, 1.0) if mesh.colors is not None else linear(CLAY)
    materials.append(Material(base_color=(red, green, blue, 1.0)))
    given = np.full(mesh.num_faces, -1) if mesh.face_material is None else mesh.face_material
    return mesh.replace(
        materials=materials, face_material=np.where(given < 0, len(materials) - 1, given)
    )


def _glb(mesh: Mesh) -> bytes:
    if not mesh.num_faces:
        return b""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mesh.glb"
        write_mesh(mesh, path)
        return path.read_bytes()


def model_entry(mesh: Mesh, placement: Placement, label: str, detail: str) -> dict[str, str]:
    """One mesh as the page's script reads it."""
    ends = placement(mesh.vertices[boundary_edges(mesh)].reshape(-1, 3))
    placed = _dressed(mesh).replace(vertices=placement(mesh.vertices))
    return {
        "label": label,
        "detail": detail,
        "glb": _base64(_glb(with_shading_normals(placed, "smooth"))),
        "boundary": _base64(ends.astype("<f4").tobytes()),
    }


def _looks(style: Style) -> dict[str, bool]:
    """What the toolbar switches, as the page's script reads it."""
    return {
        "texture": style.texture,
        "flat": style.shading == "flat",
        "wireframe": style.wireframe,
        "boundary": style.boundary,
        "backfaces": style.backfaces,
    }


def displayed(mesh: Mesh, max_faces: int) -> tuple[Mesh, str]:
    """The mesh, simplified where it has too many faces to show, and what to say of it."""
    if mesh.num_faces <= max_faces:
        return mesh, f"{mesh.num_faces:,} faces"
    shown = simplify.qem4vr(mesh, target_faces=max_faces).mesh
    return shown, f"{mesh.num_faces:,} faces, shown with {shown.num_faces:,}"


def html(
    mesh: Mesh | Sequence[Mesh],
    *,
    title: str = "",
    labels: Sequence[str] | None = None,
    azimuth: float = 30.0,
    elevation: float = 20.0,
    up: Up = "y",
    shading: Shading = "smooth",
    texture: bool = True,
    wireframe: bool = False,
    boundary: bool = False,
    backfaces: bool = True,
    max_faces: int = MAX_FACES,
) -> str:
    """A page that shows one mesh, or several side by side from one camera.

    The page holds all it needs; it can be mailed, put into an ``<iframe srcdoc>`` (`iframe` does
    that) or opened without a network. Its buttons switch what the options below set first.

    Parameters
    ----------
    mesh : Mesh or sequence of Mesh
    title : str
    labels : sequence of str, optional
        A name below each mesh; its number of faces stands beside it.
    azimuth, elevation, up, shading, texture, wireframe, boundary, backfaces
        As for `picture`.
    max_faces : int
        Larger meshes are shown simplified, and say so.

    Returns
    -------
    str

    Raises
    ------
    InputError
        An option out of range; the number of labels is not that of meshes.
    RenderError
        The viewer is not built; the message names the cure.

    Warns
    -----
    UserWarning
        A texture cannot be read; its material's base colour is shown instead.
    """
    meshes = [mesh] if isinstance(mesh, Mesh) else list(mesh)
    labels = [""] * len(meshes) if labels is None else list(labels)
    if not meshes or len(labels) != len(meshes):
        raise InputError(
            f"labels: expected one for each of at least one mesh, got {len(labels)} labels "
            f"for {len(meshes)} meshes"
        )
    if max_faces < 1:
        raise InputError(f"max_faces: expected at least 1, got {max_faces}")
    check_view(azimuth, elevation, up)
    style = Style(
        shading=shading,
        texture=texture,
        wireframe=wireframe,
        boundary=boundary,
        backfaces=backfaces,
    )
    shown = [displayed(mesh, max_faces) for mesh in meshes]
    entries = [(*pair, label) for pair, label in zip(shown, labels, strict=True)]
    view = {"azimuth": azimuth, "elevation": elevation, "up": up}
    return page_of(entries, title, view, style)


def page_of(
    entries: Sequence[tuple[Mesh, str, str]], title: str, view: dict[str, Any], style: Style
) -> str:
    """The page of meshes that are small enough, each with its detail and its label."""
    placement = Placement.of(entries[0][0])
    page = {
        "title": title,
        "view": view,
        "looks": _looks(style),
        "models": [model_entry(mesh, placement, label, text) for mesh, text, label in entries],
    }
    return document(title or "manip3d", page)


def still_page(mesh: Mesh, camera: Camera, style: Style, scale: int) -> str:
    """A page whose ``manip3d`` becomes the data URL of one picture; `html` without its buttons."""
    placement = Placement.of(mesh)
    page = {
        "title": "",
        "view": VIEW,  # of no effect: the pose says where the camera stands
        "looks": _looks(style),
        "models": [model_entry(mesh, placement, "", "")],
        "still": {
            "size": [scale * side for side in style.size],
            "background": "#{:02x}{:02x}{:02x}".format(*style.background),
            "pose": {
                "position": placement(camera.position).tolist(),
                "target": placement(camera.target).tolist(),
                "up": camera.up.tolist(),
                "view_angle": camera.view_angle,
                "near": camera.near * placement.scale,
                "far": camera.far * placement.scale,
            },
        },
    }
    return document("", page)


def iframe(page: str, *, height: int = 480) -> str:
    """An HTML element that shows ``page`` inside another page, kept apart from it."""
    return (
        f'<iframe srcdoc="{html_text.escape(page)}" sandbox="allow-scripts" '
        f'style="width:100%;height:{height}px;border:0" title="3D view"></iframe>'
    )


def view(
    mesh: Mesh | Sequence[Mesh], output: str | os.PathLike[str] | None = None, **options: Any
) -> Path:
    """Show a mesh, or several side by side: in the browser, or as an .html or .png file.

    Parameters
    ----------
    mesh : Mesh or sequence of Mesh
    output : path, optional
        Where to write; without it a page in the folder for temporary files is opened in the
        browser.
    **options
        Of `html`; for ``.png`` of `picture`, or of `comparison` for several meshes.

    Returns
    -------
    Path
        The file that shows the mesh.

    Raises
    ------
    InputError
        ``output`` ends in neither ``.html`` nor ``.png``, or an option is out of range.
    RenderError
        The viewer is not built, or nothing can draw here; the message names the cure.
    OSError
        The file cannot be written.
    """
    if output is None:
        handle, name = tempfile.mkstemp(prefix="manip3d-", suffix=".html")
        os.close(handle)
        path = view(mesh, name, **options)
        webbrowser.open(path.as_uri())
        return path
    path = path_of(output, "output")
    suffix = path.suffix.lower()
    if suffix == ".html":
        atomic_write(path, html(mesh, **options))
    elif suffix == ".png":
        image = picture(mesh, **options) if isinstance(mesh, Mesh) else comparison(mesh, **options)
        atomic_write(path, png_bytes(image))
    else:
        raise InputError(f"output: expected a name that ends in .html or .png, got {str(path)!r}")
    return path

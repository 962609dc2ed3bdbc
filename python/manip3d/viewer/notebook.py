"""How a mesh shows itself in a notebook: the viewer, a picture, and text."""

from __future__ import annotations

from manip3d.errors import MissingExtraError, RenderError
from manip3d.mesh import Mesh
from manip3d.viewer.page import VIEW, displayed, iframe, page_of
from manip3d.viewer.pictures import picture, png_bytes
from manip3d.viewer.scene import Style

SHOWN_FACES = 60_000  # 5 MB at most; a notebook holds many views
MAX_FACES = 300_000  # a second to simplify them; more would hold up the notebook


def mimebundle(mesh: Mesh) -> dict[str, str | bytes]:
    """What there is of text/plain, text/html and image/png; text always."""
    text = repr(mesh)
    if mesh.num_faces == 0:
        return {"text/plain": text}
    if mesh.num_faces > MAX_FACES:
        return {"text/plain": f"{text}\nToo large to show here; manip3d.view(mesh) shows it."}
    shown, detail = displayed(mesh, SHOWN_FACES)
    if shown is not mesh:
        text += f"\n{detail}"
    bundle: dict[str, str | bytes] = {}
    try:
        bundle["text/html"] = iframe(page_of([(shown, detail, "")], "", VIEW, Style()))
    except RenderError as error:  # the viewer is not built
        text += f"\n{error}"
    try:
        bundle["image/png"] = png_bytes(picture(shown, size=(640, 480)))
    except (RenderError, MissingExtraError) as error:
        text += "" if bundle else f"\n{error}"
    return {"text/plain": text, **bundle}

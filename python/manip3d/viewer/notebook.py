"""Representations of objects in notebooks: the interactive viewer, a picture, and text."""

from __future__ import annotations

from typing import Any

from manip3d.errors import InputError, MissingExtraError, RenderError
from manip3d.mesh import Mesh
from manip3d.viewer.page import displayed, iframe, page_of, view_of
from manip3d.viewer.pictures import picture, png_bytes
from manip3d.viewer.scene import Style
from manip3d.viewer.showing import Shown, shown, text_of

SHOWN_FACES = 60_000  # largest number of shown faces; 5 MB, because a notebook has many views
MAX_FACES = 300_000  # larger meshes are not simplified for a view, which would take over a second
SHOWN_POINTS = 150_000  # largest number of shown points; 2 MB, a whole turn of most LiDARs
PICTURE_SIZE = (640, 480)


def mimebundle(thing: Any) -> dict[str, str | bytes]:
    """Return the available representations: always text/plain, also text/html and image/png."""
    text = text_of(thing)
    try:
        one = shown(thing)
    except InputError:  # there is nothing to show, for example of a scan that was not judged
        return {"text/plain": text}
    if _is_empty(one):
        return {"text/plain": text}
    if isinstance(one, Mesh) and one.num_faces > MAX_FACES:
        return {"text/plain": f"{text}\nToo large to show here; manip3d.view(mesh) shows it."}
    fewer, detail = displayed(one, SHOWN_FACES, SHOWN_POINTS)
    if fewer is not one:
        text += f"\n{detail}"
    bundle: dict[str, str | bytes] = {}
    try:
        page = page_of([(fewer, detail, "")], "", view_of(one), Style())
        bundle["text/html"] = iframe(page)
    except RenderError as error:  # the viewer is not built
        text += f"\n{error}"
    try:
        bundle["image/png"] = png_bytes(picture(fewer, size=PICTURE_SIZE))
    except (RenderError, MissingExtraError) as error:
        text += "" if bundle else f"\n{error}"
    return {"text/plain": text, **bundle}


def _is_empty(thing: Shown) -> bool:
    if isinstance(thing, Mesh):
        return thing.num_faces == 0
    return thing.num_points == 0 and not thing.lines

"""The interactive viewer: an HTML page that contains its meshes and points and loads no files."""

from __future__ import annotations

import base64
import functools
import hashlib
import html as html_text
import json
import os
import sys
import tempfile
import webbrowser
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import simplify
from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d._util.texts import counted
from manip3d.errors import InputError, MissingExtraError, RenderError
from manip3d.io import write_mesh
from manip3d.io._files import atomic_write
from manip3d.mesh import Material, Mesh, Texture
from manip3d.viewer._placement import Placement
from manip3d.viewer.legend import end_texts, number
from manip3d.viewer.pictures import comparison, picture, png_bytes
from manip3d.viewer.points import RAMP, Classes, Colors, Column, DrawnPoints, Scale
from manip3d.viewer.scene import (
    CLAY,
    OBLIQUE,
    Pose,
    Style,
    boundary_edges,
    camera_place,
    first_view,
    linear,
    texture_bytes,
    with_shading_normals,
)
from manip3d.viewer.showing import Shown, shown

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.viewer.scene import Camera, Points, Rgb, Shading, Up

BUNDLE = Path(__file__).parent / "dist" / "viewer.js"
VIEW = {"azimuth": 30.0, "elevation": 20.0, "up": "y"}
MAX_FACES = 200_000  # a page of 10 MB, which a phone still rotates smoothly
MAX_POINTS = 2_000_000  # a page of 24 MB; slow machines draw only a part during rotation
FILM_FACES = 20_000  # faces of each frame of a film; 1 MB of the page
FIGURE_POINTS = 300_000  # points of a figure; 3 MB of a page
GRID = 65535.0  # quantisation steps of a point's coordinate along each side of the scene
# Ratio of a cloud's extent to the extent without its outermost points, above which coordinates are
# stored as float32, because single far points would make the quantisation steps too large.
FAR_OUT = 20.0


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
    """Return the page with its content; its policy allows only its own script and no requests."""
    script = _bundle()
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = (
        f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; "
        "img-src blob: data:; connect-src blob:"
    )
    # NaN is no JSON, and the page's script would show nothing at all.
    content = json.dumps(page, allow_nan=False).replace("<", "\\u003c")
    # The title is ASCII only, because a host page may have another encoding (the hash needs an
    # ASCII bundle, too).
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


def _dressed(mesh: Mesh) -> Mesh:
    """Return the mesh with a material for every face, reduced to what the viewer shows."""
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


def placed_glb(mesh: Mesh, placement: Placement) -> bytes:
    """Return a mesh for the viewer, transformed by ``placement``, as a GLB file."""
    placed = _dressed(mesh).replace(vertices=placement(mesh.vertices))
    return _glb(with_shading_normals(placed, "smooth"))


def model_entry(thing: Shown, placement: Placement, label: str, detail: str) -> dict[str, Any]:
    """Return the entry of a mesh or cloud in the form that the page's script reads."""
    entry = {"label": label, "detail": detail}
    if isinstance(thing, DrawnPoints):
        return entry | {"points": _points_entry(thing, placement)}
    ends = placement(thing.vertices[boundary_edges(thing)].reshape(-1, 3))
    return entry | {
        "glb": _base64(placed_glb(thing, placement)),
        "boundary": _floats(ends),
    }


def _floats(values: Points) -> str:
    return _base64(np.ascontiguousarray(values, "<f4").tobytes())


def _points_entry(cloud: DrawnPoints, placement: Placement) -> dict[str, Any]:
    """Return the JSON value of points for the page: positions, columns of values, and lines.

    Positions are stored in 16 bits per coordinate, unless outliers would leave too few for the
    rest.
    """
    # In random order, the first n points are an even sample of all.
    order = np.random.default_rng(0).permutation(cloud.num_points)
    placed = placement(cloud.points[order].astype(np.float64))
    low = placed.min(axis=0) if len(placed) else np.zeros(3)
    extent = np.ptp(placed, axis=0) if len(placed) else np.zeros(3)
    exact = _has_far_points(placed, extent)
    if exact:
        positions = _floats(placed)
    else:
        steps = np.rint((placed - low) * (GRID / np.where(extent > 0.0, extent, 1.0)))
        positions = _base64(steps.astype("<u2").tobytes())
    return {
        "positions": positions,
        "exact": exact,
        "low": low.tolist(),
        "extent": extent.tolist(),
        "origin": None if cloud.origin is None else placement(np.array(cloud.origin)).tolist(),
        "spread": cloud.spread,
        "least": cloud.least * placement.scale,
        "columns": [_column_entry(column, order) for column in cloud.columns],
        "lines": [
            {
                "name": lines.name,
                "color": "#{:02x}{:02x}{:02x}".format(*lines.color),
                "ends": _floats(placement(lines.ends)),
                "in_front": lines.in_front,
            }
            for lines in cloud.lines
        ],
        "axes": _axes_entry(cloud, placement),
    }


def _has_far_points(placed: Points, extent: Points) -> bool:
    """Return whether outliers lie so far away that 16 bits cannot resolve the other points."""
    if not len(placed):
        return False
    low, high = np.percentile(placed, [1.0, 99.0], axis=0)
    return bool((extent > FAR_OUT * float((high - low).max())).any())


def _column_entry(column: Column, order: NDArray[np.intp]) -> dict[str, Any]:
    chosen = column.select(order)
    if isinstance(chosen, Scale):
        return _bytes_entry(chosen.name, "scale", chosen.levels()) | {"ends": end_texts(chosen)}
    if isinstance(chosen, Colors):
        return _bytes_entry(chosen.name, "colors", chosen.values)
    return _bytes_entry(chosen.name, "classes", chosen.values) | _classes_entry(chosen)


def _classes_entry(classes: Classes) -> dict[str, Any]:
    return {
        "labels": list(classes.labels),
        "palette": [list(color) for color in classes.palette],
        "emphasis": list(classes.emphasis),
        "counts": classes.counts(),
    }


def _bytes_entry(name: str, kind: str, values: NDArray[np.uint8]) -> dict[str, Any]:
    return {"name": name, "kind": kind, "values": _base64(np.ascontiguousarray(values).tobytes())}


def _axes_entry(cloud: DrawnPoints, placement: Placement) -> dict[str, Any]:
    """Place the axes at the sensor, or at (0, 0, 0) if it is inside the scene, or at a corner."""
    low, high = cloud.bounds
    place = np.zeros(3) if cloud.origin is None else np.array(cloud.origin)
    if cloud.origin is None and not ((low <= place) & (place <= high)).all():
        place = low
    seen_from = cloud.poses[0].position if cloud.poses else high
    away, diagonal = (float(np.linalg.norm(v, axis=-1)) for v in (seen_from - place, high - low))
    distance = away or diagonal or 1.0
    length = round_length(0.2 * distance)
    return {
        "place": placement(place).tolist(),
        "length": length * placement.scale,
        "label": f"axes: {number(length)} m each",
    }


def round_length(length: float) -> float:
    """Round down to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= length * 1.001))


def _place_entry(pose: Pose, placement: Placement) -> dict[str, Any]:
    return {
        "name": pose.name,
        "position": placement(pose.position).tolist(),
        "target": placement(pose.target).tolist(),
        "view_angle": pose.view_angle,
        "aspect": pose.aspect,
    }


def _looks(style: Style, *, axes: bool = True) -> dict[str, Any]:
    """Return the states of the toolbar's switches for the page's script."""
    return {
        "axes": axes,
        "lines": True,
        "size": 1.0,
        "texture": style.texture,
        "flat": style.shading == "flat",
        "wireframe": style.wireframe,
        "boundary": style.boundary,
        "backfaces": style.backfaces,
    }


def displayed(thing: Shown, max_faces: int, max_points: int = MAX_POINTS) -> tuple[Shown, str]:
    """Reduce a mesh or cloud that is too large; return it and a text about its size."""
    if isinstance(thing, DrawnPoints):
        fewer = thing.thinned(max_points)
        return fewer, fewer.detail or f"{fewer.num_points:,} points"
    if thing.num_faces <= max_faces:
        return thing, counted(thing.num_faces, "face", separator=",")
    light = simplify.qem4vr(thing, target_faces=max_faces).mesh
    return light, f"{thing.num_faces:,} faces, shown with {light.num_faces:,}"


@checked
def html(
    thing: Any,
    *,
    title: str = "",
    labels: Sequence[str] | None = None,
    azimuth: float | None = None,
    elevation: float | None = None,
    up: Up | None = None,
    color_by: str | None = None,
    shading: Shading = "smooth",
    texture: bool = True,
    wireframe: bool = False,
    boundary: bool = False,
    backfaces: bool = True,
    max_faces: int = MAX_FACES,
    max_points: int = MAX_POINTS,
) -> str:
    """Return a page that shows an object, or several side by side with a common camera.

    The page contains all its data; it can be mailed, embedded by an ``<iframe srcdoc>`` (see
    `iframe`) or opened without a network. Its buttons change the options below.

    Parameters
    ----------
    thing : Mesh, LidarFrame, RgbdFrame, DrawnPoints or a result, or a sequence of them
        Same as for `manip3d.viewer.shown`.
    title : str
        Title of the page.
    labels : sequence of str, optional
        A name below each object, next to its number of faces or points.
    azimuth, elevation, up, color_by, shading, texture, wireframe, boundary, backfaces
        Same as for `picture`. If the first three are not given, scans are seen from behind and
        above the scanner, and depth images from their camera.
    max_faces : int
        Largest number of shown faces. A larger mesh is simplified, and the page says so.
    max_points : int
        Largest number of shown points. A larger cloud is thinned, and the page says so.

    Returns
    -------
    str

    Raises
    ------
    InputError
        An option is out of range, or the numbers of labels and of objects differ.
    RenderError
        The viewer is not built; the message says how to build it.

    Warns
    -----
    UserWarning
        A texture cannot be read; its material's base colour is shown instead.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Mesh, viewer
    >>> triangle = Mesh(np.eye(3), [[0, 1, 2]])
    >>> page = viewer.html([triangle, triangle], title="Two triangles")
    >>> "<title>Two triangles" in page, "<script" in page
    (True, True)
    """
    things = _several(thing)
    labels = [""] * len(things) if labels is None else list(labels)
    if not things or len(labels) != len(things):
        raise InputError(
            f"labels: expected one for each of at least one mesh, got {len(labels)} labels "
            f"for {len(things)} meshes"
        )
    if max_faces < 1:
        raise InputError(f"max_faces: expected at least 1, got {max_faces}")
    style = Style(
        shading=shading,
        texture=texture,
        wireframe=wireframe,
        boundary=boundary,
        backfaces=backfaces,
    )
    every = [shown(one) for one in things]
    every = [one.colored_by(color_by) if isinstance(one, DrawnPoints) else one for one in every]
    view = view_of(every[0], azimuth, elevation, up)
    fewer = [displayed(one, max_faces, max_points) for one in every]
    names = [_name(one, label) for one, label in zip(every, labels, strict=True)]
    entries = [(*pair, name) for pair, name in zip(fewer, names, strict=True)]
    return page_of(entries, title, view, style)


@checked
def film(
    meshes: Sequence[Any],
    *,
    rate: float = 10.0,
    title: str = "",
    labels: Sequence[str] | None = None,
    azimuth: float | None = None,
    elevation: float | None = None,
    up: Up | None = None,
    max_faces: int = FILM_FACES,
) -> str:
    """Make a page that plays a sequence of meshes, with a time bar.

    Like a page of `html`, it contains all its data. If the machine is too slow, frames are left
    out, so that the film keeps its speed.

    Parameters
    ----------
    meshes : sequence of Mesh or results that hold one
        At least one mesh, in the order of the film.
    rate : float, frames per second
        Speed of the film.
    title : str
        Title of the page.
    labels : sequence of str, optional
        A name of each mesh.
    azimuth, elevation, up
        Same as for `picture`; the camera is placed so that the whole film is visible.
    max_faces : int
        Largest number of shown faces. Larger meshes are simplified, and the page says so.

    Returns
    -------
    str

    Raises
    ------
    InputError
        No mesh, something that is not a mesh, or an option out of range.
    RenderError
        The viewer is not built; the message names the cure.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Mesh, viewer
    >>> steps = [Mesh(size * np.eye(3), [[0, 1, 2]]) for size in (1.0, 1.5, 2.0)]
    >>> page = viewer.film(steps, rate=2.0)
    """
    if not 0.0 < rate <= 1000.0:
        raise InputError(f"rate: expected above 0 and at most 1000 frames per second, got {rate}")
    if max_faces < 1:
        raise InputError(f"max_faces: expected at least 1, got {max_faces}")
    every = [shown(one) for one in meshes]
    names = [""] * len(every) if labels is None else list(labels)
    if not every or len(names) != len(every):
        raise InputError(
            f"labels: expected one for each of at least one mesh, got {len(names)} labels for "
            f"{len(every)} meshes"
        )
    for index, one in enumerate(every):
        if isinstance(one, DrawnPoints):
            raise InputError(f"meshes[{index}]: expected a mesh, got points")
    entries = [(*displayed(one, max_faces), name) for one, name in zip(every, names, strict=True)]
    view = view_of(every[0], azimuth, elevation, up)
    return page_of(entries, title, view, Style(), film_rate=rate)


def _several(thing: Any) -> list[Any]:
    return list(thing) if isinstance(thing, list | tuple) else [thing]


def _name(thing: Shown, label: str) -> str:
    return label or (thing.name if isinstance(thing, DrawnPoints) else "")


def view_of(
    thing: Shown,
    azimuth: float | None = None,
    elevation: float | None = None,
    up: Up | None = None,
) -> dict[str, Any]:
    """Return the first view of an object; ``fits``: from a direction, not from one of its poses."""
    fits = azimuth is not None or elevation is not None or up is not None
    if isinstance(thing, DrawnPoints):
        seen = thing.direction.but(azimuth, elevation, up)
    else:
        seen = OBLIQUE.but(azimuth, elevation, up) if fits else first_view(thing)
    return seen._asdict() | {"fits": fits}


def poses_of(thing: Shown) -> tuple[Pose, ...]:
    """Return the poses from which an object can be viewed; for depth meshes, the camera's."""
    if isinstance(thing, DrawnPoints):
        return thing.poses
    place = camera_place(thing)
    return () if place is None else (place,)


def page_of(
    entries: Sequence[tuple[Shown, str, str]],
    title: str,
    view: dict[str, Any],
    style: Style,
    film_rate: float | None = None,
) -> str:
    """Return the page of objects that are small enough, each with its label and text.

    With a rate, the objects are shown one after the other.
    """
    first = entries[0][0]
    placement = Placement.of(first)
    poses = () if view.get("fits") else poses_of(first)
    page = {
        "title": title,
        "view": {name: view[name] for name in ("azimuth", "elevation", "up")},
        "places": [_place_entry(pose, placement) for pose in poses],
        "ramp": RAMP,
        "looks": _looks(style, axes=not poses or poses[0].up != "-y"),
        "models": [model_entry(thing, placement, label, text) for thing, text, label in entries],
    }
    if film_rate is not None:
        page["film"] = {"rate": film_rate}
    return document(title or "manip3d", page)


def still_page(thing: Shown, camera: Camera, style: Style, scale: int) -> str:
    """Return a page without buttons whose variable ``manip3d`` becomes a picture's data URL."""
    placement = Placement.of(thing)
    page = _steered(style, [model_entry(thing, placement, "", "")])
    page["still"] = {
        "size": [scale * side for side in style.size],
        "scale": scale,
        "background": _css(style.background),
        "pose": _pose_entry(camera, placement),
    }
    return document("", page)


def timing_page(
    meshes: Sequence[Mesh], camera: Camera, style: Style, frames: int, seconds: float
) -> str:
    """Return a page whose variable ``manip3d`` becomes the frame times of a scene of all meshes."""
    here = Placement(np.zeros(3), 1.0)
    page = _steered(
        style,
        [
            {"label": "", "detail": "", "glb": _base64(placed_glb(mesh, here)), "boundary": ""}
            for mesh in meshes
        ],
    )
    page["timing"] = {
        "size": list(style.size),
        "frames": frames,
        "seconds": seconds,
        "background": _css(style.background),
        "pose": _pose_entry(camera, here),
    }
    return document("", page)


def _steered(style: Style, models: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the content of a page that a program controls, without controls for people."""
    return {
        "title": "",
        "view": VIEW,  # has no effect, because the pose determines the camera
        "places": [],
        "ramp": RAMP,
        "looks": _looks(style, axes=False),
        "models": models,
    }


def _css(color: Rgb) -> str:
    return "#{:02x}{:02x}{:02x}".format(*color)


def _pose_entry(camera: Camera, placement: Placement) -> dict[str, Any]:
    return {
        "position": placement(camera.position).tolist(),
        "target": placement(camera.target).tolist(),
        "up": camera.up.tolist(),
        "view_angle": camera.view_angle,
        "near": camera.near * placement.scale,
        "far": camera.far * placement.scale,
    }


@checked
def iframe(page: str, *, height: int = 480) -> str:
    """Return an HTML element that shows ``page`` inside another page, isolated from it.

    Parameters
    ----------
    page : str
        A whole page, as returned by `html`.
    height : int, pixels
        Height of the frame.

    Returns
    -------
    str
        An ``<iframe>`` whose scripts cannot access the page around it.

    Raises
    ------
    InputError
        ``page`` is not a str, or ``height`` not a number.

    Examples
    --------
    >>> from manip3d import viewer
    >>> viewer.iframe("<p>text</p>", height=100)[:45]
    '<iframe srcdoc="&lt;p&gt;text&lt;/p&gt;" sand'
    """
    return (
        f'<iframe srcdoc="{html_text.escape(page)}" sandbox="allow-scripts" '
        f'style="width:100%;height:{height}px;border:0" title="3D view"></iframe>'
    )


@checked
def figure(
    thing: Any, caption: str = "", *, height: int = 520, max_points: int = FIGURE_POINTS
) -> str:
    """Return a ``<figure>`` for another page: the viewer, or a picture, or the reason for neither.

    Parameters
    ----------
    thing : Mesh, LidarFrame, RgbdFrame, DrawnPoints or a result
        Same as for `manip3d.viewer.shown`.
    caption : str
        Text above the view.
    height : int, pixels
        Height of the view.
    max_points : int
        Largest number of shown points. A larger cloud is thinned, and the figure says so.

    Returns
    -------
    str
        HTML that needs no other file.

    Raises
    ------
    InputError
        ``thing`` cannot be shown.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Mesh, viewer
    >>> triangle = Mesh(np.eye(3), [[0, 1, 2]])
    >>> element = viewer.figure(triangle, "A triangle")
    >>> element.startswith("<figure"), "<figcaption>A triangle</figcaption>" in element
    (True, True)
    """
    try:
        inner = iframe(html(thing, max_points=max_points), height=height)
    except RenderError as no_viewer:
        try:
            data = _base64(png_bytes(picture(thing, size=(960, height))))
            inner = f'<img alt="{html_text.escape(caption)}" src="data:image/png;base64,{data}">'
        except (RenderError, MissingExtraError) as no_picture:
            inner = f"<p>{html_text.escape(f'{no_viewer}; {no_picture}')}</p>"
    title = f"<figcaption>{html_text.escape(caption)}</figcaption>" if caption else ""
    return f'<figure style="margin:1rem 0">{title}{inner}</figure>'


def has_display() -> bool:
    """Return whether a browser started by this process has a display.

    Returns
    -------
    bool
        On Linux, whether ``DISPLAY``, ``WAYLAND_DISPLAY`` or ``BROWSER`` is set.

    Examples
    --------
    >>> from manip3d import viewer
    >>> viewer.has_display() in (False, True)
    True
    """
    if sys.platform in ("win32", "darwin"):
        return True
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))


@checked
def view(thing: Any, output: str | os.PathLike[str] | None = None, **options: Any) -> Path:
    """Show an object, or several side by side, in the browser or as an .html or .png file.

    Parameters
    ----------
    thing : Mesh, LidarFrame, RgbdFrame, DrawnPoints or a result, or a sequence of them
        Same as for `manip3d.viewer.shown`.
    output : path, optional
        File to write. Default: a temporary page, which is opened in the browser if there is a
        display.
    **options
        Options of `html`; for ``.png`` those of `picture`, or of `comparison` for several objects.

    Returns
    -------
    Path
        The written file.

    Raises
    ------
    InputError
        ``output`` ends in neither ``.html`` nor ``.png``, or an option is out of range.
    RenderError
        The viewer is not built, or no renderer works here; the message says what to do.
    OSError
        The file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Mesh, viewer
    >>> triangle = Mesh(np.eye(3), [[0, 1, 2]])
    >>> viewer.view(triangle, "triangle.html", title="A triangle").name
    'triangle.html'
    """
    if output is None:
        return _opened(html(thing, **options))
    path = path_of(output, "output")
    suffix = path.suffix.lower()
    if suffix == ".html":
        atomic_write(path, html(thing, **options))
    elif suffix == ".png":
        several = isinstance(thing, list | tuple)
        image = comparison(thing, **options) if several else picture(thing, **options)
        atomic_write(path, png_bytes(image))
    else:
        raise InputError(f"output: expected a name that ends in .html or .png, got {str(path)!r}")
    return path


def _opened(page: str) -> Path:
    """Write a page to a temporary file, and open it in the browser if there is a display."""
    handle, name = tempfile.mkstemp(prefix="manip3d-", suffix=".html")
    os.close(handle)
    path = Path(name)
    atomic_write(path, page)
    if has_display():
        webbrowser.open(path.as_uri())
    return path


@checked
def play(
    meshes: Sequence[Any], output: str | os.PathLike[str] | None = None, **options: Any
) -> Path:
    """Play a sequence of meshes in the browser or as an .html file.

    Parameters
    ----------
    meshes : sequence of Mesh or results that hold one
        Meshes in the order of the film.
    output : path, optional
        File to write. Default: a temporary page, which is opened in the browser if there is a
        display.
    **options
        Options of `film`.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        ``output`` does not end in ``.html``, or as `film`.
    RenderError
        As `film`.
    OSError
        The file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Mesh, viewer
    >>> steps = [Mesh(size * np.eye(3), [[0, 1, 2]]) for size in (1.0, 1.5, 2.0)]
    >>> viewer.play(steps, "growing.html", rate=2.0).name
    'growing.html'
    """
    if output is None:
        return _opened(film(meshes, **options))
    path = path_of(output, "output")
    if path.suffix.lower() != ".html":
        raise InputError(f"output: expected a name that ends in .html, got {str(path)!r}")
    atomic_write(path, film(meshes, **options))
    return path

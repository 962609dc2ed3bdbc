"""Pictures drawn by PyVista on VTK, off-screen through EGL."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.extras import imported
from manip3d.errors import Error, MissingExtraError, RenderError
from manip3d.mesh import Mesh
from manip3d.viewer._placement import Placement
from manip3d.viewer.points import DrawnPoints
from manip3d.viewer.renderers import egl_window
from manip3d.viewer.scene import (
    Camera,
    Style,
    Surface,
    boundary_edges,
    downsampled,
    surfaces,
    with_shading_normals,
)

if TYPE_CHECKING:
    from manip3d.viewer.scene import Image, Points

EDGE_COLOR = (0.10, 0.13, 0.18)
BOUNDARY_COLOR = (0.90, 0.10, 0.20)
SMALLEST = 1.6  # smallest width of a point, pixels; the same as in points.js
LARGEST = 40.0  # largest width; the same as in points.js
LINE_WIDTH = 2.5  # pixels
SUPERSAMPLING = 2  # drawn pixels per pixel and axis; smooth edges with any driver

# Position and intensity of lights that move with the camera: a key light from the upper left, a
# fill light from the right, and one along the view, so that no visible face is black.
LIGHTS = (((-0.6, 0.9, 1.0), 0.78), ((1.0, -0.1, 0.8), 0.25), ((0.0, 0.0, 1.0), 0.25))


def draw(thing: Mesh | DrawnPoints, camera: Camera, style: Style) -> Image:
    """Draw a mesh or points as seen by ``camera``."""
    pyvista = _imported_pyvista()
    width, height = style.size
    with egl_window():
        plotter: Any = pyvista.Plotter(
            off_screen=True,
            window_size=[SUPERSAMPLING * width, SUPERSAMPLING * height],
            lighting="none",
            theme=pyvista.themes.Theme(),  # the default theme instead of the user's
        )
        try:
            plotter.set_background(style.background)
            if isinstance(thing, DrawnPoints):
                thing, camera = _near_zero(thing, camera)
                _add_points(plotter, thing, camera, height)
            elif thing.num_faces:
                thing, camera = _at_unit_size(thing, camera)
                _add_mesh(plotter, thing, style)
                if style.boundary:
                    _add_boundary(plotter, thing)
            _add_lights(plotter)
            _set_camera(plotter, camera)
            if isinstance(thing, Mesh):
                plotter.enable_depth_peeling(number_of_peels=6)
            plotter.render_window.SetMultiSamples(0)
            large = np.asarray(plotter.screenshot(return_img=True))
        finally:
            plotter.close()
    return downsampled(large, SUPERSAMPLING)


def _imported_pyvista() -> Any:
    """Import pyvista.

    Raises
    ------
    MissingExtraError
        It is not installed.
    RenderError
        It is installed but cannot be imported.
    """
    try:
        return imported("pyvista", "viz")
    except MissingExtraError:
        raise
    except Error as error:
        raise RenderError(str(error)) from error


@contextlib.contextmanager
def scene(meshes: Sequence[Mesh], camera: Camera, style: Style) -> Iterator[Any]:
    """Yield a VTK plotter with all meshes, which can be drawn repeatedly."""
    pyvista = _imported_pyvista()
    with egl_window():
        plotter: Any = pyvista.Plotter(
            off_screen=True,
            window_size=list(style.size),
            lighting="none",
            theme=pyvista.themes.Theme(),
        )
        try:
            plotter.set_background(style.background)
            for mesh in meshes:
                _add_mesh(plotter, mesh, style)
            _add_lights(plotter)
            _set_camera(plotter, camera)
            plotter.render_window.SetMultiSamples(0)
            yield plotter
        finally:
            plotter.close()


def _set_camera(plotter: Any, camera: Camera) -> None:
    view = plotter.camera
    view.position, view.focal_point, view.up = camera.position, camera.target, camera.up
    view.view_angle = camera.view_angle
    view.clipping_range = (camera.near, camera.far)


def _add_lights(plotter: Any) -> None:
    import pyvista

    for position, intensity in LIGHTS:
        light: Any = pyvista.Light(light_type="camera light", intensity=intensity)
        light.position, light.focal_point = position, (0.0, 0.0, 0.0)
        plotter.add_light(light)


def _add_mesh(plotter: Any, mesh: Mesh, style: Style) -> None:
    mesh = with_shading_normals(mesh, style.shading)
    if not style.texture:
        mesh = mesh.replace(materials=(), face_material=None, colors=None)
    for surface in surfaces(mesh):
        if len(surface.faces):
            _add_surface(plotter, mesh, surface, style)


def _add_surface(plotter: Any, mesh: Mesh, part: Surface, style: Style) -> None:
    """Add a surface as one actor; triangles share no points, because attributes are per corner."""
    import pyvista

    corners = mesh.faces[part.faces].ravel()
    triangles: Any = np.arange(len(corners)).reshape(-1, 3)
    surface: Any = pyvista.PolyData.from_regular_faces(mesh.vertices[corners], triangles)
    if mesh.normals is not None and mesh.face_normals is not None:
        surface.point_data.active_normals = mesh.normals[mesh.face_normals[part.faces].ravel()]
    look: dict[str, Any] = {"color": tuple(part.color)}
    if mesh.colors is not None:
        tinted = np.rint(mesh.colors[corners] * part.color).astype(np.uint8)
        look = {"scalars": tinted, "rgb": True}
    if part.image is not None and mesh.texcoords is not None and mesh.face_texcoords is not None:
        uv = mesh.texcoords[mesh.face_texcoords[part.faces].ravel()]
        surface.active_texture_coordinates = uv
        look["texture"] = _texture(part.image)
    actor = plotter.add_mesh(
        surface,
        opacity=part.opacity,
        ambient=0.12,
        diffuse=0.88,
        specular=0.10,
        specular_power=18.0,
        culling=False if style.backfaces and part.double_sided else "back",
        show_edges=style.wireframe,
        edge_color=EDGE_COLOR,
        edge_opacity=0.6,
        line_width=0.5 * SUPERSAMPLING,
        **look,
    )
    actor.prop.interpolation = "Phong"  # shading per pixel, from the corners' normals
    if part.image is not None and part.image.shape[2] == 4:
        actor.ForceTranslucentOn()


def _texture(image: Image) -> Any:
    import pyvista

    make: Any = pyvista.Texture
    texture = make(np.ascontiguousarray(image))
    texture.SetMipmap(True)
    texture.SetInterpolate(True)
    texture.SetMaximumAnisotropicFiltering(8)
    texture.SetRepeat(True)
    return texture


def _add_boundary(plotter: Any, mesh: Mesh) -> None:
    import pyvista

    edges = boundary_edges(mesh)
    if not len(edges):
        return
    lines: Any = np.column_stack([np.full(len(edges), 2), edges]).ravel()
    actor = plotter.add_mesh(
        pyvista.PolyData(mesh.vertices, lines=lines),
        color=BOUNDARY_COLOR,
        line_width=2.0 * SUPERSAMPLING,
        lighting=False,
    )
    # Draw the lines in front of adjacent faces, which would otherwise hide half of their pixels.
    actor.GetMapper().SetResolveCoincidentTopologyToPolygonOffset()
    actor.GetMapper().SetRelativeCoincidentTopologyLineOffsetParameters(-2.0, -2.0)


def _at_unit_size(mesh: Mesh, camera: Camera) -> tuple[Mesh, Camera]:
    """Map mesh and camera to the origin and unit size, because VTK cuts away what is tiny."""
    place = Placement.of(mesh)
    seen = replace(
        camera,
        position=place(camera.position),
        target=place(camera.target),
        near=camera.near * place.scale,
        far=camera.far * place.scale,
    )
    return mesh.replace(vertices=place(mesh.vertices)), seen


def _near_zero(cloud: DrawnPoints, camera: Camera) -> tuple[DrawnPoints, Camera]:
    """Move points, lines and camera near 0, because VTK draws points in float32."""
    low, high = cloud.bounds
    middle = 0.5 * low + 0.5 * high
    origin = None
    if cloud.origin is not None:
        x, y, z = (np.asarray(cloud.origin, np.float64) - middle).tolist()
        origin = x, y, z
    moved = replace(
        cloud,
        points=cloud.points.astype(np.float64) - middle,
        lines=tuple(replace(lines, ends=lines.ends - middle) for lines in cloud.lines),
        origin=origin,
    )
    return moved, replace(camera, position=camera.position - middle, target=camera.target - middle)


def _add_points(plotter: Any, cloud: DrawnPoints, camera: Camera, height: int) -> None:
    """Add points as discs that face the camera, and lines."""
    import pyvista

    if cloud.num_points:
        points: Any = pyvista.PolyData(cloud.points.astype(np.float64))
        points.point_data["radius"] = 0.5 * _drawn_widths(cloud, camera, height)
        points.point_data["tint"] = cloud.colors()
        actor = plotter.add_mesh(
            points,
            style="points_gaussian",
            scalars="tint",
            rgb=True,
            emissive=False,
            lighting=False,
            render_points_as_spheres=False,
        )
        actor.mapper.scale_array = "radius"
        actor.mapper.SetSplatShaderCode(_DISC)
    for lines in sorted(cloud.lines, key=lambda lines: lines.in_front):
        ends = lines.ends.reshape(-1, 3)
        cells: Any = np.column_stack(
            [np.full(len(lines.ends), 2), np.arange(len(ends)).reshape(-1, 2)]
        ).ravel()
        actor = plotter.add_mesh(
            pyvista.PolyData(ends, lines=cells),
            color=tuple(channel / 255.0 for channel in lines.color),
            line_width=LINE_WIDTH * SUPERSAMPLING,
            lighting=False,
        )
        if lines.in_front:
            actor.GetMapper().SetResolveCoincidentTopologyToPolygonOffset()
            actor.GetMapper().SetRelativeCoincidentTopologyLineOffsetParameters(0.0, -1e6)


_DISC = (
    "//VTK::Color::Impl\nif (dot(offsetVCVSOutput.xy, offsetVCVSOutput.xy) > 1.0) { discard; }\n"
)


def _drawn_widths(cloud: DrawnPoints, camera: Camera, height: int) -> Points:
    """Return (N,) the drawn widths of points, which are limited to a range in pixels."""
    ahead = camera.target - camera.position
    ahead = ahead / np.linalg.norm(ahead)
    depth = np.maximum((cloud.points - camera.position) @ ahead, camera.near)
    pixel = depth * (2.0 * np.tan(np.radians(camera.view_angle / 2.0)) / height)
    widths: Points = cloud.emphasis() * np.clip(cloud.widths(), SMALLEST * pixel, LARGEST * pixel)
    return widths

"""The relief operator: depth images to sparse meshes by what the mean distance measures."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np

from manip3d import _core
from manip3d._util.arrays import checked_grid
from manip3d._util.checked import checked
from manip3d._util.options import threads_of
from manip3d._util.texts import counted
from manip3d._util.times import SECOND_NS
from manip3d.camera import Intrinsics, Registration, checked_depth
from manip3d.errors import InputError
from manip3d.simplify._arguments import checked_color, limit_of
from manip3d.simplify._bandwidth import (
    MIN_POINTS,
    Bandwidth,
    SlidingSecond,
    fit_bytes,
)
from manip3d.simplify._depth import (
    DenseGrid,
    DenseImage,
    DepthSimplification,
)
from manip3d.simplify._pixel_maps import confidence_image, mask_image, masked_depth

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike, NDArray

    from manip3d.simplify._depth import Cover

__all__ = ["Effort", "Relief", "ReliefStream", "relief", "relief_grid"]

_BYTES_PER_POINT = 22.0
"""A point in a message: a vertex with texture coordinates and two faces, in 16 bits each."""

Effort = Literal["live", "fast", "balanced", "fine", "best"]


@dataclass(frozen=True, eq=False)
class OffSurface:
    """Faces that `cut_depth_steps` leaves out of a relief, found on its own surface.

    Attributes
    ----------
    faces : (m,) bool
        Which faces join what a step keeps apart.
    cover : (float, float, float, float) or None
        ``coverage``, ``bridges``, ``outside`` and ``filled`` of the mesh without them; None if not
        measured.
    """

    faces: NDArray[np.bool_]
    cover: Cover | None


def _no_pixels() -> NDArray[np.int32]:
    return np.empty((0, 2), np.int32)


@dataclass(frozen=True, eq=False, repr=False)
class Relief(DepthSimplification):
    """Result of `relief`: a sparse mesh, and how it came about.

    Attributes
    ----------
    stop : str
        Reason why the mesh has its number of points.

        - ``target``: it was reduced to the target.
        - ``all_points``: the surface has no more points.
        - ``small_pieces``: small separate pieces were left out with all of their points, because
          these serve better elsewhere (`dropped_pixels`).
        - ``few_faces``: no other mesh of the target was found, or none that covers as much, so that
          a few triangles of a larger mesh are the result (`dropped_pixels`).
        - ``fewer_points``: a mesh of fewer points covers more; it may be without small pieces, too.
        - ``pinholes``: vertices at filled pixels merged into others, or were left out with their
          triangles.
        - ``smaller_level``: the vertices of a smaller level left no way to more, so that its mesh
          is the result.
        - ``bandwidth`` (`ReliefStream`): not even three points fit into the bytes that are left,
          and the mesh is empty.
    dropped_pixels : int
        Pixels of the pieces or, with ``few_faces``, triangles left out; triangles at unmeasured
        pixels do not count.
    filled_pixels : int
        Unmeasured pixels, in holes of at most four amid a surface, and single measurements with
        steps all around them, that the surface was continued over; 0 if they are fewer than one of
        a thousand pixels. If one of fifty pixels (and 50 at least) is missing amid a surface, away
        from squares of five by five unmeasured pixels, pixels are missing by chance, and the
        surface is continued over all these, in holes of any size. Without ``max_edge`` and
        ``depth_step``, only lone pixels are evidence of this. No vertex is there.
    unsure_pixels : int
        Measured pixels of pieces of the dense surface without confidence, which are left out and
        count as not measured: they are missing in ``surface``. See `relief`.
    mean_move, max_move : float
        Distances of vertices from their measured points (``move_points``), in the points' unit.
    levels : tuple of (num_vertices, (m, 3) int32)
        The requested smaller meshes, as number of vertices and faces. Each uses the first vertices;
        see `prefix`. With levels, vertices of smaller levels come first; without, vertices are
        sorted by pixel, row by row.
    encoded : bytes or None
        Bytes to send for a frame of a stream with a ``bandwidth``.
    """

    dropped_pixels: int
    mean_move: float
    max_move: float
    levels: tuple[tuple[int, NDArray[np.int32]], ...] = field(repr=False)
    encoded: bytes | None = field(default=None, repr=False)
    unsure_pixels: int = 0
    _filled: NDArray[np.int32] = field(default_factory=_no_pixels, repr=False)
    _off: OffSurface | None = field(default=None, repr=False)

    @property
    def filled_pixels(self) -> int:
        """Number of unmeasured pixels that the surface was continued over; see `Relief`."""
        return len(self._filled)

    def _filled_pixels(self) -> NDArray[np.int32]:
        return self._filled

    def with_faces(self, faces: NDArray[np.int32]) -> Self:
        """Return the same points with other triangles, yet to be measured and encoded.

        Parameters
        ----------
        faces : (m, 3) int32
        """
        return replace(super().with_faces(faces), encoded=None, _off=None)

    def prefix(self, num_vertices: int) -> DepthSimplification:
        """Return the largest of `levels` that has at most ``num_vertices`` vertices.

        Parameters
        ----------
        num_vertices : int
            Largest number of vertices.

        Raises
        ------
        InputError
            All levels are larger, or ``num_vertices`` is not a whole number.
        """
        num_vertices = _whole("num_vertices", num_vertices)
        for count, faces in ((self.num_vertices, self.faces), *self.levels):
            if count <= num_vertices:
                return DepthSimplification(
                    self.vertices[:count],
                    faces,
                    self.pixels[:count],
                    self.texcoords[:count],
                    self.color,
                    "target",
                    self.surface,
                    None,
                )
        smallest = self.levels[-1][0] if self.levels else self.num_vertices
        raise InputError(f"num_vertices: expected at least {smallest}, got {num_vertices}")


def _whole(name: str, value: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise InputError(f"{name}: expected a whole number, got {value!r}")
    return int(value)


def relief_options(
    target_points: int,
    effort: Effort,
    move_points: bool,
    max_edge: float | None,
    threads: int,
    *,
    from_origin: bool,
    depth_step: float | None = None,
    focal: float = 0.0,
    levels: Sequence[int] = (),
) -> _core.ReliefOptions:
    options = _core.ReliefOptions()
    options.target_points = _whole("target_points", target_points)
    options.effort = getattr(_core.ReliefEffort, effort)
    options.move_points = bool(move_points)
    options.from_origin = from_origin
    options.max_edge = limit_of(max_edge)
    options.max_step = limit_of(depth_step)
    options.focal = focal
    options.levels = [_whole("levels", size) for size in levels]
    options.measure_coverage = effort != "live"
    options.num_threads = threads_of(threads)
    return options


_MAX_KEPT = 1 << 19
"""Pixels up to which memory stays with the thread: 123 bytes for each pixel where the target is 5 %
of them, 333 bytes at 30 %."""


class _Kept(threading.local):
    """The memory that each thread keeps between calls."""

    def __init__(self) -> None:
        self.solver = _core.ReliefSolver()


_KEPT = _Kept()


def _solver(pixels: int, effort: str) -> _core.ReliefSolver:
    """The thread's own for `live`, so that its memory is not given back between frames.

    A sixth to a quarter of the time went into that. The result does not depend on what a solver did
    before; other efforts, which take far more memory, and large images get one of their own.
    """
    return _KEPT.solver if effort == "live" and pixels <= _MAX_KEPT else _core.ReliefSolver()


def run_relief(
    solver: _core.ReliefSolver,
    points: NDArray[np.float32],
    valid: NDArray[np.bool_],
    rows_up: bool,
    options: _core.ReliefOptions,
    surface: DenseImage | DenseGrid,
    *,
    color: NDArray[np.uint8] | None = None,
    registration: Registration | None = None,
    confidence: NDArray[np.float32] | None,
) -> Relief:
    fields = solver.run(points, valid, rows_up, options, confidence)
    return _relief_of(fields, options, color, registration, surface)


def _relief_of(
    fields: dict[str, Any],
    options: _core.ReliefOptions,
    color: NDArray[np.uint8] | None,
    registration: Registration | None,
    surface: DenseImage | DenseGrid,
) -> Relief:
    """Return the fields that a solver found as a `Relief`."""
    fields["stop"] = fields["stop"].name
    cover = fields.pop("cover")
    fields["_filled"] = fields.pop("filled")
    unsure = fields.pop("unsure")
    fields["unsure_pixels"] = len(unsure)
    off, left = fields.pop("off"), fields.pop("without_off")
    has_cover, has_steps = options.measure_coverage, np.isfinite(options.max_step)
    fields["cover"] = cover if has_cover else None
    fields["_off"] = (
        OffSurface(off.view(np.bool_), left if has_cover else None) if has_steps else None
    )
    fields["surface"] = _without(surface, unsure)
    if registration is not None:
        fields["texcoords"] = _core.registered_texcoords(fields["vertices"], registration)
    return Relief(**fields, color=color)


def _without(surface: DenseImage | DenseGrid, pixels: NDArray[np.int32]) -> DenseImage | DenseGrid:
    """Return a surface without the measurements at some pixels (column, row)."""
    if not len(pixels):
        return surface
    columns, rows = pixels.T
    if isinstance(surface, DenseImage):
        depth = surface.depth.copy()
        depth[rows, columns] = 0
        return replace(surface, depth=depth)
    valid = surface.valid.copy()
    valid[rows, columns] = False
    return replace(surface, valid=valid)


@checked
def relief(
    depth: ArrayLike,
    intrinsics: Intrinsics,
    target_points: int,
    *,
    color: ArrayLike | None = None,
    registration: Registration | None = None,
    mask: ArrayLike | None = None,
    confidence: ArrayLike | None = None,
    move_points: bool = False,
    effort: Effort = "balanced",
    max_edge: float | None = None,
    depth_step: float | None = None,
    levels: Sequence[int] = (),
    threads: int = 0,
) -> Relief:
    """Simplify a depth image so that the mean distance of its surface from the mesh is small.

    The interface is that of `cs3`, the published operator; the method is manip3d's own.

    Parameters
    ----------
    depth : (H, W) uint16 in millimetres or float32 in metres
        Depth along the optical axis; 0 and NaN mean no measurement.
    intrinsics : Intrinsics
    target_points : int
        Largest number of vertices; at least 3.
    color : (H', W', 3 or 4) uint8, optional
        Colour image of the depth image's size, or that of ``registration.color``.
    registration : Registration, optional
        Position of the colour camera; without it both images share their pixels.
    mask : (H, W) bool, optional
        Pixels to use; the others count as not measured.
    confidence : (H, W) float, 0 to 1, optional
        Weight of the error (area times distance from the mesh) of each pixel. A pixel with weight 0
        (less than a thousandth of the mean) does not shape the surface: vertices within the surface
        leave it, and triangles lie over it, but possibly farther from it than a depth step, so that
        it is not covered. A piece of the surface between depth steps or gaps, of which the mean is
        as low, counts as not measured (``unsure_pixels``). If all weights are 0, they are ignored
        in this. `confidence_of_levels` converts the levels of a camera; see Notes.
    move_points : bool
        Let vertices leave the measured points along their lines of sight, towards the least-squares
        fit of all pixels, where this lowers the error around them; ``mean_move`` and ``max_move``
        state how far. Texture coordinates stay those of the line of sight (re-projected if there is
        a registration).
    effort : 'live', 'fast', 'balanced', 'fine' or 'best'
        Each effort is slower and has a smaller error than the one before it, except that ``live``
        has about the error of ``fast``.
    max_edge : float, metres, optional
        Triangles with a longer edge are left out of the dense surface.
    depth_step : float, optional
        Triangles across steps in depth are left out of the dense surface, so that steps are
        boundaries of the mesh. At a step the depths of the corners differ by more than this share
        of the smallest depth, and by more than on a surface inclined by 78 degrees
        (`cut_depth_steps` states the rule). Where bays were filled and holes closed, triangles may
        still be a step away from most of the pixels over them; `cut_depth_steps` removes these.
    levels : sequence of int
        Numbers of vertices of smaller meshes, strictly decreasing and below ``target_points``. Each
        uses the first vertices; `Relief.prefix` returns them. The smallest mesh has the triangles
        of a separate call, except that parts of it which touch at a pixel may share a vertex. Each
        larger mesh keeps the vertices of the one before, which costs some accuracy. All together
        take as long as separate calls. Not with ``move_points``.
    threads : int
        0: all cores. The result is the same for any number.

    Returns
    -------
    Relief

    Raises
    ------
    InputError
        Another shape or dtype, a negative or infinite depth, a confidence outside 0 to 1, or an
        option out of range.

    Notes
    -----
    Longest-edge bisection down to the pixels where the surface ends, edge collapses priced by the
    growth of sqrt(area x quadric), then edge flips and moves to other measured points nearby that
    lower the sum of distances between the pixels and their triangles' planes. Silhouettes and
    depth discontinuities (``max_edge``) are boundaries of the mesh from the start, and vertices
    there move pixel by pixel to where the surface ends. ``live`` bisects by the distance times the
    area, goes down to squares of four pixels where the surface ends and keeps of the contour in
    each the pixels at which it turns; most of its edges collapse one after the other, below a limit
    for the price that rises from pass to pass, and it flips edges by twelve pixels of each pair of
    triangles. Small pieces that would have a tenth of the points are left out in these passes, too.
    Any target is met: where it costs less than the next collapse, holes are closed, bays of the
    silhouette filled and small pieces left out; ``coverage`` and ``bridges`` say how much. Except
    with ``live``, triangles go of which more lies over unmeasured pixels than they alone cover of
    the surface. With up to 64 points several meshes are made, and the result is the one that covers
    most; except with ``live`` also meshes of fewer points, which must cover a tenth more. With 65
    to 128 points a mesh of 64 is the result if it covers a tenth more. With up to 64 points,
    ``live`` also makes a mesh as ``fast`` does if its own covers less than half. ``live``
    measures ``coverage`` and ``bridges`` when they are first asked for, which takes up to nine
    tenths of the time of the mesh.

    A confidence multiplies the distance that decides whether a bisection is needed at its pixel,
    and the pixel's area in the sum of distances that flips and moves lower. A triangle's quadric,
    and what is lost beside its outer sides, count by the least of its corners' confidences and of
    the mean of the other pixels in it; of what is lost, no less than a twentieth of the mean
    confidence. Closing a hole or filling a bay costs the same whatever is believed. ``coverage``
    counts each pixel of the dense surface alike; pieces without confidence are no part of it. Two
    kinds of vertices can be at a pixel without confidence: those where the surface ends, and one
    or two within a region of thousands of pixels; more if fewer pixels have a confidence than there
    are points.

    Examples
    --------
    >>> import numpy as np, manip3d
    >>> camera = manip3d.Intrinsics(64, 48, fx=60, fy=60, cx=31.5, cy=23.5)
    >>> wall = np.full((48, 64), 2000, np.uint16)
    >>> manip3d.simplify.relief(wall, camera, 4).pixels.tolist()
    [[0, 0], [63, 0], [0, 47], [63, 47]]

    A wrong measurement that the camera does not believe itself, and a wall cut to its left half:

    >>> wall[20, 30] = 1500
    >>> believed = np.where(wall == 1500, 0.0, 1.0)
    >>> manip3d.simplify.relief(wall, camera, 4, confidence=believed).pixels.tolist()
    [[0, 0], [63, 0], [0, 47], [63, 47]]
    >>> left = np.arange(64) < 32
    >>> half = manip3d.simplify.relief(wall, camera, 100, mask=np.tile(left, (48, 1)))
    >>> int(half.pixels[:, 0].max())
    31
    """
    image = checked_depth(depth, intrinsics)
    picture = checked_color(color, image.shape, registration)
    image = masked_depth(image, mask_image(mask, image.shape))
    options = relief_options(
        target_points,
        effort,
        move_points,
        max_edge,
        threads,
        from_origin=True,
        depth_step=depth_step,
        focal=min(intrinsics.fx, abs(intrinsics.fy)),
        levels=levels,
    )
    shares = confidence_image(confidence, image.shape)
    fields = _solver(image.size, effort).run_depth(image, intrinsics, options, shares)
    surface = DenseImage(image.copy(), intrinsics, options.max_edge, options.max_step)
    return _relief_of(fields, options, picture, registration, surface)


@checked
def relief_grid(
    points: ArrayLike,
    valid: ArrayLike | None,
    target_points: int,
    *,
    color: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    confidence: ArrayLike | None = None,
    rows_up: bool = True,
    move_points: bool = False,
    effort: Effort = "balanced",
    max_edge: float | None = None,
    levels: Sequence[int] = (),
    threads: int = 0,
) -> Relief:
    """Simplify a range scan; see `relief`.

    Parameters
    ----------
    points : (H, W, 3) float
        Same as for `manip3d.io.read_range_grid`. Rounded to float32.
    valid : (H, W) bool or None
        None: where all three coordinates are finite.
    target_points : int
        Largest number of vertices; at least 3.
    color : (H, W, 3 or 4) uint8, optional
    mask : (H, W) bool, optional
        True where a valid pixel may be used; by default everywhere.
    confidence : (H, W) float, 0 to 1, optional
        Same as for `relief`.
    rows_up : bool
        Whether rows go upward, seen from the sensor (Stanford's scans), or downward (images).
    move_points : bool
        Same as for `relief`, but along the mean normal of the surface; texture coordinates follow
        to where the moved vertex lies on the surface.
    effort : 'live', 'fast', 'balanced', 'fine' or 'best'
        Same as for `relief`.
    max_edge : float, optional
        In the unit of the points.
    levels : sequence of int
        Same as for `relief`.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    Relief

    Raises
    ------
    InputError
        Same as for `relief`; a valid point is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import simplify
    >>> y, x = np.mgrid[0:40, 0:40] * 0.01
    >>> points = np.stack([x, -y, 1 + 0.1 * np.sin(6 * x)], axis=2)
    >>> simplify.relief_grid(points, None, 100).num_vertices
    100
    """
    grid, used = checked_grid(points, valid, kept=True)
    picture = checked_color(color, used.shape)
    chosen = mask_image(mask, used.shape)
    if chosen is not None:
        used = used & chosen
    options = relief_options(
        target_points, effort, move_points, max_edge, threads, from_origin=False, levels=levels
    )
    surface = DenseGrid(grid, used, options.max_edge)
    return run_relief(
        _solver(used.size, effort),
        grid,
        used,
        bool(rows_up),
        options,
        surface,
        color=picture,
        confidence=confidence_image(confidence, used.shape),
    )


@checked
class ReliefStream:
    """Simplify the frames of a depth sequence to meshes that do not flicker.

    Depths are averaged over time where the scene is at rest, and follow motion. Vertices and edges
    of the previous frame are replaced only by better ones. Buffers are reused.

    Parameters
    ----------
    intrinsics : Intrinsics
    target_points : int
        Largest number of vertices; at least 3.
    registration : Registration, optional
    move_points : bool
        Same as for `relief`.
    effort : 'live', 'fast', 'balanced', 'fine' or 'best'
        Same as for `relief`.
    max_edge : float, metres, optional
        Same as for `relief`.
    depth_step : float, optional
        Same as for `relief`.
    stability : float
        Factor on the price of removing a vertex of the previous frame; 1: frames are independent.
    newest_share : float
        Weight of the newest frame in a pixel's mean over time, in (0, 1]; 1: no smoothing, so that
        vertices are the measured points.
    gate : float
        A pixel whose depth changes by more than this share restarts its mean.
    threads : int
        0: all cores. The result is the same for any number.
    bandwidth : float, bytes a second, optional
        Largest number of bytes per second. Each frame gets as many points, up to
        ``target_points``, as fit with the picture into its share of the bytes. The limit also holds
        if frames arrive more often than ``rate``.
    rate : float, frames a second
        Number of frames that share ``bandwidth`` equally.
    encode : callable, optional
        Function from a `Relief` to the bytes that are sent, for ``bandwidth``. Default:
        `DepthMesh.encode`, with the number and the time of the frame.

    Raises
    ------
    InputError
        An option of the wrong kind; numbers out of range are refused at the first frame.

    Notes
    -----
    A change of depth that the pixels around have, too, is motion: the mean change of 24 x 24
    pixels, and what the mean of 25 pixels differs from it, are taken at once where they are above
    the noise of such means. The rest of a pixel's changes is averaged over time, and the result
    over those of the 24 pixels around that lie on the same surface. The mesh of the previous frame
    goes along with the motion of the larger means. Where it is within three standard deviations of
    the result, its surface is moved towards that by half of ``newest_share`` at least, by more in
    a pixel's first frames, and wholly where half of the pixels around move. The noises are measured
    in the stream itself: factors of that of a Kinect, which grows with the square of the depth. The
    first frame is simplified as it is, and the stream starts anew with a frame of which less than
    half of the pixels have the depth they had before.

    Motion that changes depths by less than three times the noise of the larger mean lags behind by
    up to twice that.

    Examples
    --------
    >>> import numpy as np, manip3d
    >>> camera = manip3d.Intrinsics(64, 48, fx=60, fy=60, cx=31.5, cy=23.5)
    >>> stream = manip3d.simplify.ReliefStream(camera, 100)
    >>> noise = np.random.default_rng(0)
    >>> frames = [2000 + noise.integers(0, 9, (48, 64)).astype(np.uint16) for _ in range(3)]
    >>> [stream.simplify(frame).num_vertices for frame in frames]
    [100, 100, 100]

    Ten frames a second in 20 000 bytes:

    >>> stream = manip3d.simplify.ReliefStream(camera, 3000, bandwidth=20_000, rate=10)
    >>> sent = [stream.simplify(frame).encoded for frame in frames]
    >>> [1800 < len(message) <= 2000 for message in sent]
    [True, True, True]
    """

    def __init__(
        self,
        intrinsics: Intrinsics,
        target_points: int,
        *,
        registration: Registration | None = None,
        move_points: bool = False,
        effort: Effort = "balanced",
        max_edge: float | None = None,
        depth_step: float | None = None,
        stability: float = 3.0,
        newest_share: float = 0.15,
        gate: float = 0.03,
        threads: int = 1,
        bandwidth: float | None = None,
        rate: float | None = None,
        encode: Callable[[Relief], bytes] | None = None,
    ) -> None:
        self._budget: SlidingSecond | None = None
        if bandwidth is not None and rate is not None:
            self._budget = SlidingSecond(Bandwidth(bandwidth, rate))
            self._rate = rate
        elif bandwidth is not None or rate is not None or encode is not None:
            raise InputError("bandwidth, rate: expected both, encode only with them")
        self._encode = encode
        self._number = 0
        self._last: tuple[int, int] | None = None
        self._intrinsics = intrinsics
        self._registration = registration
        self._options = relief_options(
            target_points,
            effort,
            move_points,
            max_edge,
            threads,
            from_origin=True,
            depth_step=depth_step,
            focal=min(intrinsics.fx, abs(intrinsics.fy)),
        )
        self._most_points = self._options.target_points
        self._options.stability = float(stability)
        self._solver = _core.ReliefSolver()
        self._smoother = _core.DepthSmoother(float(newest_share), float(gate))
        self._lock = threading.RLock()

    def __repr__(self) -> str:
        pixels = f"{self._intrinsics.width} x {self._intrinsics.height} pixels"
        return f"<manip3d.simplify.ReliefStream: {counted(self._most_points, 'point')} of {pixels}>"

    def simplify(
        self,
        depth: ArrayLike,
        *,
        color: ArrayLike | None = None,
        mask: ArrayLike | None = None,
        confidence: ArrayLike | None = None,
        time_ns: int | None = None,
    ) -> Relief:
        """Simplify the next frame.

        Parameters
        ----------
        depth : (H, W) uint16 in millimetres or float32 in metres
        color : (H', W', 3 or 4) uint8, optional
        mask, confidence : (H, W) bool, and float from 0 to 1, optional
            Same as for `relief`; of this frame.
        time_ns : int, optional
            When it was taken, for the ``bandwidth``; default: frames come at the ``rate``.

        Returns
        -------
        Relief

        Raises
        ------
        InputError
            As `relief`; an earlier ``time_ns`` than that of the previous frame.

        Notes
        -----
        A frame that ends in an error after it was smoothed makes the stream start anew, as `reset`
        does; one with images of the wrong kind changes nothing.
        """
        with self._lock:
            make, measured = self._take(depth, color, mask, confidence)
            try:
                return self._made(make, measured, time_ns)
            except BaseException:
                # The smoother has this frame already, and the solver may have lost those before.
                self.reset()
                raise

    def _made(self, make: Callable[[int], Relief], measured: int, time_ns: int | None) -> Relief:
        """Make the mesh of a frame, and let the next one stay near to it."""
        if self._budget is None:
            return make(self._most_points)
        most_points = min(self._most_points, max(measured, MIN_POINTS))
        found = self._within_bytes(self._budget, make, most_points, time_ns)
        self._show(found)  # which need not be the last that was made
        return found

    def _show(self, found: Relief) -> None:
        """Let the next frame stay near to this mesh."""
        depths = np.ascontiguousarray(found.vertices[:, 2], np.float32)
        self._smoother.show(found.pixels, depths, found.faces)

    def _take(
        self,
        depth: ArrayLike,
        color: ArrayLike | None,
        mask: ArrayLike | None,
        confidence: ArrayLike | None,
    ) -> tuple[Callable[[int], Relief], int]:
        """Smooth the next frame; what makes a mesh of so many points, and its measured pixels."""
        image = checked_depth(depth, self._intrinsics)
        picture = checked_color(color, image.shape, self._registration)
        image = masked_depth(image, mask_image(mask, image.shape))
        shares = confidence_image(confidence, image.shape)
        smooth = self._smoother.add(image)
        if self._smoother.starts_anew():
            self._solver.reset()  # the vertices of another view are no better than any others
        points, valid, rows_up = _core.unproject(
            smooth, self._intrinsics, self._options.num_threads
        )
        surface = DenseImage(
            smooth, self._intrinsics, self._options.max_edge, self._options.max_step
        )

        def make(target: int) -> Relief:
            self._options.target_points = target
            found = run_relief(
                self._solver,
                points.reshape(*image.shape, 3),
                valid.reshape(image.shape).view(np.bool_),
                rows_up,
                self._options,
                surface,
                color=picture,
                registration=self._registration,
                confidence=shares,
            )
            self._show(found)
            return found

        return make, int(np.count_nonzero(valid))

    def _within_bytes(
        self,
        budget: SlidingSecond,
        make: Callable[[int], Relief],
        most_points: int,
        time_ns: int | None,
    ) -> Relief:
        """The frame of as many points as its bytes hold; an empty one if these are too few."""
        if time_ns is None:
            time_ns = round(self._number * SECOND_NS / self._rate)
        elif isinstance(time_ns, bool) or not isinstance(time_ns, int | np.integer):
            raise InputError(f"time_ns: expected a whole number, got {time_ns!r}")
        time_ns = int(time_ns)
        number = self._number
        allowance = budget.allowance(time_ns)
        self._number += 1

        def encoded(target: int) -> tuple[Relief, int, int]:
            found = make(target)
            if self._encode is not None:
                data = self._encode(found)
            else:
                data = found.encode(sequence=number % 2**32, time_ns=time_ns)
            if not isinstance(data, bytes | bytearray | memoryview):
                raise InputError(f"encode: expected bytes, got {type(data).__name__}")
            self._last = target, len(data)
            return replace(found, encoded=bytes(data)), found.num_vertices, len(data)

        if self._last is None:
            guess, least_share = allowance / _BYTES_PER_POINT, 0.9
        else:
            points, size = self._last
            guess, least_share = points + (0.97 * allowance - size) / _BYTES_PER_POINT, 0.7
        found = fit_bytes(
            encoded,
            most_points=most_points,
            allowance=allowance,
            guess=guess,
            bytes_per_point=_BYTES_PER_POINT,
            least_share=least_share,
        )
        if found is None:
            found = replace(_without_points(make(MIN_POINTS)), stop="bandwidth", encoded=b"")
        assert found.encoded is not None
        budget.spend(time_ns, len(found.encoded))
        return found

    def reset(self) -> None:
        """Forget all frames, but not the bytes that were sent."""
        with self._lock:
            self._solver.reset()
            self._smoother.reset()


def _without_points(found: Relief) -> Relief:
    return replace(
        found,
        vertices=found.vertices[:0],
        faces=found.faces[:0],
        pixels=found.pixels[:0],
        texcoords=found.texcoords[:0],
        cover=(0.0, 0.0, 0.0, 0.0),
        _off=None,
        mean_move=0.0,
        max_move=0.0,
    )

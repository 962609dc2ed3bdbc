"""Sequences of depth images in files, simplified to meshes that are stable over time."""

from __future__ import annotations

import os
import threading
from typing import TYPE_CHECKING, Any

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.camera import Intrinsics
from manip3d.errors import InputError
from manip3d.io import DEPTH_SUFFIXES, read_range_grid
from manip3d.io._scan_tables import scan_suffix
from manip3d.simplify._depth_files import Taken, from_cloud, from_image
from manip3d.simplify._depth_inputs import MapFiles, Maps
from manip3d.simplify._depth_options import DepthFileResult, DepthOptions
from manip3d.simplify._depth_writing import LastFile
from manip3d.simplify._organised import camera_of_scan, find_camera, is_cloud_file
from manip3d.simplify._relief import ReliefStream

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["DepthSequence"]


@checked
class DepthSequence:
    """Simplify the depth images of one camera, in order, to meshes that are stable over time.

    Each file is simplified as by `simplify_depth_file`, but with a `ReliefStream`: pixels are
    smoothed over time while they change little, and vertices are kept from mesh to mesh. Give the
    images in the order in which they were taken. An image that cannot be read is skipped and does
    not affect the later ones.

    Parameters
    ----------
    options : DepthOptions
        Options of all images; the method must be ``relief``. Give the unit of the images, because
        ``guess`` infers a unit from each image alone.

    Raises
    ------
    InputError
        The method is not ``relief``.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import io, simplify
    >>> sequence = simplify.DepthSequence(simplify.DepthOptions(100, intrinsics="tum", unit="mm"))
    >>> noise = np.random.default_rng(0)
    >>> for number in range(3):
    ...     depth = 2000 + noise.integers(0, 9, (480, 640)).astype(np.uint16)
    ...     np.save(f"{number}.npy", depth)
    ...     found = sequence.simplify_file(f"{number}.npy", f"{number}.ply")
    >>> found.points, found.options.method
    (100, 'relief')
    """

    def __init__(self, options: DepthOptions) -> None:
        if options.method != "relief":
            raise InputError(f"method: expected relief for a sequence, got {options.method}")
        self._options = options
        self._smoothing = Smoothing()
        self._lock = threading.Lock()

    def __repr__(self) -> str:
        return f"<manip3d.simplify.DepthSequence: {self._options.points or 'all'} points a frame>"

    @property
    def options(self) -> DepthOptions:
        """Options of all images."""
        return self._options

    def simplify_file(
        self,
        source: str | os.PathLike[str],
        output: str | os.PathLike[str],
        *,
        color: str | os.PathLike[str] | None = None,
        mask: str | os.PathLike[str] | None = None,
        confidence: str | os.PathLike[str] | None = None,
        confidence_max: int | None = None,
    ) -> DepthFileResult:
        """Turn the next depth image into a mesh in a file.

        Parameters
        ----------
        source : path-like
            A depth image (``manip3d.io.DEPTH_SUFFIXES``), or an organised cloud or range grid of a
            depth camera, of the same size as the first one. The camera of the first cloud is used
            for all clouds.
        output, color, mask, confidence, confidence_max
            Same as for `simplify_depth_file`.

        Returns
        -------
        DepthFileResult
            The result; coverage, bridges and steps are measured on the smoothed image.

        Raises
        ------
        InputError, FormatError, OSError, MissingExtraError
            As `simplify_depth_file`. In addition, an InputError for a scan, for a cloud that is not
            from a depth camera, and for an image of another size.
        """
        path, target = path_of(source, "source"), path_of(output, "output")
        is_cloud = is_cloud_file(path)
        is_grid = scan_suffix(path) == ".ply"
        if not is_cloud and not is_grid and path.suffix.lower() not in DEPTH_SUFFIXES:
            raise InputError(f"source: expected a depth image in a sequence, got {path.name}")
        files = MapFiles.of(self._options, color, mask, confidence, confidence_max)
        with self._lock:
            if not is_cloud and not is_grid:
                return from_image(path, target, self._options, files, self._smoothing.take)
            grid = read_range_grid(path)
            camera = camera_of_scan(grid) if is_grid else find_camera(grid)
            if camera is None:
                raise InputError(
                    f"source: expected a depth camera's cloud in a sequence, got {path.name}"
                )
            return from_cloud(
                grid, camera, path, target, self._options, files, self._smoothing.take
            )


class Smoothing:
    """Smooths images one after another by a `ReliefStream` that starts with the first image."""

    def __init__(self) -> None:
        self._stream: ReliefStream | None = None
        self._camera: Intrinsics | None = None
        self._last = LastFile()

    def take(
        self, depth: NDArray[Any], camera: Intrinsics, options: DepthOptions, maps: Maps
    ) -> Taken:
        """Smooth the next image."""
        if self._camera is None or self._stream is None:
            self._camera = camera
            self._stream = ReliefStream(
                camera,
                options.points or depth.size,
                effort=options.effort,
                move_points=options.move_points,
                max_edge=options.max_edge,
                depth_step=options.depth_step or None,
                registration=maps.registration,
                threads=options.threads,
            )
        first = self._camera
        if (camera.width, camera.height) != (first.width, first.height):
            raise InputError(
                f"source: expected an image of {first.width} x {first.height} pixels as the first "
                f"of the sequence, got {camera.width} x {camera.height}"
            )
        # Masked pixels have already been removed from the depth image.
        make, _ = self._stream._take(depth, maps.color, None, maps.confidence)
        return Taken(make, self._last)

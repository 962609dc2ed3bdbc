"""Common parts of the experiments of chapter 4: scenes, pipeline, ground truth, and pictures."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from manip3d.experiments._model import Row
    from manip3d.modify import PhantomFrame, Segmentation
    from manip3d.rgbd import RgbdFrame
    from manip3d.simulate import BodyCapture, BodyTruth

    Floats = NDArray[np.float64]
    Mask = NDArray[np.bool_]
    Picture = NDArray[np.uint8]

ROLE = "simulated patient, in the place of the published recordings"
NOTE = (
    "A simulated patient (`manip3d.simulate.BodySimulator`) before a simulated Kinect V2 stands in "
    "for the published recordings, of which none is public."
)


@dataclass(frozen=True, eq=False)
class Outcome:
    """A simulated frame with its ground truth, and the pipeline's result."""

    capture: BodyCapture
    phantom: PhantomFrame

    @property
    def frame(self) -> RgbdFrame:
        """The frame that the sensor delivered."""
        return self.capture.frame

    @property
    def truth(self) -> BodyTruth:
        """The ground truth of the frame."""
        return self.capture.truth


def outcomes(
    scene: Mapping[str, Any], pipeline: Mapping[str, Any], times: Sequence[float]
) -> Iterator[Outcome]:
    """Yield the results of a new pipeline on a simulated scene.

    Parameters
    ----------
    scene : mapping
        Options of `BodySimulator`.
    pipeline : mapping
        Options of `PhantomPipeline`.
    times : sequence of float, seconds
        Times of the frames, ascending.
    """
    from manip3d.modify import PhantomPipeline
    from manip3d.simulate import BodySimulator

    simulator = BodySimulator(**scene)
    stage = PhantomPipeline(**pipeline)
    for time in times:
        capture = simulator.capture(time)
        yield Outcome(capture, stage.process(capture.frame))


# --- Measures ---------------------------------------------------------------------------------


def segmented(frame: RgbdFrame, segmentation: Segmentation = "skin") -> NDArray[np.uint8]:
    """Return the nearest bone of each pixel, by the first person's skeleton."""
    from manip3d.modify import segment_body

    person, camera = frame.skeletons[0], frame.calibration.depth
    return segment_body(
        frame.depth, camera, person, segmentation=segmentation, body_index=frame.body_index
    ).labels


def drawn(phantom: PhantomFrame, *kinds: str) -> Mask:
    """Return the pixels of the given kinds."""
    from manip3d.modify import PixelKind

    return np.isin(phantom.kinds, [int(PixelKind[kind]) for kind in kinds])


def covered(phantom: PhantomFrame) -> Mask:
    """Return the pixels that show the phantom."""
    return phantom.phantom


def distances(points: NDArray[np.floating[Any]], surface: Any) -> Floats:
    """Return the distance of each point to a mesh, metres."""
    from manip3d.metrics import closest_points

    return np.asarray(closest_points(surface, points).distance)


def errors(outcome: Outcome, limb: Any) -> Floats:
    """Return the distances of unfilled phantom points to the reflected intact limb, metres.

    The limb is reflected at the true plane of symmetry.
    """
    camera = outcome.frame.calibration.depth
    points = camera.unproject(outcome.phantom.depth)[drawn(outcome.phantom, "PHANTOM", "AWAY")]
    return distances(points, outcome.truth.phantom(limb))


def sensor_errors(outcome: Outcome, limb: str) -> Floats:
    """Return distances of the intact limb's measured points to the limb's true surface."""
    from manip3d.simulate import LIMBS, opposite

    intact: Any = opposite(limb)
    mine = np.isin(outcome.truth.bones, LIMBS[intact][1:]) & (outcome.frame.depth > 0)
    mine &= outcome.frame.body_index == 0
    points = outcome.frame.calibration.depth.unproject(outcome.frame.depth)[mine]
    return distances(points, outcome.truth.limb(intact))


def true_cover(outcome: Outcome, limb: Any) -> Mask:
    """Return the pixels at which the reflected limb would be visible in front of the person."""
    from manip3d.simulate import cast_mesh

    camera = outcome.frame.calibration.depth
    depth = cast_mesh(outcome.truth.phantom(limb), camera)
    body = np.where(outcome.truth.people == 0, outcome.truth.depth, np.inf)
    return (depth > 0.0) & (depth < body)


def hole_sizes(shown: Mask, wanted: Mask) -> list[int]:
    """Return the number of pixels of each hole.

    A hole is a region of ``wanted`` pixels that are not ``shown`` but enclosed by shown ones.
    """
    from scipy import ndimage

    holes = ndimage.binary_fill_holes(shown) & ~shown & wanted
    labels, count = ndimage.label(holes)
    return [int(n) for n in np.bincount(labels.ravel(), minlength=count + 1)[1:]]


# --- Pictures ---------------------------------------------------------------------------------


def box_of(mask: Mask, margin: int = 12) -> tuple[slice, slice]:
    """Return the rows and columns of a mask's bounding box, with a margin in pixels."""
    rows, columns = np.nonzero(mask.any(1))[0], np.nonzero(mask.any(0))[0]
    if not len(rows):
        return slice(None), slice(None)
    return (
        slice(max(0, int(rows[0]) - margin), int(rows[-1]) + margin),
        slice(max(0, int(columns[0]) - margin), int(columns[-1]) + margin),
    )


def grey_view(
    person: NDArray[np.floating[Any]], box: tuple[slice, slice]
) -> Callable[[NDArray[np.floating[Any]]], str]:
    """Return a function that draws a depth image, metres, in grey and packs the part in a box.

    Parameters
    ----------
    person : (n,) float, metres
        Depths of the person; all but the nearest and farthest 1 % determine the scale.
    box : (slice, slice)
    """
    from manip3d.viewer import people

    near, far = np.quantile(person, [0.01, 0.99])

    def grey(depth: NDArray[np.floating[Any]]) -> str:
        return packed(people.depth_picture(depth, near=near - 0.1, far=far + 0.1)[box])

    return grey


def packed(picture: Picture) -> str:
    """Encode a picture as a string for JSON: base64 of its PNG file."""
    from manip3d.viewer.pictures import png_bytes

    return base64.b64encode(png_bytes(picture)).decode()


def unpacked(word: str) -> Picture:
    """Decode a picture from the string that `packed` returned."""
    import io

    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(base64.b64decode(word))))


def panels(rows: Sequence[Row], width: float = 2.3) -> dict[str, Figure]:
    """Draw the pictures of each row's ``views`` side by side."""
    from matplotlib.figure import Figure

    figures = {}
    for row in rows:
        views = {name: unpacked(word) for name, word in row["views"].items()}
        tallest = max(image.shape[0] / image.shape[1] for image in views.values())
        figure = Figure(figsize=(width * len(views), width * tallest + 0.4), layout="constrained")
        for number, (name, image) in enumerate(views.items()):
            axes = figure.add_subplot(1, len(views), number + 1)
            axes.imshow(image, interpolation="nearest")
            axes.set(xticks=[], yticks=[])
            axes.set_title(name, fontsize=9)
        figures[row["model"]] = figure
    return figures

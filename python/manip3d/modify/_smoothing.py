"""Choose the patient's skeleton and remove the jitter of its joints."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Self

import numpy as np

from manip3d import _core
from manip3d._util.checked import checked
from manip3d.camera import Intrinsics
from manip3d.errors import InputError
from manip3d.rgbd import RgbdFrame, Skeleton

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

Preset = Literal["default", "seated"]


def smoother_options(
    preset: Preset = "default",
    *,
    smoothing: float | None = None,
    correction: float | None = None,
    prediction: float | None = None,
    jitter_radius: float | None = None,
    max_deviation: float | None = None,
) -> _core.JointSmootherOptions:
    """A preset with some of its numbers changed."""
    presets = {
        "default": _core.JointSmootherOptions,
        "seated": _core.JointSmootherOptions.seated,
    }
    options = presets[preset]()
    for name, value in (
        ("smoothing", smoothing),
        ("correction", correction),
        ("prediction", prediction),
        ("jitter_radius", jitter_radius),
        ("max_deviation", max_deviation),
    ):
        if value is not None:
            setattr(options, name, float(value))
    return options


@checked
class JointSmoother:
    """Double exponential smoothing of one person's joints, frame by frame.

    With raw X, filtered F, trend B, output Y and primes for the previous frame: F = X, B = 0 at
    first and F = (X + X') / 2 in the second frame; then, d being the distance of X from F',
    X* = X if d > J else F' + (d / J) (X - F'); F = (1 - s) X* + s (F' + B');
    B = c (F - F') + (1 - c) B'; Y = F + p B, pulled to within D of X. J and D are doubled for
    inferred joints. A joint that is not tracked, not finite or at the origin comes out as not
    tracked, and starts anew when it is back.

    Parameters
    ----------
    preset : {"default", "seated"}
        s, c, p, J, D = .25, .25, .25, .03, .05 or, for people who sit, .5, .1, .5, .1, .1.
    smoothing : float, optional
        s in [0, 1).
    correction : float, optional
        c in [0, 1].
    prediction : float, optional
        p >= 0, frames.
    jitter_radius : float, optional
        J >= 0, metres.
    max_deviation : float, optional
        D >= 0, metres.

    Raises
    ------
    InputError
        A number is out of range.

    Notes
    -----
    M. Azimi, "Skeletal joint smoothing", Microsoft, 2012.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Skeleton
    >>> smoother = JointSmoother()
    >>> still = Skeleton(np.full((25, 3), 2.0))
    >>> shaken = Skeleton(np.full((25, 3), 2.005))
    >>> for frame in (still, still, shaken):
    ...     smoothed = smoother.add(frame)
    >>> bool(np.all(smoothed.positions < 2.003))
    True
    """

    def __init__(
        self,
        preset: Preset = "default",
        *,
        smoothing: float | None = None,
        correction: float | None = None,
        prediction: float | None = None,
        jitter_radius: float | None = None,
        max_deviation: float | None = None,
    ) -> None:
        self._core = _core.JointSmoother(
            smoother_options(
                preset,
                smoothing=smoothing,
                correction=correction,
                prediction=prediction,
                jitter_radius=jitter_radius,
                max_deviation=max_deviation,
            )
        )

    def add(self, skeleton: Skeleton) -> Skeleton:
        """Return the next frame's skeleton, smoothed; orientations stay as they are.

        Parameters
        ----------
        skeleton : Skeleton
            Skeleton of the next frame, as tracked.

        Returns
        -------
        Skeleton
        """
        return Skeleton(**self._core.add(skeleton))

    def reset(self) -> Self:
        """Forget all frames: for another person, or another recording."""
        self._core.reset()
        return self


def _shares(clothes: ArrayLike, num_people: int) -> NDArray[np.float32]:
    rows = np.asarray(clothes, np.float64)
    if rows.shape == (0,):  # a list of nobody's clothes has no columns
        rows = rows.reshape(0, 15)
    if rows.shape != (num_people, 15):
        raise InputError(f"clothes: expected shape ({num_people}, 15), got {rows.shape}")
    if not ((rows >= 0.0) & (rows <= 1.0)).all():
        raise InputError("clothes: expected shares from 0 to 1")
    return np.ascontiguousarray(rows, np.float32)


@checked
def clothing_colors(frame: RgbdFrame) -> NDArray[np.float32]:
    """Measure the colours of the clothes that each person of a frame wears on the trunk.

    Pixels along the spine, 11 cm to either side of it, where the depth image shows the front of the
    trunk and no arm before it.

    Parameters
    ----------
    frame : RgbdFrame
        With a colour image and skeletons.

    Returns
    -------
    (N, 15) float32
        A row for each skeleton: shares of 12 hues, from red on every 30 degrees, and of black,
        grey and white. A row adds up to 1, or is 0 where too little of the trunk is seen.

    Raises
    ------
    InputError
        The frame has no colour image.

    Notes
    -----
    Two rows a and b are compared by their Hellinger distance, sqrt(1 - sum sqrt(a b)) [Comaniciu,
    Ramesh & Meer, "Kernel-based object tracking", 2003, eq. 16]; `KeyPerson` takes below 0.35 for
    the same clothes and above 0.6 for others.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, RgbdCalibration, RgbdFrame, Skeleton, modify
    >>> joints = np.zeros((25, 3), np.float32)
    >>> joints[:, 2] = 2.0
    >>> joints[[1, 20, 2], 1] = -0.25, -0.5, -0.6  # the spine from the hips up
    >>> person = Skeleton(joints, states=np.full(25, 2, np.uint8))
    >>> camera = RgbdCalibration(Intrinsics(64, 64, 60.0, 60.0, 31.5, 31.5))
    >>> depth = np.full((64, 64), 1900, np.uint16)
    >>> red = np.zeros((64, 64, 3), np.uint8) + np.uint8([200, 0, 0])
    >>> frame = RgbdFrame(depth, camera, red, skeletons=(person,))
    >>> np.flatnonzero(modify.clothing_colors(frame)[0]).tolist()
    [0]
    """
    if frame.color is None:
        raise InputError("frame: expected a colour image, got none")
    calibration = frame.calibration
    body_index = None if frame.body_index is None else np.ascontiguousarray(frame.body_index)
    return _core.clothing_colors(
        np.ascontiguousarray(frame.depth),
        body_index,
        calibration.depth,
        calibration.registration,
        np.ascontiguousarray(frame.color),
        frame.skeletons,
    )


@checked
class KeyPerson:
    """Holds on to one of the people in view, whoever else walks through the picture.

    At first the one whose SpineBase projects nearest to the image centre, then whoever has its id,
    unless it jumped away while somebody else stands where it was a moment ago: trackers swap ids.
    Where the hips are out of the picture, the lowest joint of the spine tells where they are.
    Once lost, the only newcomer of the same size is taken: at once when alone in view, after 0.3
    seconds beside others; after ``patience`` the newcomer nearest to where it was last seen, within
    ``reach``. Others who were seen beside it are not newcomers until they were not seen for
    ``forget``: `select` takes one of them. Where clothes are given, whoever has the id and wears
    other colours is passed over for the only one nearby in the key person's colours, and a newcomer
    in other colours is not taken. Another shirt or a jacket is learnt within some 4 seconds at 30
    frames a second, while its wearer keeps id and place and nobody else is within 1 m.

    Parameters
    ----------
    patience : float, seconds
        Time before a lost person is looked for among newcomers.
    reach : float, metres
        How far from where it was last seen a person is looked for.
    forget : float, seconds
        After so long the choice is made as if for the first time, among newcomers.

    Raises
    ------
    InputError
        A number is not >= 0.
    """

    def __init__(self, *, patience: float = 1.0, reach: float = 0.5, forget: float = 10.0) -> None:
        options = _core.KeyPersonOptions()
        options.patience, options.reach, options.forget = patience, reach, forget
        self._core = _core.KeyPerson(options)

    def find(
        self,
        people: Sequence[Skeleton],
        camera: Intrinsics,
        time: float,
        *,
        clothes: ArrayLike | None = None,
    ) -> Skeleton | None:
        """Return the key person among the people, or None while it is lost.

        Parameters
        ----------
        people : sequence of Skeleton
            The people in view.
        camera : Intrinsics
            The depth camera that sees them.
        time : float, seconds
            Time of the frame; it grows from call to call.
        clothes : (N, 15) float32, optional
            Clothes of the people as of `clothing_colors`.

        Returns
        -------
        Skeleton or None

        Raises
        ------
        InputError
            ``clothes`` has another shape than one row for each of the people, or a share that is
            not 0 to 1.
        """
        worn = None if clothes is None else _shares(clothes, len(people))
        index = self._core.find(people, camera, float(time), worn)
        return None if index is None else people[index]

    def select(self, person: int) -> Self:
        """Take the person of this `Skeleton.id` as soon as it is among the people.

        Parameters
        ----------
        person : int
            `Skeleton.id` of the person to follow.
        """
        self._core.select(int(person))
        return self

    def reset(self) -> Self:
        """Choose anew at the next frame."""
        self._core.reset()
        return self

"""Choice of the patient's skeleton among several, and smoothing of its joints."""

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
    """Return a preset with the given options changed."""
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

    Let X be the measured position, F the filtered one, B the trend and Y the output; a prime marks
    the previous frame. In the first frame F = X and B = 0, in the second F = (X + X') / 2. In later
    frames, with d the distance of X from F':
    X* = X if d > J, otherwise F' + (d / J) (X - F'); F = (1 - s) X* + s (F' + B');
    B = c (F - F') + (1 - c) B'; Y = F + p B, limited to a distance D from X. J and D are doubled
    for inferred joints. A joint that is not tracked, not finite or at the origin is returned as
    not tracked, and its filter starts anew when the joint is tracked again.

    Parameters
    ----------
    preset : {"default", "seated"}
        Values of (s, c, p, J, D): (.25, .25, .25, .03, .05) or, for seated people,
        (.5, .1, .5, .1, .1).
    smoothing : float, optional
        s, the weight of the prediction F' + B', in [0, 1).
    correction : float, optional
        c, the weight of the new trend, in [0, 1].
    prediction : float, optional
        p >= 0, the number of frames to extrapolate.
    jitter_radius : float, optional
        J >= 0, metres; smaller movements are damped.
    max_deviation : float, optional
        D >= 0, metres; largest distance of the output from the measurement.

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
    >>> from manip3d.modify import JointSmoother
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
        """Return the next frame's skeleton with smoothed positions; orientations are unchanged.

        Parameters
        ----------
        skeleton : Skeleton
            Skeleton of the next frame from the tracker.

        Returns
        -------
        Skeleton
        """
        return Skeleton(**self._core.add(skeleton))

    def reset(self) -> Self:
        """Discard all frames, for another person or another recording."""
        self._core.reset()
        return self


def _shares(clothes: ArrayLike, num_people: int) -> NDArray[np.float32]:
    rows = np.asarray(clothes, np.float64)
    if rows.shape == (0,):  # an empty list has no columns
        rows = rows.reshape(0, 15)
    if rows.shape != (num_people, 15):
        raise InputError(f"clothes: expected shape ({num_people}, 15), got {rows.shape}")
    if not ((rows >= 0.0) & (rows <= 1.0)).all():
        raise InputError("clothes: expected shares from 0 to 1")
    return np.ascontiguousarray(rows, np.float32)


@checked
def clothing_colors(frame: RgbdFrame) -> NDArray[np.float32]:
    """Measure the colours of the clothes on the trunk of each person in a frame.

    Pixels within 11 cm to either side of the spine are counted if the depth image shows the front
    of the trunk there and no arm in front of it.

    Parameters
    ----------
    frame : RgbdFrame
        Frame with a colour image and skeletons.

    Returns
    -------
    (N, 15) float32
        A histogram for each skeleton: shares of 12 hues, every 30 degrees from red on, and of
        black, grey and white. A row adds up to 1, or is 0 if too little of the trunk is seen.

    Raises
    ------
    InputError
        The frame has no colour image.

    Notes
    -----
    Two rows a and b are compared by their Hellinger distance, sqrt(1 - sum sqrt(a b)) [Comaniciu,
    Ramesh & Meer, "Kernel-based object tracking", 2003, eq. 16]. For `KeyPerson`, clothes are the
    same below a distance of 0.35 and different above 0.6.

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
    """Follows one of the people in view, the key person, while others pass through the image.

    The key person is chosen as the one whose SpineBase projects nearest to the image centre. It is
    then followed by its id, unless that id jumped away while another person stands at its last
    position, because trackers swap ids. If the hips are outside the image, their position is
    extrapolated from the lowest tracked joint of the spine.

    If the key person is lost, a newcomer of the same size takes its place: at once if the newcomer
    is alone in view, after 0.3 seconds beside other people. After ``patience`` it is the newcomer
    nearest to the last position, within ``reach``. People who were seen together with the key
    person are not newcomers until nobody has seen them for ``forget``; one of them can be chosen by
    `select`.

    If clothes are given, a person who has the key person's id but wears other colours is rejected
    in favour of the only person nearby in the key person's colours, and a newcomer in other colours
    is not taken. A change of clothes is learnt within about 4 seconds at 30 frames a second, if its
    wearer keeps id and place and nobody else is within 1 m.

    Parameters
    ----------
    patience : float, seconds
        Time after which a lost key person is looked for among newcomers near its last position.
    reach : float, metres
        Largest distance of such a newcomer from the last position.
    forget : float, seconds
        Time after which the key person is chosen anew among newcomers, as in the first frame.

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
            The depth camera of the frame.
        time : float, seconds
            Time of the frame; it should grow from call to call, which is not checked.
        clothes : (N, 15) float32, optional
            Clothes of the people, from `clothing_colors`.

        Returns
        -------
        Skeleton or None

        Raises
        ------
        InputError
            ``clothes`` does not have one row for each of the people, or a share is not between 0
            and 1.
        """
        worn = None if clothes is None else _shares(clothes, len(people))
        index = self._core.find(people, camera, float(time), worn)
        return None if index is None else people[index]

    def select(self, person: int) -> Self:
        """Make the person with this `Skeleton.id` the key person as soon as the id is in view.

        Parameters
        ----------
        person : int
            `Skeleton.id` of the person to follow.
        """
        self._core.select(int(person))
        return self

    def reset(self) -> Self:
        """Discard the key person; the next frame chooses one as the first did."""
        self._core.reset()
        return self

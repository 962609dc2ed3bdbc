"""Risk of an attack for the car: the risk factor of dissertation section 7.3.3."""

from __future__ import annotations

import itertools
import math
import threading
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.texts import counted
from manip3d.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

ATTACK_TYPES: Mapping[str, float] = ReadOnlyMapping(
    {
        "additive": 1.0,
        "subtractive": 1.0,
        "both": 0.95,
        "modification": 0.95,  # unknown which of the three below: the worst of them
        "translation": 0.95,
        "rotation": 0.5,
        "replacement": 0.3,
    }
)
"""Types of attack and their factor f_alpha, as in the authors' tool."""

_MIN_FRAMES, _MAX_FRAMES = 5, 720
_FARTHEST_M = 1e6  # largest motion per frame: metres, and radians
_OBSERVED_M = 100.0  # metres: the past counts over this way (section 7.3.3)


@checked
@dataclass(frozen=True)
class RiskParameters:
    """Parameters of the risk factor.

    Attributes
    ----------
    reaction_s : float, seconds
        Reaction time before braking begins, t_r.
    braking_mps2 : float, m/s^2
        Deceleration, a.
    fps : float
        Frames per second.
    nearest_m : float, metres
        Begin of the safety region, ahead of the scanner.
    half_width_m : float, metres
        Extent of the safety region to each side.
    bottom_m, top_m : float, metres
        Lowest and highest height of the safety region, relative to the scanner.
    sigma_m : float, metres
        Standard deviation of the place of one attack between two frames, in the Gaussian of f_s.
    low, high : float
        Scores below ``low`` are low, scores of at least ``high`` are high, others medium.
    paper_literal : bool
        Compute f_s as printed, as the correlation of two pairs (d, theta), which is always +1, -1
        or 0.
    """

    reaction_s: float = 1.5
    braking_mps2: float = 6.0
    fps: float = 10.0
    nearest_m: float = 5.0
    half_width_m: float = 10.0
    bottom_m: float = -1.5
    top_m: float = 2.0
    sigma_m: float = 2.0
    low: float = 0.3
    high: float = 0.6
    paper_literal: bool = False

    def __post_init__(self) -> None:
        for name in ("braking_mps2", "fps", "half_width_m", "sigma_m"):
            if not (getattr(self, name) > 0.0 and math.isfinite(getattr(self, name))):
                raise InputError(f"{name}: expected a number > 0, got {getattr(self, name)}")
        for name in ("reaction_s", "nearest_m"):
            if not (getattr(self, name) >= 0.0 and math.isfinite(getattr(self, name))):
                raise InputError(f"{name}: expected a number >= 0, got {getattr(self, name)}")
        if not (-math.inf < self.bottom_m < self.top_m < math.inf):
            raise InputError("bottom_m, top_m: expected bottom_m < top_m")
        if not 0.0 <= self.low <= self.high <= 1.0:
            raise InputError("low, high: expected 0 <= low <= high <= 1")

    def safe_distance(self, speed_mps: float) -> float:
        """Return the stopping distance d_safe in metres: v t_r + v^2 / (2 a).

        Parameters
        ----------
        speed_mps : float
            Speed of the car, metres per second.

        Returns
        -------
        float

        Examples
        --------
        >>> from manip3d.authenticate import RiskParameters
        >>> round(RiskParameters().safe_distance(50 / 3.6), 1)
        36.9
        """
        _check_speed(speed_mps)
        return speed_mps * self.reaction_s + speed_mps * speed_mps / (2.0 * self.braking_mps2)

    def contains(self, points: ArrayLike, speed_mps: float) -> NDArray[np.bool_]:
        """Return which points lie in the safety region (figure 7.7): a box ahead of the car.

        Parameters
        ----------
        points : (..., 3), metres
            Points in the LiDAR's frame: ahead, to the left, up.
        speed_mps : float, m/s
            Speed of the car: the box ends at the stopping distance.

        Returns
        -------
        (...) bool

        Raises
        ------
        InputError
            ``points`` has another shape, or ``speed_mps`` is negative.

        Examples
        --------
        >>> from manip3d.authenticate import RiskParameters
        >>> RiskParameters().contains([[20.0, 0.0, 0.0], [50.0, 0.0, 0.0]], 50 / 3.6).tolist()
        [True, False]
        """
        places = np.asarray(points)
        if places.ndim == 0 or places.shape[-1] != 3 or places.dtype.kind not in "fiu":
            raise InputError(
                f"points: expected numbers of shape (..., 3), got shape {places.shape} of "
                f"{places.dtype}"
            )
        ahead, left, up = np.moveaxis(places, -1, 0)
        inside: NDArray[np.bool_] = (
            (ahead >= self.nearest_m)
            & (ahead <= self.safe_distance(speed_mps))
            & (left >= -self.half_width_m)  # abs(-128) is -128 in int8
            & (left <= self.half_width_m)
            & (up >= self.bottom_m)
            & (up <= self.top_m)
        )
        return inside

    def frames(self, speed_mps: float) -> int:
        """Return X_n, the number of frames in which the car drives 100 m: 5 to 720.

        Parameters
        ----------
        speed_mps : float
            Speed of the car, metres per second.

        Returns
        -------
        int

        Examples
        --------
        >>> from manip3d.authenticate import RiskParameters
        >>> RiskParameters().frames(10.0)
        100
        """
        _check_speed(speed_mps)
        if speed_mps * _MAX_FRAMES <= self.fps * _OBSERVED_M:
            return _MAX_FRAMES
        return max(math.ceil(self.fps * _OBSERVED_M / speed_mps), _MIN_FRAMES)


@checked
@dataclass(frozen=True)
class AttackObservation:
    """Position and extent of an attack in one frame.

    Attributes
    ----------
    type : str
        One of `ATTACK_TYPES`.
    position : (float, float), metres
        Nearest point of the attacked region in the LiDAR's frame: ahead, to the left. Of several
        regions, the one with the greatest risk.
    changed : int
        Number of changed cells of the range image in the safety region: with an added point, or
        with a missing return.
    cells : int
        Number of all cells of the safety region that can be judged.
    """

    type: str
    position: tuple[float, float]
    changed: int
    cells: int

    def __post_init__(self) -> None:
        if self.type not in ATTACK_TYPES:
            raise InputError(f"type: expected one of {', '.join(ATTACK_TYPES)}, got {self.type!r}")
        if not all(math.isfinite(value) for value in self.position):
            raise InputError(f"position: expected finite numbers, got {self.position}")
        if not 0 <= self.changed <= self.cells:
            raise InputError(f"changed: expected 0 to cells ({self.cells}), got {self.changed}")

    @property
    def distance(self) -> float:
        """Distance along the ground, metres."""
        return math.hypot(*self.position)

    @property
    def angle_rad(self) -> float:
        """Angle from straight ahead, radians, counter-clockwise."""
        return math.atan2(self.position[1], self.position[0])


@dataclass(frozen=True)
class Risk:
    """Risk after one frame.

    Attributes
    ----------
    factor : float
        R_f as printed: the product of ``factors``, 0 to 1 (with ``paper_literal``, f_s may be
        negative).
    score : float
        Geometric mean of ``factors``, 0 to 1; the product of six factors below 1 is nearly 0.
    level : str
        ``low``, ``medium`` or ``high`` by ``score``; ``none`` while none of the last ``frames``
        frames shows an attack.
    action : str
        Recommended action at this level.
    factors : mapping of str to float
        ``distance``, ``number``, ``angle``, ``type``, ``space``, ``time`` in a frame with an
        attack; only ``space`` and ``time`` in a clean one.
    frames, attacked_frames : int
        X_n, the number of frames of the window, and x_n, the number of these with an attack.
    """

    factor: float
    score: float
    level: str
    action: str
    factors: Mapping[str, float] = field(default_factory=dict)
    frames: int = 0
    attacked_frames: int = 0

    def record(self) -> dict[str, object]:
        """Return the fields, ready for JSON."""
        return {
            "factor": self.factor,
            "score": self.score,
            "level": self.level,
            "action": self.action,
            "factors": dict(self.factors),
            "frames": self.frames,
            "attacked_frames": self.attacked_frames,
        }


ACTIONS: Mapping[str, str] = ReadOnlyMapping(
    {
        "none": "drive on",
        "low": "drive on and log the frames",
        "medium": "slow down, rely on the other sensors, and tell the operator",
        "high": "hand over or stop safely, and tell the operator at once",
    }
)
"""Recommended action at each level, which the maker of a car should replace."""


class _Past(NamedTuple):
    """Places of the attacks in one frame, by all witnesses; empty: the frame is clean."""

    places: tuple[tuple[float, float], ...]  # (x, y) in the axes of the first frame
    polars: tuple[tuple[float, float], ...]  # (distance, angle) in the frame's own axes


class RiskTracker:
    """The risk of one stream of frames, with the past frames that f_s and f_t need.

    Parameters
    ----------
    parameters : RiskParameters, optional
        Default: ``RiskParameters()``.

    Notes
    -----
    Dissertation section 7.3.3: R_f = f_d f_n f_theta f_alpha f_s f_t in an attacked frame, f_s f_t
    in a clean one. Threads may share a tracker; updates take effect one after the other.

    Examples
    --------
    >>> from manip3d.authenticate import AttackObservation, RiskTracker
    >>> tracker = RiskTracker()
    >>> attack = AttackObservation("additive", (8.0, 0.0), changed=40, cells=100)
    >>> tracker.update(attack, speed_mps=10.0).level
    'low'
    >>> risks = [tracker.update(attack, speed_mps=10.0) for _ in range(60)]
    >>> risks[-1].level
    'high'
    """

    @checked
    def __init__(self, parameters: RiskParameters | None = None) -> None:
        self.parameters = RiskParameters() if parameters is None else parameters
        self._lock = threading.Lock()
        self.reset()

    def __repr__(self) -> str:
        return f"<manip3d.authenticate.RiskTracker: last {counted(len(self._past), 'frame')}>"

    def reset(self) -> None:
        """Forget all frames."""
        with self._lock:
            # One more than X_n, because the oldest frame of the window is compared with its
            # predecessor.
            self._past: deque[_Past] = deque(maxlen=_MAX_FRAMES + 1)
            self._pose = (0.0, 0.0, 0.0)

    @checked
    def update(
        self,
        attack: AttackObservation | None,
        *,
        speed_mps: float,
        motion: tuple[float, float, float] = (0.0, 0.0, 0.0),
        others: Sequence[AttackObservation] = (),
    ) -> Risk:
        """Take the next frame and return the risk after it.

        Parameters
        ----------
        attack : AttackObservation or None
            Attack in the frame; None: the frame is clean.
        speed_mps : float, m/s
            Speed of the car, >= 0.
        motion : (float, float, float)
            Motion of the car since the previous frame: metres ahead and to the left, and radians
            counter-clockwise; zeros if unknown.
        others : sequence of AttackObservation
            Observations of further witnesses in the frame. The gravest one counts, so that no
            witness can reduce the risk that another one sees.

        Raises
        ------
        InputError
            A speed is negative, a number is not finite, or a motion exceeds 1e6 metres or radians.
        """
        check_movement(speed_mps, motion)
        with self._lock:
            self._pose = moved(self._pose, motion)
            attacks = [*([] if attack is None else [attack]), *others]
            self._past.append(_in_first_frame(attacks, self._pose))
            count = self.parameters.frames(speed_mps)
            past = list(self._past)[-(count + 1) :]
        return self._risk(attacks, past, count, speed_mps)

    def _risk(
        self,
        attacks: Sequence[AttackObservation],
        past: Sequence[_Past],
        count: int,
        speed_mps: float,
    ) -> Risk:
        p = self.parameters
        safe = p.safe_distance(speed_mps)
        factors = max((_factors(each, safe) for each in attacks), key=_gravity, default={})
        attacked = [bool(frame.places) for frame in past[-count:]]
        factors["space"] = _spatial(past, count, p)
        factors["time"] = temporal_factor(attacked, frames=count)
        product = math.prod(factors.values())
        score = max(0.0, product) ** (1.0 / len(factors))
        level = _level(tuple(factors.values()), p) if any(attacked) else "none"
        return Risk(
            product,
            score,
            level,
            ACTIONS[level],
            ReadOnlyMapping(factors),
            count,
            sum(attacked),
        )


def _factors(attack: AttackObservation, safe: float) -> dict[str, float]:
    """The factors that depend on a single frame."""
    return {
        "distance": max(0.0, (safe - attack.distance) / safe) if safe > 0.0 else 0.0,
        "number": attack.changed / attack.cells if attack.cells else 0.0,
        "angle": max(0.0, math.cos(attack.angle_rad)),
        "type": ATTACK_TYPES[attack.type],
    }


def _gravity(factors: Mapping[str, float]) -> tuple[float, float]:
    """Sort key of attacks: the product of the factors; if products are 0, their sum."""
    return math.prod(factors.values()), sum(factors.values())


def gravest_place(
    places: Iterable[tuple[float, float]], speed_mps: float, parameters: RiskParameters
) -> tuple[float, float]:
    """Return the place where an attack is the greatest risk; of equal ones the nearest."""
    safe = parameters.safe_distance(speed_mps)
    attacks = [AttackObservation("additive", place, changed=1, cells=1) for place in places]
    return max(attacks, key=lambda each: (_gravity(_factors(each, safe)), -each.distance)).position


@checked
def temporal_factor(attacked: Sequence[bool], *, frames: int = 0) -> float:
    """Return f_t = (x_n / X_n) (c_n / X_n), which grows with the share and recency of attacks.

    x_n is the number of attacked frames of the last X_n frames. c_n is X_n minus the number of
    clean frames since the last attack.

    Parameters
    ----------
    attacked : sequence of bool
        Whether each frame was attacked, the oldest frame first; frames before them count as clean.
    frames : int
        X_n, the number of frames that count; 0: all given frames.

    Returns
    -------
    float
        In [0, 1]: 0 without an attack, 1 if each of X_n frames was attacked.

    Raises
    ------
    InputError
        ``attacked`` is empty, or has more than X_n frames.

    Examples
    --------
    >>> from manip3d.authenticate import temporal_factor
    >>> temporal_factor([True, True, True, False, False])
    0.36
    """
    count = frames or len(attacked)
    if not 1 <= len(attacked) <= count:
        most = f"1 to {frames} frames" if frames else "1 or more frames"
        raise InputError(f"attacked: expected {most}, got {len(attacked)}")
    flags = [bool(each) for each in attacked]
    if True not in flags:
        return 0.0
    since = flags[::-1].index(True)  # number of clean frames since the last attack
    return sum(flags) * max(0, count - since) / (count * count)


def _spatial(past: Sequence[_Past], count: int, p: RiskParameters) -> float:
    """f_s, the mean over X_n pairs of neighbouring frames; a pair with a clean frame counts 0."""
    total = 0.0
    for before, after in itertools.pairwise(past):
        if p.paper_literal:
            # The printed formula is Pearson's correlation of two attacks' polar coordinates (d,
            # theta). For vectors of two numbers it is the sign of the product of their differences.
            pairs = itertools.product(before.polars, after.polars)
            slopes = [(one[0] - one[1]) * (two[0] - two[1]) for one, two in pairs]
            total += max((float(s > 0.0) - float(s < 0.0) for s in slopes), default=0.0)
        else:
            places = itertools.product(before.places, after.places)
            apart = min((math.dist(*pair) for pair in places), default=math.inf) / p.sigma_m
            total += math.exp(-0.5 * apart * apart)
    return total / count


def _in_first_frame(
    attacks: Sequence[AttackObservation], pose: tuple[float, float, float]
) -> _Past:
    """Places of attacks in the axes that the car had at the first update."""
    places = tuple(moved(pose, (*attack.position, 0.0))[:2] for attack in attacks)
    return _Past(places, tuple((attack.distance, attack.angle_rad) for attack in attacks))


def moved(
    pose: tuple[float, float, float], motion: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Return the pose (x, y, yaw) of a car after a motion in its own axes."""
    x, y, yaw = pose
    cosine, sine = math.cos(yaw), math.sin(yaw)
    ahead, left, turn = motion
    return (x + cosine * ahead - sine * left, y + sine * ahead + cosine * left, yaw + turn)


def is_plausible(motion: tuple[float, float, float]) -> bool:
    """Return whether a motion is finite and at most 1e6 metres or radians."""
    return all(abs(value) <= _FARTHEST_M for value in motion)


_ROUNDING = 1e-12
"""Share of a product by which rounding may change it."""


def _level(factors: Sequence[float], p: RiskParameters) -> str:
    """Return the level at the geometric mean of the factors.

    Powers of the limits are compared, because the root of the product and a root that equals a
    limit would depend on the libm of the processor.
    """
    product = max(0.0, math.prod(factors))

    def reaches(limit: float) -> bool:
        return product >= (1.0 - _ROUNDING) * math.prod([limit] * len(factors))

    if not reaches(p.low):
        return "low"
    return "high" if reaches(p.high) else "medium"


def check_movement(speed_mps: float, motion: tuple[float, float, float]) -> None:
    """Raise InputError for a speed or a motion that `RiskTracker.update` cannot use."""
    _check_speed(speed_mps)
    if not all(math.isfinite(value) for value in motion):
        raise InputError(f"motion: expected finite numbers, got {motion}")
    if not is_plausible(motion):
        raise InputError(f"motion: expected at most {_FARTHEST_M:g} in a frame, got {motion}")


def _check_speed(speed_mps: float) -> None:
    if not (speed_mps >= 0.0 and math.isfinite(speed_mps)):
        raise InputError(f"speed_mps: expected a number >= 0, got {speed_mps}")

"""The touch cue: a ball strokes the phantom limb while the patient is touched, or out of step.

Section 8.3.4 describes it, after the rubber-hand illusion [Botvinick and Cohen 1998].
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from manip3d.errors import InputError

Mode = Literal["synchronous", "asynchronous"]
MODES: Sequence[Mode] = ("synchronous", "asynchronous")

SECONDS = 60.0  # length of a round of touches; the page says that it is a minute
TOUCH_S = 0.4  # seconds for which the ball stays on the limb
_PAUSES = (1.0, 1.8)  # seconds from the end of a touch to the next one
_DELAYS = (0.5, 0.9)  # seconds from the seen touch to the felt one in asynchronous mode

ARM = ("Elbow", "Wrist", "Hand")
LEG = ("Knee", "Ankle", "Foot")

STATEMENTS: Sequence[str] = (
    "It felt as if the limb that I saw were my own.",
    "It felt as if I was touched where I saw the ball touch the limb.",
    "It felt as if the ball that I saw caused the touch.",
    "It felt as if I had one limb more than I have.",
    "My own body felt as if it became stiff or unreal.",
    "The touch seemed to come from somewhere beside me.",
)
"""Questions, answered from -3 (not at all) to 3 (very much). The first three are about ownership;
the others are controls, which the cue should not change."""


@dataclass(frozen=True)
class Touch:
    """One touch.

    Attributes
    ----------
    joint : int
        Touched joint, 0 to 2, from the upper to the lower joint of the limb.
    seen, felt : float
        Seconds at which the ball touches the limb, and at which the patient is to be touched.
    """

    joint: int
    seen: float
    felt: float


def touches(mode: Mode, seed: int) -> tuple[Touch, ...]:
    """Return the touches of a minute; the same seed gives the same touches.

    Raises
    ------
    InputError
        No such mode, or a negative seed.
    """
    if mode not in MODES:
        raise InputError(f"mode: expected one of {', '.join(MODES)}, got {mode!r}")
    if seed < 0:
        raise InputError(f"seed: expected >= 0, got {seed}")
    chance = random.Random(seed)
    found: list[Touch] = []
    seen = 1.0
    while seen + TOUCH_S + _DELAYS[1] < SECONDS:
        joint, pause, delay = (
            chance.randrange(3),
            chance.uniform(*_PAUSES),
            chance.uniform(*_DELAYS),
        )
        felt = seen if mode == "synchronous" else seen + delay
        found.append(Touch(joint, round(seen, 3), round(felt, 3)))
        seen += TOUCH_S + pause
    return tuple(found)


class TouchCue:
    """One minute of touches; time passes only while the phantom limb is tracked.

    Attributes
    ----------
    mode : str
    clock : float, seconds
    """

    def __init__(self, mode: Mode, seed: int) -> None:
        self.mode = mode
        self.clock = 0.0
        self._touches = touches(mode, seed)
        self._coming = sorted(self._touches, key=lambda touch: touch.felt)
        self._felt = 0

    @property
    def is_over(self) -> bool:
        return self.clock >= SECONDS

    @property
    def due(self) -> Touch | None:
        """Return the next touch to be felt, for which the therapist can prepare."""
        return next((touch for touch in self._coming if touch.felt > self.clock), None)

    def pass_time(self, seconds: float) -> tuple[int | None, bool]:
        """Advance the clock; return the joint that the ball touches, and whether a touch is due."""
        self.clock = min(SECONDS, self.clock + seconds)
        seen = next(
            (t.joint for t in self._touches if t.seen <= self.clock < t.seen + TOUCH_S), None
        )
        before = self._felt
        self._felt = sum(t.felt <= self.clock for t in self._touches)
        return seen, self._felt > before

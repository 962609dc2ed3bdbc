"""Live sessions with a phantom limb, from camera frames to messages for a page, and their games.

Research software, no medical device.
"""

from __future__ import annotations

from manip3d.phantom import games
from manip3d.phantom._live import LiveReport, run_live, simulated_patient
from manip3d.phantom._messages import MESSAGES
from manip3d.phantom._recorder import GameSummary
from manip3d.phantom._session import LiveSession

__all__ = [
    "MESSAGES",
    "GameSummary",
    "LiveReport",
    "LiveSession",
    "games",
    "run_live",
    "simulated_patient",
]

"""The live phantom limb: a session from frames to what a page shows, and its games.

Research software, no medical device.
"""

from __future__ import annotations

from manip3d.phantom import games

__all__ = ["games"]

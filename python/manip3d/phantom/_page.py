"""The page of the live session: a frame of HTML around the script that npm builds."""

from __future__ import annotations

import json
from typing import Any

from manip3d.phantom.games import GAMES
from manip3d.rgbd import PARENTS
from manip3d.serve import Page, bundled_pages

INTENDED_USE = (
    "Research software for studies of phantom limb pain. It is not a medical device and is not "
    "meant for diagnosis or treatment."
)


def live_pages(limb: str, source: str, *, asks: bool = False) -> dict[str, Page]:
    """The page and what it loads, by path; ``asks``: it has a place to say how strong the pain is.

    Raises
    ------
    RenderError
        The script is not built.
    """
    content: dict[str, Any] = {
        "limb": limb.replace("_", " "),
        "source": source,
        "intended_use": INTENDED_USE,
        "asks": asks,
        "parents": PARENTS,
        "games": {
            game.name: {
                "title": game.title,
                "how": game.how,
                "rules": game.rules,
                "most_misses": game.most_misses,
            }
            for game in GAMES.values()
        },
    }
    text = json.dumps(content).replace("<", "\\u003c")
    body = f'<script type="application/json" id="manip3d-live">{text}</script>'
    return bundled_pages("live", f"Phantom {content['limb']}", body)

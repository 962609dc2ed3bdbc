"""The page of the live session: a frame of HTML around the script that npm builds."""

from __future__ import annotations

import html
import json
from pathlib import Path
from typing import Any

from manip3d.errors import RenderError
from manip3d.phantom.games import GAMES
from manip3d.rgbd import PARENTS
from manip3d.serve import Page
from manip3d.viewer.page import BUNDLE

INTENDED_USE = (
    "Research software for studies of phantom limb pain. It is not a medical device and is not "
    "meant for diagnosis or treatment."
)

_HTML = """\
<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<link rel="stylesheet" href="/live.css">
</head>
<body>
<noscript>The session needs JavaScript.</noscript>
<script type="application/json" id="manip3d-live">{content}</script>
<script src="/live.js"></script>
</body>
</html>
"""


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
    text = _HTML.format(
        title=html.escape(f"Phantom {content['limb']}"),
        content=json.dumps(content).replace("<", "\\u003c"),
    )
    return {
        "/": Page("text/html; charset=utf-8", text.encode()),
        "/live.js": Page("text/javascript; charset=utf-8", _built("live.js")),
        "/live.css": Page("text/css; charset=utf-8", _built("live.css")),
    }


def _built(name: str) -> bytes:
    path: Path = BUNDLE.parent / name
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise RenderError(
            f"the page is not built ({path} is missing): run 'make setup', or "
            f"'npm ci && npm run build' in {path.parents[1]}"
        ) from None

"""The page of the live session: HTML around the script that npm builds."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from typing import Any

from manip3d.phantom._felt import LIMITS
from manip3d.phantom._messages import LIMBS
from manip3d.phantom._touch import STATEMENTS
from manip3d.phantom.games import GAMES
from manip3d.rgbd import PARENTS
from manip3d.serve import Page, bundled_pages

INTENDED_USE = (
    "Research software for studies of phantom limb pain. It is not a medical device and is not "
    "meant for diagnosis or treatment."
)

HAZARDS: Sequence[tuple[str, str, str]] = (
    (
        "pain grows during a session",
        "starts no game before a rating; at 2 points more than the first rating, at any time "
        "since, it says stop, starts no further game that day, also after a restart, and notes "
        "an adverse event (only with a diary)",
        'ask; stop at any time with Stop, the space bar or "End this session"',
    ),
    (
        "sickness, a disturbing sight",
        '"I feel sick" stops the game; if it is confirmed, no game starts again that day and it '
        "is noted (only with a diary)",
        "stay with the patient; begin on a screen before a headset",
    ),
    (
        "a phantom limb in the wrong place",
        "the state of the tracking is shown in words; while the limb is not tracked, nothing "
        "can be hit or missed",
        "stop where the picture is not believable",
    ),
    (
        "falls, strain, a headset that hides the room",
        "games for legs are played sitting; difficulty begins at easy",
        "a chair that does not move; free space; support the wearer of a headset",
    ),
    (
        "somebody reads or changes the stored data",
        "pseudonyms, encryption of the diary on demand, an encrypted connection for other "
        "machines, an address that works once, for one browser, and a code on the page for a "
        "second browser",
        "keep keys elsewhere; encrypt the disk; exports and films are not encrypted",
    ),
    (
        "films of a patient",
        "none without consent; they show the person before a grey background, without the room; "
        "if the consent is withdrawn, they are deleted",
        "ask for consent on paper too; delete copies",
    ),
    (
        "data are lost",
        "each game is written when it begins, every 10 s and when it ends, and so is each "
        "rating; entries that cannot be written (full disk, locked file) are shown, tried again "
        "and, if that fails, listed at the end",
        "copies of the diary, and of its key",
    ),
    (
        "a participant withdraws",
        "diary delete removes every entry of the participant from the file (the audit keeps "
        "only the number of rows); exported files are listed, and removed with --exports",
        "delete other copies too",
    ),
)
"""Hazards: what can happen, what the software does about it, and what people must do.

README.md has the same table.
"""

_HAZARD_PAGE = """\
<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Intended use and hazards</title>
<link rel="stylesheet" href="/live.css">
</head>
<body class="document">
<div role="main">
<h1>Intended use and hazards</h1>
<p>{use} It is run by people who know the patients and the study's approval; no number of it is
advice on anybody's care.</p>
<table>
<tr><th>Hazard</th><th>What the software does</th><th>What people must do</th></tr>
{rows}
</table>
<p><a href="/">Back to the session</a></p>
</div>
</body>
</html>
"""


def live_pages(limb: str, source: str, *, asks: bool = False) -> dict[str, Page]:
    """Return the page and the files that it loads, by path; ``asks``: it asks for pain ratings.

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
        "limbs": LIMBS,
        "statements": STATEMENTS,
        "felt": {name: list(limits) for name, limits in LIMITS.items()},
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
    hazards = Page("text/html; charset=utf-8", _hazard_page().encode())
    return bundled_pages("live", f"Phantom {content['limb']}", body) | {"/hazards": hazards}


def _hazard_page() -> str:
    rows = "\n".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>"
        for row in HAZARDS
    )
    return _HAZARD_PAGE.format(use=html.escape(INTENDED_USE), rows=rows)

"""The page of results: each group and part has its own histograms."""

import re
from typing import Any

from manip3d.study._results import _cell, _histograms


def row(group: str, part: str, display: str, agreed: float | None, **more: Any) -> dict[str, Any]:
    scores = {f"score_{number}": number * (len(group) + len(part)) for number in range(1, 8)}
    return {
        "group": group, "part": part, "display": display, "question": "q1", "wording": "Is it < 3?",
        "agree_percent": agreed, "published_percent": None, **scores, **more,
    }  # fmt: skip


def test_each_group_and_part_shows_its_own_shares() -> None:
    rows = [
        row("experts", "arms", "vr", 80.0),
        row("experts", "arms", "tv", 70.0, published_percent=75),
        row("others", "arms", "vr", 60.0),
        row("others", "legs", "vr", None),
    ]
    page = _histograms(rows)
    parts = dict(re.findall(r"<h2>(.*?)</h2>(.*?)(?=<h2>|$)", page))
    told = {title: re.findall(r"</svg>(.*?)</td>", text) for title, text in parts.items()}
    assert told == {
        "arms (experts)": ["80.0 % agreed", "70.0 % agreed; published 75 %"],
        "arms (others)": ["60.0 % agreed"],
        "legs (others)": ["no answers"],
    }
    assert re.findall(r"<th>(.*?)</th>", parts["arms (experts)"]) == ["Question", "vr", "tv"]
    assert "Is it &lt; 3?" in parts["arms (others)"]


def test_the_bars_of_a_histogram_are_shares_of_the_highest() -> None:
    page = _histograms([row("g", "p", "vr", 50.0, **{f"score_{n}": n for n in range(1, 8)})])
    heights = [float(height) for height in re.findall(r'height="([\d.]+)"/>', page)]
    assert heights == [round(36 * n / 7, 1) for n in range(1, 8)]
    tops = [float(top) for top in re.findall(r'" y="([\d.]+)" width="14"', page)]
    assert all(abs(top + height - 40) < 0.11 for top, height in zip(tops, heights, strict=True))


def test_cells_of_tables() -> None:
    assert [_cell(value) for value in (None, 0.123456, 12, "a")] == ["", "0.1235", "12", "a"]

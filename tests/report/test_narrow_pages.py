"""Pages on a phone: text and tables stay within the width of the screen."""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from landmarks import assert_accessible
from manip3d import LidarFrame, authenticate, report
from manip3d.authenticate import EDITS
from manip3d.authenticate._edits import EDIT_MEANINGS
from manip3d.viewer import _chromium

LONG_NAME = "a_very_long_name_without_any_place_where_a_line_could_be_broken.bin"


def page_of_a_scan(folder: Path) -> Path:
    scan = authenticate.kitti_lattice()
    ring, count = np.divmod(np.arange(64 * 500), 500)
    points = scan.points_at(ring, 8 * count, 8 + 0.004 * count).round(3).astype(np.float32)
    file = folder / LONG_NAME
    points.tofile(file)
    found = authenticate.inspect(LidarFrame(points, ring=ring))
    report.write_evidence(found, folder / "evidence.html", source=str(file))
    return folder / "evidence.html"


def pages_of_a_diary(folder: Path) -> Path:
    pytest.importorskip("scipy", reason="the extra 'diary' is not installed")
    pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
    from manip3d.diary import Diary, write_overview

    start = datetime(2026, 3, 2, 9, tzinfo=UTC)
    with Diary(folder / "study.diary", create=True) as diary:
        for name in ("P01", "a-participant-with-a-long-name"):
            diary.enrol(name, limb="left_leg", at=start)
            diary.add_event(name, "sickness", "dizzy, had to sit down", at=start)
        write_overview(diary, folder / "pages", today=start.date())
    return folder / "pages" / "index.html"


@pytest.mark.parametrize("write", [page_of_a_scan, pages_of_a_diary])
def test_a_page_is_as_wide_as_a_phone(
    chromium: None, tmp_path: Path, write: Callable[[Path], Path]
) -> None:
    address = write(tmp_path).as_uri()
    with _chromium.open_address("about:blank", (500, 800)) as tab:
        tab.send(
            "Emulation.setDeviceMetricsOverride",
            width=390, height=844, deviceScaleFactor=1, mobile=True,
        )  # fmt: skip
        tab.send("Page.navigate", url=address)
        tab.evaluate(
            "new Promise(done => document.readyState === 'complete' ? done() "
            ": addEventListener('load', () => done()))"
        )
        assert tab.evaluate("document.body.innerText.length") > 100
        assert_accessible(tab.evaluate("document.documentElement.outerHTML"))
        assert tab.evaluate("document.documentElement.scrollWidth") == 390


def test_each_class_of_edits_is_explained() -> None:
    """Readers of the evidence page saw "along rays" and "bump" without a word about them."""
    assert set(EDIT_MEANINGS) == set(EDITS)


def luminance(color: str) -> float:
    """Relative luminance by WCAG 2."""
    share = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def test_faint_text_can_be_read_on_each_background() -> None:
    style = (Path(report.__file__).parent / "templates" / "style.css").read_text()
    for theme in style.split("prefers-color-scheme: dark")[:2]:
        faint, *grounds = (
            luminance(re.findall(rf"--{name}: ?(#\w{{6}})", theme)[0])
            for name in ("faint", "paper", "raised")
        )
        for ground in grounds:
            darker, lighter = sorted((faint, ground))
            assert (lighter + 0.05) / (darker + 0.05) >= 4.5

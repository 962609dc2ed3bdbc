"""Pages for the clinician: trends against other formulas, and an overview that withdrawal finds."""

from __future__ import annotations

import random
import re
import time
from datetime import UTC, date, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
pytest.importorskip("scipy", reason="the extra 'diary' is not installed")

from scipy import stats
from typer.testing import CliRunner

from manip3d import InputError
from manip3d.cli import app
from manip3d.diary import (
    Diary,
    DiaryGame,
    _page,
    export_clips,
    export_csv,
    write_overview,
    write_page,
)
from manip3d.diary._trends import Point, trend

START = datetime(2026, 3, 2, 9, 0, tzinfo=timezone(timedelta(hours=1)))
NUMBER = r"([-+][0-9.]+)"


def points_of(seed: int, number: int) -> list[Point]:
    chance = random.Random(seed)
    days = sorted(chance.uniform(0, 28) for _ in range(number))
    return [
        Point(day, 6 - 0.1 * day + chance.gauss(0, 1), START + timedelta(days=day)) for day in days
    ]


def play(diary: Diary, name: str, day: float, pain: int, *, source: str = "openni2:") -> None:
    """A session with a game of 12 points, 6 of them by the phantom limb."""
    at = START + timedelta(days=day)
    session = diary.start_session(name, at=at)
    diary.add_rating(name, pain, session=session, at=at)
    diary.begin_play(session, at=at)
    played = DiaryGame(
        at, "piano", 2, 1, "time", 60.0, 0.0, 12, 3, 6, source=source, tracked=0.875
    )  # fmt: skip
    diary.add_game(session, played)
    diary.add_rating(name, pain, session=session, at=at + timedelta(minutes=2))


def charts(page: str) -> dict[str, str]:
    found = re.findall(r'<figure class="trend">.*?</figure>', page, re.DOTALL)
    return {re.search("<b>(.*?)</b>", one)[1]: one for one in found}  # type: ignore[index]


@pytest.mark.parametrize(("seed", "number"), [(1, 3), (2, 8), (3, 40)])
def test_the_slope_and_its_interval_are_those_of_a_regression(seed: int, number: int) -> None:
    points = points_of(seed, number)
    days, values = [p.day for p in points], [p.value for p in points]
    line = stats.linregress(days, values)
    half = stats.t.ppf(0.975, number - 2) * line.stderr
    drawn = trend("Pain", points, first=0, last=28, top=10)
    told = re.search(rf"In a week {NUMBER} \(95 %: {NUMBER} to {NUMBER}\)", drawn)
    assert told is not None
    expected = [7 * line.slope, 7 * (line.slope - half), 7 * (line.slope + half)]
    assert [float(one) for one in told.groups()] == pytest.approx(expected, rel=0.06)  # 2 digits


def test_the_band_is_the_interval_of_the_line() -> None:
    """Compare the band with the covariance of the line's coefficients on two of its days."""
    points = points_of(5, 12)
    days, values = np.array([(p.day, p.value) for p in points]).T
    line, covariance = np.polyfit(days, values, 1, cov=True)  # scaled by s^2
    drawn = trend("Pain", points, first=0, last=28, top=10)
    ring = re.search('<polygon points="(.*?)"', drawn)[1].split()  # type: ignore[index]
    heights = [float(corner.split(",")[1]) for corner in ring]
    for at, high, low in ((days[0], 0, -1), (days[-1], 24, 25)):
        spread = np.sqrt(np.array([at, 1]) @ covariance @ np.array([at, 1]))
        half = stats.t.ppf(0.975, 10) * spread
        upper, lower = (
            (190 - 26 - y) / (190 - 26 - 12) * 10 for y in (heights[high], heights[low])
        )
        assert upper == pytest.approx(np.polyval(line, at) + half, abs=0.01)
        assert lower == pytest.approx(np.polyval(line, at) - half, abs=0.01)


def test_no_line_through_two_points_or_through_those_of_one_moment() -> None:
    for points in ([Point(0, 1, START), Point(5, 2, START)], [Point(3, 4, START)] * 4):
        drawn = trend("Pain", points, first=0, last=7, top=10)
        assert "Fewer than three points" in drawn
        assert "<polygon" not in drawn
        assert drawn.count("<circle") == len(points)


def test_the_minutes_of_one_day_are_no_trend(tmp_path: Path) -> None:
    """Three sessions of one day would be a slope of thousands a week, and an alarm."""
    points = [Point(hour / 24, hour, START + timedelta(hours=hour)) for hour in range(4)]
    assert "all of one day: no line" in trend("Pain", points, first=0, last=7, top=10)
    points.append(Point(1, 4, START + timedelta(days=1)))
    assert "<polygon" in trend("Pain", points, first=0, last=7, top=10)
    with Diary(tmp_path / "d", create=True) as diary:
        diary.enrol("P01", at=START)
        for hour in range(4):
            play(diary, "P01", hour / 24, 2 * hour)
        write_overview(diary, tmp_path / "pages", today=START.date())
    assert "pain before sessions grows" not in (tmp_path / "pages" / "index.html").read_text()


@pytest.mark.parametrize(
    ("slope", "told"), [(120.0, "+840"), (-1.5, "-10"), (0.05, "+0.35"), (1e-5, "+0"), (0.0, "+0")]
)
def test_slopes_have_no_exponents(slope: float, told: str) -> None:
    points = [Point(day, slope * day, START + timedelta(days=day)) for day in range(3)]
    drawn = trend("Points", points, first=0, last=7, top=None)
    assert re.search(rf"In a week {NUMBER} ", drawn)[1] == told  # type: ignore[index]


def test_people_who_differ_by_capital_letters_have_pages_of_their_own(tmp_path: Path) -> None:
    with Diary(tmp_path / "d", create=True) as diary:
        diary.enrol("P01")
        with pytest.raises(InputError, match="P01 is enrolled already"):
            diary.enrol("p01")
    # Diaries of before may hold them.
    names = _page._names_of_pages(["P01", "Q01-2", "Q01", "p01", "q01"])
    assert names == {
        "P01": "participant-P01.html", "Q01-2": "participant-Q01-2.html",
        "Q01": "participant-Q01.html", "p01": "participant-p01-2.html",
        "q01": "participant-q01-3.html",
    }  # fmt: skip


def test_who_is_enrolled_while_the_pages_are_written_is_on_the_next_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page_of = _page._page

    def slow(*arguments: Any, **options: Any) -> str:
        with Diary(tmp_path / "d") as other:
            other.enrol("P02")
        return page_of(*arguments, **options)

    monkeypatch.setattr(_page, "_page", slow)
    with Diary(tmp_path / "d", create=True) as diary:
        diary.enrol("P01")
        write_overview(diary, tmp_path / "pages")
        assert len(diary.participants()) == 2
    overview = (tmp_path / "pages" / "index.html").read_text()
    assert "1 enrolled" in overview
    assert "P02" not in overview


def test_a_page_has_the_trends_of_what_a_person_did(tmp_path: Path) -> None:
    with Diary(tmp_path / "d", create=True) as diary:
        diary.enrol("P01", at=START)
        for day in range(4):
            play(diary, "P01", day + 0.25, 6 - day)
        play(diary, "P01", 5, 10, source="sim:body")
        for week, occasion in enumerate(("baseline", "week-1")):
            rank = [2 - week] * 20
            diary.add_mcgill("P01", rank, 3, occasion=occasion, at=START + timedelta(days=7 * week))  # type: ignore[arg-type]
        write_page(diary, tmp_path / "P01.html", "P01", today=START.date() + timedelta(days=7))
    page = (tmp_path / "P01.html").read_text()
    found = charts(page)
    assert {title: one.count("<circle") for title, one in found.items()} == {
        "Pain before sessions, 0 to 10": 4,
        "Pain after sessions, 0 to 10": 4,
        "Score of piano, difficulty 2": 4,
        "Share of the points by the phantom limb, %": 4,
        "Frames in which the phantom limb was followed, %": 4,
        "McGill pain rating index, 0 to 78": 2,
    }
    assert "In a week -7 (95 %: -7 to -7)" in found["Pain before sessions, 0 to 10"]
    assert ">2026-03-02 15:00: 50</title>" in found["Share of the points by the phantom limb, %"]
    assert "2026-03-02 15:00: 87.5" in found["Frames in which the phantom limb was followed, %"]
    # The last day of the charts is that of the last questionnaire, seven days after the first.
    assert 'cx="42.0"' in found["McGill pain rating index, 0 to 78"]
    assert 'cx="408.0"' in found["McGill pain rating index, 0 to 78"]


def test_days_of_the_pages_are_those_of_this_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The evening of the first of March in a zone eight hours behind UTC, stamped in UTC."""
    evening = datetime(2026, 3, 2, 2, 0, tzinfo=UTC)
    monkeypatch.setenv("TZ", "XST8")
    time.tzset()
    try:
        with Diary(tmp_path / "d", create=True) as diary:
            diary.enrol("P01", at=evening)
            write_overview(diary, tmp_path / "pages", today=date(2026, 3, 4))
        noon = evening - timedelta(hours=6)  # another day in UTC, the same one here
        points = [Point.of(noon + timedelta(hours=3 * n), noon, n) for n in range(3)]
        assert "all of one day: no line" in trend("Pain", points, first=0, last=7, top=10)
    finally:
        monkeypatch.undo()
        time.tzset()
    text = (tmp_path / "pages" / "index.html").read_text()
    assert "0 of 8 (0%)" in text
    assert "No session for 3 days" in text


def test_the_overview_shows_who_needs_attention(tmp_path: Path) -> None:
    today = START.date() + timedelta(days=10)
    with Diary(tmp_path / "d", create=True) as diary:
        for name in ("worse", "index", "silent", "new"):
            diary.enrol(name, limb="left_leg", at=START)
        for day in range(11):
            play(diary, "worse", day, min(10, day))
            play(diary, "index", day, 5)
            play(diary, "silent", 0.1 * day, 5)
            play(diary, "new", day, day, source="sim:body")
        diary.add_event("index", "sickness", "<b>", at=START + timedelta(days=10))
        diary.add_event("silent", "other", "long ago", at=START + timedelta(days=3))
        write_overview(diary, tmp_path / "pages", today=today)
        text = (tmp_path / "pages" / "index.html").read_text()
        rows = {
            re.sub("<.*?>", "", cells[0]): cells[1:]
            for cells in (re.findall("<td>(.*?)</td>", row) for row in text.split("<tr>")[2:])
        }
        assert [rows[name][-1] for name in ("worse", "silent", "new")] == [
            '<span class="warning">The pain before sessions grows</span>',
            '<span class="warning">No session for 9 days</span>',
            '<span class="warning">No session for 10 days</span>',
        ]
        assert "No more games today; the patient was told: You feel sick." in rows["index"][-1]
        assert "1 adverse event in 7 days (sickness)" in rows["index"][-1]
        assert rows["worse"][3:5] == ["10 to 10", "+7.0 (+7.0 to +7.0)"]
        assert rows["new"][2:5] == ["-", "-", "-"]  # nobody played
        assert "<b>" not in text
        for name in rows:
            link = f"participant-{name}.html"
            assert f'href="{link}"' in text
            page = (tmp_path / "pages" / link).read_text()
            assert 'href="index.html"' in page
        files = {one.path.name for one in diary.exports("silent")}
        assert files == {"index.html", "participant-silent.html"}
        with pytest.raises(InputError, match="exists already; overwrite=True replaces it"):
            write_overview(diary, tmp_path / "pages")
        (tmp_path / "pages" / "notes.txt").write_text("mine")
        with pytest.raises(InputError, match=r"holds other files: notes\.txt"):
            write_overview(diary, tmp_path / "pages", overwrite=True)


def test_an_export_does_not_replace_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    with Diary(tmp_path / "d", create=True) as diary:
        diary.enrol("P01")
        before = len(diary.audit())
        for write in (write_overview, export_csv):
            with pytest.raises(InputError, match="expected another folder than the current one"):
                write(diary, ".", overwrite=True)
        with pytest.raises(InputError, match="expected another folder than the current one"):
            export_clips(diary, ".", "P01", overwrite=True)
        assert len(diary.audit()) == before  # no export is noted


def test_pages_of_a_diary_from_the_command_line(tmp_path: Path) -> None:
    path, pages = str(tmp_path / "d"), str(tmp_path / "pages")

    def run(*words: str) -> int:
        return CliRunner().invoke(app, ["diary", *words]).exit_code

    assert run("enrol", path, "P01") == run("enrol", path, "P02") == 0
    assert run("export", path, "-o", pages, "--pages") == 0
    assert run("export", path, "-o", pages, "--pages") == 1
    assert run("export", path, "-o", pages, "--pages", "--force") == 0
    assert run("export", path, "-o", f"{pages}.html", "--pages") == 1
    assert run("export", path, "-o", f"{pages}2", "--pages", "--participant", "P01") == 1
    assert run("delete", path, "P01", "--yes", "--exports") == 0
    assert [one.name for one in Path(pages).iterdir()] == ["participant-P02.html"]
    assert run("delete", path, "P02", "--yes", "--exports") == 0
    assert [one.name for one in tmp_path.iterdir()] == ["d"]

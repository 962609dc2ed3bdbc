"""The report: one page that loads nothing, says what was measured, and escapes what it is given."""

from __future__ import annotations

import json
import os
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from landmarks import assert_accessible
from manip3d import FormatError, InputError
from manip3d.experiments import run
from manip3d.report import write_alert_overview, write_report
from manip3d.report._tables import tables
from toy_experiments import all_below, experiment

EVIL = '<script>alert("x")</script>'
LOADING = {"src", "href", "data", "poster", "srcset", "action", "background"}


class Loads(HTMLParser):
    """Collects what a page would load, and its elements."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.elements: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.elements.add(tag)
        self.addresses += [value or "" for name, value in attributes if name in LOADING]


CLAIMS = [all_below(10), all_below(9)]


@pytest.fixture
def results(tmp_path: Path) -> Path:
    run([experiment(1, 2, 3, claims=CLAIMS)], tmp_path / "results", jobs=1)
    return tmp_path / "results"


@pytest.fixture
def one_failed(tmp_path: Path) -> Path:
    run([experiment(1, 2, 3, fail=2, claims=CLAIMS)], tmp_path / "results", jobs=1)
    return tmp_path / "results"


def edit(results: Path, change) -> None:
    path = results / "results.json"
    record = json.loads(path.read_text())
    change(record)
    path.write_text(json.dumps(record))


def page(results: Path) -> str:
    output = results.parent / "report.html"
    write_report(results, output)
    return output.read_text()


def test_the_page_loads_nothing(results: Path) -> None:
    text = page(results)
    assert_accessible(text)
    parsed = Loads(text)
    assert not {"script", "link", "iframe", "object", "embed"} & parsed.elements
    assert all(address.startswith(("#", "data:image/")) for address in parsed.addresses)
    assert "@import" not in text
    assert not re.search(r"url\((?!#)", text)
    assert "default-src 'none'" in text


def test_numbers_verdicts_and_environment_are_there(results: Path) -> None:
    text = page(results)
    for said in (
        "✓ holds",
        "✗ does not hold",
        "every square is below 9",
        "1 claim holds, 1 does not",
        "manip3d reproduce toy --data auto --scale full --seed 0",
        "No real data",
    ):
        assert said in text


def test_a_failed_case_leaves_its_claims_unjudged(one_failed: Path) -> None:
    text = page(one_failed)
    assert "– not judged" in text
    assert "✓ holds" not in text
    assert "(1 case failed)" in text
    assert "ValueError: no square for 2 today" in text
    assert "2 could not be judged since a case failed" in text


def test_what_a_badge_stands_on_is_said(results: Path) -> None:
    def pretend(record: dict) -> None:
        for verdict in record["experiments"]["toy"]["verdicts"]:
            for finding, data in zip(verdict["findings"], ("published", "stand-in", "simulated"),
                                     strict=True):  # fmt: skip
                finding["data"] = data
            verdict["source"] = "table 1"

    edit(results, pretend)
    text = page(results)
    for kind in ("published", "stand-in", "simulated"):
        assert f'<span class="score yes">{kind}</span>' in text
    assert '<span class="score no">simulated</span>' in text  # 9 is not below 9

    def leave_open(record: dict) -> None:
        record["experiments"]["toy"]["verdicts"][1]["word"] = "undecided"

    edit(results, leave_open)
    text = page(results)
    assert '<span class="score soft">simulated</span>' in text
    assert '<span class="badge soft">? undecided</span>' in text
    assert "1 is undecided (a stand-in or a simulated model says no" in text
    assert "<em>(holds on the published files)</em>" in text
    assert '<span class="score yes">stand-in</span>' in text


def test_no_name_keeps_its_underscores(results: Path) -> None:
    def poison(record: dict) -> None:
        toy = record["experiments"]["toy"]
        toy["rows"][0]["model"] = "a_b_c"
        toy["notes"] = ["a_b_c"]
        toy["verdicts"][0]["findings"][0]["subject"] = "a_b_c"

    edit(results, poison)
    assert "a_b_c" not in page(results)
    assert page(results).count("a b c") >= 3


def test_a_phone_reads_each_value_behind_its_heading(results: Path) -> None:
    text = page(results)
    assert '<td class="value" data-label="square">' in text
    assert "attr(data-label)" in text


@pytest.mark.parametrize("place", ["model", "error", "note", "claim", "finding", "title"])
def test_everything_is_escaped(results: Path, place: str) -> None:
    def poison(record: dict) -> None:
        toy = record["experiments"]["toy"]
        if place in ("model", "error"):
            toy["rows"][1][place] = EVIL
        elif place == "note":
            toy["notes"] = [EVIL]
        elif place == "title":
            toy["title"] = EVIL
        elif place == "claim":
            toy["verdicts"][0]["claim"] = EVIL
        else:
            toy["verdicts"][0]["findings"][0]["numbers"] = EVIL

    edit(results, poison)
    text = page(results)
    assert EVIL not in text
    assert "&lt;script&gt;" in text


def test_pictures_outside_the_folder_are_refused(results: Path) -> None:
    (results.parent / "secret.svg").write_text("<svg/>")

    def point_outside(record: dict) -> None:
        record["experiments"]["toy"]["figures"] = {"x": "../secret.svg"}

    edit(results, point_outside)
    with pytest.raises(FormatError, match="in the results folder"):
        page(results)


def test_markdown_has_the_table_and_the_verdicts(results: Path) -> None:
    edit(results, lambda record: record["experiments"]["toy"].update(title="a | b"))
    output = results.parent / "report.md"
    write_report(results, output)
    text = output.read_text()
    assert "## toy: a \\| b" in text
    assert "**does not hold**: every square is below 9" in text
    table = [line for line in text.splitlines() if line.startswith("|")]
    assert len({len(re.findall(r"(?<!\\)\|", line)) for line in table}) == 1


def test_csv_is_the_rows(results: Path) -> None:
    output = results.parent / "report.csv"
    write_report(results, output)
    assert output.read_text() == (results / "results.csv").read_text()


def test_unknown_suffix_and_foreign_folders_are_refused(results: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\.html, \.md, \.csv"):
        write_report(results, tmp_path / "report.pdf")
    with pytest.raises(InputError, match=r"no results\.json"):
        write_report(tmp_path, tmp_path / "report.html")
    (results / "results.json").write_text("[1, 2")
    with pytest.raises(FormatError, match="not JSON"):
        write_report(results, tmp_path / "report.html")
    (results / "results.json").write_text("[]")
    with pytest.raises(FormatError, match="running it again"):
        write_report(results, tmp_path / "report.html")


def test_headlines_are_ratios_on_published_files_only(results: Path) -> None:
    def pretend(record: dict) -> None:
        toy = record["experiments"]["toy"]
        column = toy["columns"][1] | {"published": "printed", "digits": 3, "scale": 1.0}
        toy["columns"] = [column | {"name": "a"}, column | {"name": "b", "ratio": False}]
        for row, same in zip(toy["rows"], (True, False, False), strict=True):
            data = "published" if same else "stand-in"
            row |= {"method": "qem4vr", "data": data, "stands_in_for": "Head", "error": ""}
            row |= {"a": 3.0, "b": 5.0, "printed": 4.0}

    edit(results, pretend)
    text = page(results)
    cards = text[text.index('class="headlines"') : text.index('<section id="toy">')]
    assert cards.count('class="card"') == 1
    assert "× 0.75" in cards
    assert "of the published Head, another file" in text


@pytest.mark.parametrize(
    ("sources", "names"),
    [
        (["cars/a/drive/", "cars/b/x/drive", "cars/c/tour"], ["a/drive", "b/x/drive", "tour"]),
        (["/day/drive", "drive"], ["/day/drive", "drive"]),  # no folder in common
        (["drive", "drive/drive"], ["drive", "drive/drive"]),
        (["a/drive", "a/drive"], ["drive", "drive"]),
        (["sim:street?seed=1", "sim:street?seed=2"], ["sim:street?seed=1", "sim:street?seed=2"]),
    ],
)
def test_vehicles_with_folders_of_one_name_are_told_apart(
    sources: list[str], names: list[str], tmp_path: Path
) -> None:
    page = tmp_path / "overview.html"
    write_alert_overview([{"source": each, "error": "no such drive"} for each in sources], page)
    assert_accessible(page.read_text())
    assert re.findall("<h2>(.*?): <span", page.read_text()) == names


def test_the_overview_links_pages_whose_names_are_not_utf_8(tmp_path: Path) -> None:
    name = os.fsdecode(b"drive\xe9")
    record = {"source": name, "error": "no such drive", "page": f"{name}.html"}
    write_alert_overview([record], tmp_path / "overview.html")
    assert "<a href='drive%E9.html'>drive\\udce9</a>" in (tmp_path / "overview.html").read_text()


def test_a_drive_that_failed_without_a_word_has_failed(tmp_path: Path) -> None:
    write_alert_overview([{"source": "car", "error": ""}], tmp_path / "overview.html")
    assert "<span class=failed>failed</span>" in (tmp_path / "overview.html").read_text()


@pytest.mark.parametrize(
    ("drive", "message"),
    [
        ({"verdict": "processed"}, r"drives\[1\]: expected one of the verdicts failed, tampered, "),
        ({"error": "torn"}, r"drives\[1\]: expected the field 'source', got error"),
        ({"source": "b", "verdict": "tampered", "reason": ""}, "expected the field 'frames'"),
    ],
)
def test_a_drive_that_cannot_be_ranked_is_named(
    drive: dict[str, object], message: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        write_alert_overview([{"source": "a"}, drive], tmp_path / "overview.html")


@pytest.mark.parametrize(
    ("rows", "kinds"),
    [
        ([(1.0, {"reached": False}), (1.0, {}), (2.0, {})], ["value", "best", "value"]),
        ([(0.5, {"error": "boom"}), (1.0, {}), (2.0, {})], ["word", "best", "value"]),
    ],
)
def test_only_a_row_that_counts_is_the_best(
    rows: list[tuple[float, dict[str, object]]], kinds: list[str]
) -> None:
    column = {"name": "err", "title": "error", "lower_is_better": True, "scale": 1.0, "digits": 2,
              "published": "printed", "ratio": False, "words": {}}  # fmt: skip
    record = {
        "rows": [{"model": "m", "err": value, "data": "published"} | more for value, more in rows],
        "columns": [column],
    }
    (table,) = tables(record)
    assert [cell.kind for row in table.groups[0].rows for cell in row] == kinds

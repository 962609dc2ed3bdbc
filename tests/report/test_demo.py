"""The demo's page: stories first, each with its commands, then the numbers."""

from __future__ import annotations

import dataclasses
import importlib.util
import io
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from landmarks import assert_accessible
from manip3d import MissingExtraError, cli
from manip3d.experiments import Case, Experiment, Plan, Row
from manip3d.report import demo
from toy_experiments import all_below, experiment

COMMAND = "manip3d simplify a.obj --ratio 0.1 -o b.glb"


def tell(case: Case) -> Row:
    """A story whose picture is one grey pixel."""
    from PIL import Image

    if case.options["story"] == "scan":
        raise RuntimeError("nobody was there")
    stream = io.BytesIO()
    Image.new("RGB", (8, 8), (90, 90, 90)).save(stream, "WEBP")
    return {"facts": ["It is <b>grey</b>."], "captions": ["grey"], "picture_0": stream.getvalue()}


def story(name: str) -> Experiment:
    def cases(_: Plan) -> list[Case]:
        options = {"model": name, "story": name, "commands": [COMMAND], "data": "simulated",
                   "role": "a toy"}  # fmt: skip
        return [Case(tell, options)]

    return Experiment(f"story-{name}", f"The story of {name}", "", (), cases, ())


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> None:
    claims = [dataclasses.replace(all_below(9), source="table 1")]
    monkeypatch.setattr(demo, "STORIES", tuple(map(story, ("model", "depth", "scan"))))
    monkeypatch.setattr(demo, "NUMBERS", ("toy",))
    monkeypatch.setattr(demo, "select", lambda _: [experiment(1, 2, 3, claims=claims)])


class Sources(HTMLParser):
    """Collects what a page loads."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.elements: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.elements.append(tag)
        self.addresses += [v or "" for k, v in attributes if k in ("src", "href", "srcset")]


@pytest.mark.usefixtures("toy")
def test_stories_come_first_with_pictures_and_commands(tmp_path: Path) -> None:
    done = demo.run_demo(tmp_path / "demo", jobs=1)
    text = done.page.read_text()
    places = [text.index(f'id="{name}"') for name in ("model", "depth", "scan", "numbers", "toy")]
    assert places == sorted(places)
    assert_accessible(text)
    assert text.count(f"<code>{COMMAND}</code>") == 3
    assert text.count("data:image/webp;base64,") == 2
    assert "This story could not be told here: RuntimeError: nobody was there" in text
    assert "It is &lt;b&gt;grey&lt;/b&gt;." in text
    assert "manip3d demo --data auto --seed 0" in text
    parsed = Sources(text)
    assert not {"script", "link", "iframe"} & set(parsed.elements)
    assert all(address.startswith(("#", "data:image/")) for address in parsed.addresses)
    assert not re.search(r"url\((?!#)", text)


@pytest.mark.usefixtures("toy")
def test_what_fails_on_a_simulated_model_is_not_red(tmp_path: Path) -> None:
    text = demo.run_demo(tmp_path / "demo", jobs=1).page.read_text()
    assert '<span class="badge soft">? undecided</span>' in text
    assert "<em>(the published files are not here)</em>" in text
    assert 'class="badge no"' not in text


@pytest.mark.usefixtures("toy")
def test_a_second_run_reuses_everything_that_did_not_fail(tmp_path: Path) -> None:
    first = demo.run_demo(tmp_path / "demo", jobs=1)
    assert (first.summary.cases, first.summary.resumed, first.summary.failed) == (6, 0, 1)
    assert demo.run_demo(tmp_path / "demo", jobs=1).summary.resumed == 5


@pytest.mark.usefixtures("toy")
def test_the_command_says_what_it_does_and_fails_with_a_story(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        cli.main(["demo", "-o", str(tmp_path / "demo"), "--jobs", "1"])
    assert stopped.value.code == 1
    said = capsys.readouterr().err
    assert " 17%  model" in said
    assert "100%  n3 square" in said
    assert f"page: {tmp_path / 'demo' / 'demo.html'}" in said


def test_missing_packages_are_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = importlib.util.find_spec
    missing = {"open3d", "jinja2"}
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name in missing else found(name)
    )
    with pytest.raises(MissingExtraError, match=r"jinja2, open3d are needed here"):
        demo.run_demo(tmp_path / "demo")
    assert not (tmp_path / "demo").exists()
    with pytest.raises(SystemExit) as stopped:
        cli.main(["demo", "-q", "-o", str(tmp_path / "demo")])
    assert stopped.value.code == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("manip3d: error: ")
    assert line.endswith(" are needed here: pip install 'manip3d[demo]'")
    assert "jinja2" in line
    assert "open3d" in line


def test_without_a_renderer_chromium_will_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "pyvista" else found(name)
    )
    monkeypatch.setattr(demo.shutil, "which", lambda name: f"/usr/bin/{name}")
    demo._require_packages()
    monkeypatch.setattr(demo.shutil, "which", lambda _: None)
    with pytest.raises(MissingExtraError, match="pyvista is needed here"):
        demo._require_packages()


def test_the_numbers_are_experiments_that_need_no_figures() -> None:
    """Figures would need matplotlib, which the demo does without."""
    from manip3d.experiments import registry

    assert all(registry()[name].figures is None for name in demo.NUMBERS)

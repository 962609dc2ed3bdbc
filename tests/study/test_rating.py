"""Ratings: the published composition, stimuli of the package's own, confusion and agreement."""

from __future__ import annotations

import csv
import hashlib
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from landmarks import assert_accessible
from manip3d import FormatError, InputError
from manip3d.study import (
    PUBLISHED_COMPOSITION,
    Answer,
    RatingStudy,
    Session,
    StudyFolder,
    copy_rating_stimuli,
    fleiss_kappa,
    fleiss_kappa_interval,
    make_rating_stimuli,
    read_study,
    share_interval,
    simulate_participants,
    study_of,
    write_results,
    write_template,
)
from manip3d.study._rating import COLUMNS, Item
from manip3d.study._stimuli import _scan_surface

# Fourteen raters, ten items, five categories: the worked example of textbooks.
EXAMPLE = [
    [0, 0, 0, 0, 14],
    [0, 2, 6, 4, 2],
    [0, 0, 3, 5, 6],
    [0, 3, 9, 2, 0],
    [2, 2, 8, 1, 1],
    [7, 7, 0, 0, 0],
    [3, 2, 6, 3, 0],
    [2, 5, 3, 2, 2],
    [6, 5, 2, 1, 0],
    [0, 2, 2, 3, 7],
]


def test_kappa_is_that_of_the_worked_example() -> None:
    assert round(fleiss_kappa(EXAMPLE), 3) == 0.210


def test_kappa_against_pairs_of_raters() -> None:
    # Agreement of all pairs of raters, counted one by one.
    rng = np.random.default_rng(0)
    ratings = rng.integers(3, size=(25, 6))
    counts = [[int((row == c).sum()) for c in range(3)] for row in ratings]
    pairs = [row[a] == row[b] for row in ratings for a in range(6) for b in range(a)]
    chance = sum((np.mean(ratings == c)) ** 2 for c in range(3))
    assert math.isclose(fleiss_kappa(counts), (np.mean(pairs) - chance) / (1 - chance))


def test_the_interval_of_kappa_is_narrower_with_more_items() -> None:
    rng = np.random.default_rng(1)
    few, many = (rng.multinomial(6, [0.6, 0.2, 0.2], size=n) for n in (12, 400))
    wide, narrow = fleiss_kappa_interval(few), fleiss_kappa_interval(many)
    assert narrow.high - narrow.low < 0.5 * (wide.high - wide.low)
    assert wide.low <= wide.value <= wide.high
    assert fleiss_kappa_interval(few) == wide


def test_one_category_alone_has_no_kappa() -> None:
    assert math.isnan(fleiss_kappa([[4, 0], [4, 0]]))
    assert math.isnan(fleiss_kappa_interval([[4, 0], [4, 0]]).low)


@pytest.mark.parametrize("counts", [[], [[1, 0]], [[2, 1], [1, 1]], [[-1, 3]], [[1.5, 1.5]]])
def test_tables_that_are_none_are_refused(counts: list[list[float]]) -> None:
    with pytest.raises(InputError, match="counts: expected"):
        fleiss_kappa(counts)


def test_shares_have_wilson_intervals() -> None:
    assert [round(x, 4) for x in share_interval(0, 10)] == [0.0, 0.0, 0.2775]
    assert [round(x, 4) for x in share_interval(15, 20)] == [0.75, 0.5313, 0.8881]
    with pytest.raises(InputError, match="hits, count"):
        share_interval(3, 2)


def folder_of(path: Path, items: list[tuple[str, ...]]) -> Path:
    """A folder of stimuli with one grey picture for each item."""
    image = pytest.importorskip("PIL.Image")
    path.mkdir()
    with (path / "stimuli.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(COLUMNS)
        for number, item in enumerate(items):
            name = f"s{number:03d}.png"
            image.new("RGB", (40, 30), (number, 90, 90)).save(path / name)
            writer.writerow([name, *item])
    return path


def published_items() -> list[tuple[str, ...]]:
    return [
        (truth, modality, form, resolution, "", "0")
        for (form, modality, resolution), counts in PUBLISHED_COMPOSITION.items()
        for truth, count in counts.items()
        for _ in range(count)
    ]


def template(folder: Path, composition: str = "published") -> Path:
    file = write_template("rating", folder / "study.toml", example=True)
    text = file.read_text().replace('composition = "published"', f'composition = "{composition}"')
    file.write_text(text)
    return file


def test_the_published_composition() -> None:
    images: dict[str, int] = {}
    for (form, modality, _), counts in PUBLISHED_COMPOSITION.items():
        if form == "image":
            images[modality] = sum(counts.values())
    assert images == {"depth": 40, "color": 40, "rendered": 20}
    clips = [c for (form, _, _), c in PUBLISHED_COMPOSITION.items() if form == "clip"]
    assert all(counts == {"real": 2, "type1": 2, "type2": 2} for counts in clips)


def test_another_composition_is_refused_unless_it_is_meant(tmp_path: Path) -> None:
    folder_of(tmp_path / "stimuli", published_items()[1:])
    with pytest.raises(FormatError, match="expected the published composition"):
        read_study(template(tmp_path))
    study, _ = read_study(template(tmp_path, "any"))
    assert isinstance(study, RatingStudy)
    assert len(study.items) == len(published_items()) - 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.replace("real", "genuine", 1), "line 2: truth: expected real, type1"),
        (lambda t: t.replace("s001.png", "../s.png"), "line 3: file: expected a name"),
        (lambda t: t.replace("s001.png", "s000.png"), "line 3: s000.png is there twice"),
        (lambda t: t.replace("s001.png", "other.png"), "line 3: there is no file other.png"),
        (lambda t: t.replace("s001.png", "s001.svg"), "line 3: file: expected a name"),
        (lambda t: t.replace("file,", "name,", 1), "line 1: expected file,truth"),
        (lambda t: t + "a.png,real\n", "expected 7 columns, got 2"),
        (lambda t: t + '"', "expected CSV"),
        (lambda t: "", "line 1: expected"),
    ],
)
def test_lists_of_stimuli_are_read_strictly(
    change: Callable[[str], str], message: str, tmp_path: Path
) -> None:
    folder = folder_of(tmp_path / "stimuli", [("real", "depth", "image", "full", "", "0")] * 3)
    listed = folder / "stimuli.csv"
    listed.write_text(change(listed.read_text()))
    with pytest.raises(FormatError, match=message):
        read_study(template(tmp_path, "any"))


def test_a_list_of_stimuli_may_be_saved_by_a_spreadsheet(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "stimuli", [("real", "depth", "image", "full", "", "0")] * 3)
    study, _ = read_study(template(tmp_path, "any"))
    listed = folder / "stimuli.csv"
    listed.write_text("sep=;\n" + listed.read_text().replace(",", ";") + ";;;;;;\n")
    saved, _ = read_study(template(tmp_path, "any"))
    assert isinstance(study, RatingStudy)
    assert isinstance(saved, RatingStudy)
    assert saved.items == study.items
    listed.write_text(listed.read_text().replace("truth", "thruth"))
    with pytest.raises(FormatError, match="line 2: expected file,truth"):
        read_study(template(tmp_path, "any"))


def test_a_missing_list_of_stimuli_says_what_makes_it(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected a list of stimuli, .*'manip3d study stimuli'"):
        read_study(template(tmp_path))


def test_orders_differ_between_participants_and_not_between_runs(tmp_path: Path) -> None:
    folder_of(tmp_path / "stimuli", published_items())
    study, _ = read_study(template(tmp_path))
    assert isinstance(study, RatingStudy)
    orders = [[s.id for s in study.steps(Session(f"P{n}", n))] for n in (0, 1, 0)]
    assert orders[0] == orders[2] != orders[1]
    assert sorted(orders[0]) == sorted(orders[1])
    step = study.steps(Session("P0", 0))[0]
    told = str(step.message(px_per_degree=None))
    for word in (".png", "type1", "type2", "truth", "depth", "rendered"):
        assert word not in told


def test_confusion_and_the_published_share_beside_it(tmp_path: Path) -> None:
    items = [("real", "color", "clip", "low", "", "0"), ("type1", "color", "clip", "low", "", "0")]
    folder_of(tmp_path / "stimuli", items)
    study, _ = read_study(template(tmp_path, "any"))
    assert isinstance(study, RatingStudy)
    # By hand: both see through the forgery; on the real one they differ.
    told = {"A": ("real", "manipulated"), "B": ("undecidable", "manipulated")}
    sessions = []
    for number, (code, verdicts) in enumerate(told.items()):
        session = Session(code, number)
        steps = {s.condition["file"]: s for s in study.steps(session)}
        for item, verdict in zip(study.items, verdicts, strict=True):
            step = steps[item.file]
            values = {"verdict": verdict, "reason": ""}
            session.answers.append(Answer(step.id, step.condition, values))
        sessions.append(session)
    real, forged, both = study.summary(sessions)
    assert (real["real"], real["manipulated"], real["undecidable"]) == (1, 0, 1)
    assert (forged["manipulated"], forged["right_percent"]) == (2, 100.0)
    assert (both["right_percent"], both["undecidable_percent"]) == (75.0, 25.0)
    assert both["published_unable_percent"] == 76.0
    assert "published_unable_percent" not in real
    assert both["raters"] == 2
    assert math.isclose(both["kappa"], fleiss_kappa([[1, 0, 1], [0, 2, 0]]))


@pytest.mark.parametrize("rated", [1, 3, 39])
def test_kappa_is_of_those_who_have_finished(rated: int, tmp_path: Path) -> None:
    items = [
        (truth, "color", "image", "full", "", "0") for truth in ("real", "type1") for _ in range(20)
    ]
    folder_of(tmp_path / "stimuli", items)
    study, _ = read_study(template(tmp_path, "any"))
    assert isinstance(study, RatingStudy)
    rng = np.random.default_rng(4)
    sessions = [Session(f"P{number}", number) for number in range(10)]
    counts = {item.file: [0, 0, 0] for item in study.items}
    for session in sessions:
        for step in study.steps(session):
            values = study.simulate(session, step, rng)
            session.answers.append(Answer(step.id, step.condition, values))
            place = ("real", "manipulated", "undecidable").index(str(values["verdict"]))
            counts[str(step.condition["file"])][place] += 1
    *_, whole = study.summary(sessions)
    assert (whole["raters"], whole["items"]) == (10, 40)
    assert math.isclose(whole["kappa"], fleiss_kappa(list(counts.values())))
    early = Session("P10", 10)
    for step in study.steps(early)[:rated]:
        early.answers.append(Answer(step.id, step.condition, {"verdict": "real", "reason": None}))
    *_, row = study.summary([*sessions, early])
    for name in ("raters", "items", "kappa", "kappa_low", "kappa_high"):
        assert row[name] == whole[name]
    assert row["real"] == whole["real"] + rated  # their answers count where single ones do
    *_, alone = study.summary([early])
    assert (alone["raters"], alone["items"], alone["kappa"]) == (0, 0, None)


def test_results_without_the_stimuli(tmp_path: Path) -> None:
    folder_of(tmp_path / "stimuli", published_items())
    study, content = read_study(template(tmp_path))
    with StudyFolder(tmp_path / "answers", content) as folder:
        simulate_participants(study, folder, 6)
    for file in (tmp_path / "stimuli").iterdir():
        file.unlink()
    with StudyFolder(tmp_path / "answers") as folder:
        results = write_results(study_of(folder.definition), folder, tmp_path / "results")
    with (results / "summary.csv").open(newline="", encoding="utf-8-sig") as stream:
        rows = list(csv.DictReader(stream))
    low = next(r for r in rows if r["resolution"] == "low" and r["truth"] == "all")
    assert low["published_unable_percent"] == "76.0"
    assert low["raters"] == "6"
    assert 0 < float(low["undecidable_percent"]) < 100  # measured: of 36 simulated answers
    page = (results / "summary.html").read_text()
    assert_accessible(page)
    assert "6 of them are simulated" in page


def test_stimuli_that_change_between_participants_are_told(tmp_path: Path) -> None:
    folder_of(tmp_path / "stimuli", [("real", "depth", "image", "full", "", "0")] * 3)
    file, stimulus = template(tmp_path, "any"), tmp_path / "stimuli" / "s001.png"
    before = stimulus.read_bytes()
    _, content = read_study(file)
    with StudyFolder(tmp_path / "a", content):
        pass
    stored = json.loads((tmp_path / "a" / "study.json").read_text())
    assert stored["sha256"]["s001.png"] == hashlib.sha256(before).hexdigest()
    assert len(stored["sha256"]) == 3
    # Nobody has seen it yet.
    stimulus.write_bytes(before + b"x")
    with StudyFolder(tmp_path / "a", read_study(file)[1]) as folder:
        folder.begin("P1")
    stimulus.write_bytes(before)
    with pytest.raises(InputError, match=r"holds answers to another file s001\.png, of SHA-256"):
        StudyFolder(tmp_path / "a", content)
    stimulus.write_bytes(before + b"x")
    with StudyFolder(tmp_path / "a", read_study(file)[1]) as folder:
        assert list(folder.sessions) == ["P1"]
        study_of(folder.definition)
    # A study of before there were checksums goes on.
    del stored["sha256"]
    (tmp_path / "a" / "study.json").write_text(json.dumps(stored))
    with StudyFolder(tmp_path / "a", content) as folder:
        assert "sha256" not in folder.definition
    (tmp_path / "a" / "study.json").write_text(json.dumps(stored | {"sha256": [1]}))
    with pytest.raises(FormatError, match="expected an object"):
        StudyFolder(tmp_path / "a", content)


def test_stimuli_of_the_package_are_of_their_kinds(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")
    composition = {
        ("image", "depth", "full"): {"real": 1},
        ("image", "rendered", "full"): {"type2": 1},
        ("clip", "color", "low"): {"type1": 1},
    }
    folder = tmp_path / "stimuli"
    made = make_rating_stimuli(
        folder, composition=composition, frames=3, examples=False, surfaces=1, seed=5
    )
    truths = ["added", "deformed", "real", "real", "type1", "type2"]
    assert sorted(i.truth for i in made) == truths
    for item in made:
        with image.open(folder / item.file) as picture:
            frames = getattr(picture, "n_frames", 1)
            assert frames == (3 if item.form == "clip" else 1)
            assert (picture.width == 160) == (item.resolution == "low")
            pixels = np.asarray(picture.convert("RGB"))
        assert pixels.std() > 5
    # Names are in an order by chance, which tells nothing.
    assert [i.file for i in made] == sorted(i.file for i in made)
    again = make_rating_stimuli(
        tmp_path / "again", composition=composition, frames=3, examples=False, surfaces=1, seed=5
    )
    assert again == made
    for item in made:
        assert (folder / item.file).read_bytes() == (tmp_path / "again" / item.file).read_bytes()
    study, _ = read_study(template(tmp_path, "any"))
    assert isinstance(study, RatingStudy)
    assert study.items == made
    with pytest.raises(InputError, match=r"exists already; overwrite=True"):
        make_rating_stimuli(folder)


def test_forged_surfaces_differ_from_the_real_one_in_a_part() -> None:
    pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")
    real, *forged = (_scan_surface(each, 3).astype(int) for each in ("real", "added", "deformed"))
    for surface in forged:
        share = (np.abs(surface - real).max(axis=-1) > 8).mean()
        assert 0.003 < share < 0.3


def test_compositions_are_checked(tmp_path: Path) -> None:
    wrong = {("image", "sound", "full"): {"real": 1}}
    with pytest.raises(InputError, match="composition: image, sound, full"):
        make_rating_stimuli(tmp_path / "a", composition=wrong)
    with pytest.raises(InputError, match="frames, surfaces"):
        make_rating_stimuli(tmp_path / "a", frames=1)
    with pytest.raises(InputError, match="seed: expected 0 or more, got -1"):
        make_rating_stimuli(tmp_path / "a", seed=-1)
    for count in (-1, 1.5):
        few: Any = {("image", "color", "full"): {"real": count}}
        with pytest.raises(InputError, match="full: expected a whole number of real from 0 on"):
            make_rating_stimuli(tmp_path / "a", composition=few)
    with pytest.raises(InputError, match=r"composition: expected 1 to 10000 .*, got 0"):
        make_rating_stimuli(tmp_path / "a", composition={}, examples=False)
    assert not (tmp_path / "a").exists()


def own_images(folder: Path) -> Path:
    """Pictures and a clip in folders that say what they are."""
    for number, place in enumerate(
        ("real/a.png", "real/depth/a.PNG", "type1/b.jpg", "type2/low/c.webm", "real/example/d.png")
    ):
        file = folder / place
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(b"picture %d" % number)
    (folder / ".hidden").write_text("x")
    return folder


@pytest.mark.parametrize("place", ["mine", "study"])
def test_stimuli_replace_a_folder_of_stimuli_only(tmp_path: Path, place: str) -> None:
    """Pictures of one's own within the folder, or the definition beside them, would be lost."""
    folder = tmp_path / "study"
    images = folder / "mine" if place == "mine" else tmp_path / "images"
    (images / "real").mkdir(parents=True)
    (images / "real" / "a.png").write_bytes(b"mine")
    folder.mkdir(exist_ok=True)
    if place == "study":
        copy_rating_stimuli(images, folder, overwrite=True)
        copy_rating_stimuli(images, folder, seed=1, overwrite=True)
        (folder / "study.toml").write_text("mine")
    before = sorted(folder.rglob("*"))
    with pytest.raises(InputError, match="holds other files"):
        copy_rating_stimuli(images, folder, overwrite=True)
    with pytest.raises(InputError, match="holds other files"):
        make_rating_stimuli(folder, overwrite=True)
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize(
    "table", [b'file,truth\n"a.png,real\n', "file,truth\na.png,real\n".encode("utf-16")]
)
def test_stimuli_whose_table_cannot_be_read_are_not_replaced(tmp_path: Path, table: bytes) -> None:
    """Only the table tells the stimuli from files of one's own; the advice was to replace them."""
    images, folder = own_images(tmp_path / "mine"), tmp_path / "stimuli"
    made = copy_rating_stimuli(images, folder)
    (folder / "stimuli.csv").write_bytes(table)
    before = sorted(folder.rglob("*"))
    with pytest.raises(FormatError, match=f"mend it, or delete {folder} if nothing in it is to be"):
        copy_rating_stimuli(images, folder, overwrite=True)
    assert sorted(folder.rglob("*")) == before
    for item in made:
        (folder / item.file).unlink()
    assert len(copy_rating_stimuli(images, folder, overwrite=True)) == len(made)


def test_stimuli_of_ones_own_get_names_that_tell_nothing(tmp_path: Path) -> None:
    images = own_images(tmp_path / "mine")
    made = copy_rating_stimuli(images, tmp_path / "stimuli", seed=3)
    told = {(i.truth, i.modality, i.form, i.resolution, i.example) for i in made}
    assert told == {
        ("real", "color", "image", "full", False),
        ("real", "depth", "image", "full", False),
        ("type1", "color", "image", "full", False),
        ("type2", "color", "clip", "low", False),
        ("real", "color", "image", "full", True),
    }
    low = next(i for i in made if i.resolution == "low")
    assert (tmp_path / "stimuli" / low.file).read_bytes() == b"picture 3"
    assert all(len(Path(i.file).stem) == 6 for i in made)
    study, _ = read_study(template(tmp_path, "any"))
    assert isinstance(study, RatingStudy)
    assert study.items == made
    again = copy_rating_stimuli(images, tmp_path / "again", seed=3)
    assert again == made
    with pytest.raises(InputError, match=r"exists already; overwrite=True"):
        copy_rating_stimuli(images, tmp_path / "stimuli")


def test_an_animated_webp_is_a_clip(tmp_path: Path) -> None:
    pillow = pytest.importorskip("PIL.Image")
    folder = tmp_path / "mine" / "real"
    folder.mkdir(parents=True)
    first, second = (pillow.new("RGBA", (8, 8), (shade, 0, 0, shade)) for shade in (50, 90))
    first.save(folder / "moves.webp", save_all=True, append_images=[second])
    first.save(folder / "still.webp", exif=b"Exif")  # has the extended header, too
    made = copy_rating_stimuli(tmp_path / "mine", tmp_path / "stimuli")
    forms = {(tmp_path / "stimuli" / i.file).read_bytes(): i.form for i in made}
    assert forms[(folder / "moves.webp").read_bytes()] == "clip"
    assert forms[(folder / "still.webp").read_bytes()] == "image"


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("a.png", "expected a folder of real, type1"),
        ("fake/a.png", "got 'fake'"),
        ("real/a.txt", "expected a name that ends in .png"),
        ("real/a.ply", "expected a name that ends in .png"),
        ("real/other/a.png", "expected folders of color, depth"),
        ("real/depth/color/a.png", "expected folders of color, depth"),
    ],
)
def test_folders_of_images_that_say_nothing_are_refused(
    place: str, message: str, tmp_path: Path
) -> None:
    file = tmp_path / "mine" / place
    file.parent.mkdir(parents=True)
    file.write_bytes(b"x")
    with pytest.raises(InputError, match=message):
        copy_rating_stimuli(tmp_path / "mine", tmp_path / "stimuli")
    assert not (tmp_path / "stimuli").exists()


def test_folders_without_images_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="images: expected a folder"):
        copy_rating_stimuli(tmp_path / "none", tmp_path / "stimuli")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="expected 1 to 10000 files, found 0"):
        copy_rating_stimuli(tmp_path / "empty", tmp_path / "stimuli")
    images = own_images(tmp_path / "mine")
    with pytest.raises(InputError, match="not within it"):
        copy_rating_stimuli(images, images / "stimuli")


def test_answers_may_be_read_while_a_study_is_run(tmp_path: Path) -> None:
    file = write_template("display", tmp_path / "study.toml", example=True)
    study, content = read_study(file)
    with StudyFolder(tmp_path / "answers", content) as writer:
        simulate_participants(study, writer, 2)
        journal = tmp_path / "answers" / "participants" / "sim-000.jsonl"
        with journal.open("ab") as stream:
            stream.write(b"0000 {half of a li")
        torn = journal.read_bytes()
        with StudyFolder(tmp_path / "answers", read_only=True) as reader:
            assert sorted(reader.sessions) == ["sim-000", "sim-001"]
            write_results(study_of(reader.definition), reader, tmp_path / "tables")
            for change in (
                lambda: reader.begin("P3"),
                lambda: reader.store("sim-001", Answer("x", {}, {})),
                lambda: reader.withdraw("sim-001"),
            ):
                with pytest.raises(InputError, match="opened for reading only"):
                    change()
        assert journal.read_bytes() == torn  # its writer may be in the middle of a line
        with pytest.raises(InputError, match="another process is using this study"):
            StudyFolder(tmp_path / "answers", content)
    with pytest.raises(InputError, match="expected a folder of a study"):
        StudyFolder(tmp_path / "nothing", read_only=True)
    assert not (tmp_path / "nothing").exists()


def test_meshes_turn_round_in_ratings(tmp_path: Path) -> None:
    for truth in ("real", "deformed"):
        (tmp_path / "mine" / truth / "surface").mkdir(parents=True)
        (tmp_path / "mine" / truth / "surface" / "a.glb").write_bytes(truth.encode())
    made = copy_rating_stimuli(tmp_path / "mine", tmp_path / "stimuli")
    assert {(i.truth, i.modality, i.form, i.file[-4:]) for i in made} == {
        ("real", "surface", "image", ".glb"),
        ("deformed", "surface", "image", ".glb"),
    }
    study, _ = read_study(template(tmp_path, "any"))
    assert isinstance(study, RatingStudy)
    for step in study.steps(Session("P", 0)):
        assert step.message(px_per_degree=None)["turn_s"] == 8.0
        assert step.stimuli[0].type == "mesh"


def test_each_item_is_looked_up_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The steps of 400 stimuli compare few of them with each other."""
    (tmp_path / "stimuli").mkdir()
    rows = ["file,truth,modality,form,resolution,background,example"]
    for number in range(400):
        (tmp_path / "stimuli" / f"{number:06x}.png").write_bytes(b"x")
        rows.append(f"{number:06x}.png,{'real' if number % 2 else 'type1'},color,image,full,,0")
    (tmp_path / "stimuli" / "stimuli.csv").write_text("\n".join(rows) + "\n")
    study, _ = read_study(template(tmp_path, "any"))
    assert isinstance(study, RatingStudy)
    compared = 0

    def equal(one: Item, other: object) -> bool:
        nonlocal compared
        compared += 1
        return one is other or (isinstance(other, Item) and vars(one) == vars(other))

    monkeypatch.setattr(Item, "__eq__", equal)
    steps = study.steps(Session("P", 0))
    assert sorted(step.id for step in steps) == [f"i{number:03d}" for number in range(400)]
    assert len(study.variables()) == 800
    assert compared < 1000


def test_pictures_of_16_bits_are_shown_in_8_with_one_scale(tmp_path: Path) -> None:
    """Browsers show the upper 8 bits: depth in millimetres was almost black."""
    image = pytest.importorskip("PIL.Image")
    depths = {"real": 1000, "type1": 3000}
    for truth, near in depths.items():
        place = tmp_path / "mine" / truth / "depth"
        place.mkdir(parents=True)
        depth = np.full((40, 50), near, np.uint16)
        depth[:, 25:] = 2000
        depth[0, 0], depth[0, 1] = 0, 65535
        image.fromarray(depth).save(place / "a.png")
    place = tmp_path / "mine" / "real" / "color"
    place.mkdir()
    image.fromarray(np.full((4, 4), 7, np.uint8)).save(place / "grey.png")
    before = (place / "grey.png").read_bytes()
    made = copy_rating_stimuli(tmp_path / "mine", tmp_path / "stimuli")
    seen = {}
    for item in made:
        if item.modality == "depth":
            with image.open(tmp_path / "stimuli" / item.file) as picture:
                assert picture.mode == "RGB"
                seen[item.truth] = np.asarray(picture)[..., 0].astype(int)
        else:
            assert (tmp_path / "stimuli" / item.file).read_bytes() == before
    for picture in seen.values():
        assert picture[0, 0] == picture[0, 1] == 0  # no measurement
    near, far = seen["real"][5, 5], seen["type1"][5, 5]
    middle = seen["real"][5, 40]
    assert middle == seen["type1"][5, 40]  # the same depth in both pictures
    assert near > 240 > middle + 60 > middle > far + 60 > 100


def test_a_damaged_picture_of_16_bits_is_refused(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    place = tmp_path / "mine" / "real" / "depth"
    place.mkdir(parents=True)
    image.fromarray(np.full((40, 50), 999, np.uint16)).save(place / "a.png")
    (place / "a.png").write_bytes((place / "a.png").read_bytes()[:50])
    with pytest.raises(FormatError, match=r"a\.png"):
        copy_rating_stimuli(tmp_path / "mine", tmp_path / "stimuli")
    assert not (tmp_path / "stimuli").exists()

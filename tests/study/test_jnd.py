"""The staircase by hand, its threshold against the truth, and sample sizes against tables."""

from __future__ import annotations

import csv
import itertools
import json
import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manip3d import FormatError, InputError, Mesh, read_mesh
from manip3d.datasets import get, is_here
from manip3d.study import (
    Answer,
    JndStudy,
    Rules,
    SimulatedObserver,
    Staircase,
    StudyFolder,
    estimate_threshold,
    make_stimuli,
    paired_power,
    read_study,
    required_participants,
    reversal_mean,
    run_study,
    simulate_participants,
    simulate_staircase,
    write_results,
    write_template,
)
from manip3d.study._engine import Conductor
from manip3d.study._psychometric import TARGET


def test_one_up_two_down_by_hand() -> None:
    # right: +, wrong: -        level before each answer
    answers = "++-+-+++++-"
    levels = [50, 50, 45, 50, 50, 55, 55, 50, 50, 45, 45]
    #             45: up       55: down                 (45, 45: second right would go to 40)
    stairs = Staircase(50)
    seen = []
    for sign in answers:
        seen.append(stairs.level)
        stairs.answer(sign == "+")
    assert seen == levels
    assert stairs.level == 50
    assert stairs.reversals == [45, 55, 45]


def test_levels_stay_between_the_ends() -> None:
    stairs = Staircase(10)
    for _ in range(10):
        stairs.answer(True)
    assert stairs.level == 5
    for _ in range(40):
        stairs.answer(False)
    assert stairs.level == 95


def test_a_staircase_ends_by_reversals_or_by_comparisons() -> None:
    rules = Rules(reversals=4, most_trials=30)
    sure = simulate_staircase(SimulatedObserver(1e-3, lapse=0.0), rules=rules, rng=0)
    assert sure.trials is not None
    assert len(sure.trials) == 30
    assert sure.reversals == []
    assert reversal_mean(sure) is None
    usual = simulate_staircase(SimulatedObserver(30.0), rules=rules, rng=0)
    assert usual.reversals is not None
    assert len(usual.reversals) == 4


@pytest.mark.parametrize("law", ["weibull", "lognormal"])
@pytest.mark.parametrize("lapse", [0.0, 0.05])
def test_an_observer_is_right_by_chance_at_nothing_and_by_the_target_at_the_threshold(
    law: str, lapse: float
) -> None:
    observer = SimulatedObserver(30.0, 3.0, lapse, law)  # type: ignore[arg-type]
    assert observer.probability(0.0) == 0.5
    assert math.isclose(observer.probability(30.0), TARGET, rel_tol=1e-12)
    shares = [observer.probability(level) for level in range(101)]
    assert shares == sorted(shares)
    assert shares[-1] <= 1.0 - lapse


def test_the_interval_holds_the_truth_about_as_often_as_it_says() -> None:
    rng = np.random.default_rng(5)
    held = 0
    for _ in range(200):
        observer = SimulatedObserver(rng.uniform(10, 60), rng.uniform(1.5, 6), rng.uniform(0, 0.05))
        stairs = simulate_staircase(observer, rng=rng)
        found = estimate_threshold(stairs.trials or [])
        held += found.low <= observer.threshold <= found.high
    # 190 are expected; 3.5 standard deviations are 11. The experiment jnd-simulated counts 1000.
    assert 179 <= held <= 200


def test_more_answers_make_the_interval_narrower_and_the_estimate_right() -> None:
    observer = SimulatedObserver(33.0, 4.0, 0.01)
    widths = []
    for trials in (40, 400, 4000):
        rules = Rules(reversals=100_000, most_trials=trials)
        found = estimate_threshold(simulate_staircase(observer, rules=rules, rng=2).trials or [])
        widths.append(found.high - found.low)
    assert widths == sorted(widths, reverse=True)
    assert abs(found.threshold - 33.0) < 1.5


def test_nobody_who_sees_nothing_gets_a_small_threshold() -> None:
    blind = estimate_threshold([(level, n % 2 == 0) for n in range(80) for level in (90, 95)])
    assert blind.low > 50.0


@pytest.mark.parametrize("trials", [[], [(0, True)], [(101, False)]])
def test_answers_to_no_difference_are_refused(trials: list[tuple[int, bool]]) -> None:
    with pytest.raises(InputError, match="trials: expected"):
        estimate_threshold(trials)


def test_observers_are_checked() -> None:
    for wrong in ({"threshold": 0.0}, {"threshold": 9.0, "slope": math.nan}):
        with pytest.raises(InputError, match="threshold, slope: expected > 0"):
            SimulatedObserver(**wrong)
    with pytest.raises(InputError, match="lapse: expected 0 to"):
        SimulatedObserver(9.0, lapse=0.3)
    with pytest.raises(InputError, match="law: expected"):
        SimulatedObserver(9.0, law="other")  # type: ignore[arg-type]


# Two-sided paired t test, alpha 0.05, power 0.8, as tables and programs give it.
@pytest.mark.parametrize(("effect", "needed"), [(0.2, 199), (0.5, 34), (0.8, 15)])
def test_sample_sizes_are_those_of_the_tables(effect: float, needed: int) -> None:
    pytest.importorskip("scipy")
    assert required_participants(effect) == needed
    assert required_participants(-effect) == needed
    assert paired_power(needed - 1, effect) < 0.8 <= paired_power(needed, effect)


def test_power_is_the_share_of_simulated_studies_that_find_the_effect() -> None:
    stats = pytest.importorskip("scipy.stats")
    rng = np.random.default_rng(0)
    differences = rng.normal(0.6, 1.0, size=(4000, 20))
    found = np.mean(stats.ttest_1samp(differences, 0.0, axis=1).pvalue < 0.05 / 2)
    assert abs(found - paired_power(20, 0.6, comparisons=2)) < 4 * math.sqrt(0.25 / 4000)
    assert math.isclose(paired_power(20, 0.0), 0.05, rel_tol=1e-6)


def test_impossible_sample_sizes_are_refused() -> None:
    pytest.importorskip("scipy")
    with pytest.raises(InputError, match="effect: expected an effect that"):
        required_participants(0.0)
    with pytest.raises(InputError, match="power: expected"):
        required_participants(0.5, power=1.0)
    with pytest.raises(InputError, match="alpha: expected"):
        paired_power(5, 0.5, alpha=0.0)


def small(folder: Path, **options: object) -> Path:
    """The first planned study with one small model and two methods."""
    from manip3d.simulate import models

    file = write_template("jnd-non-textured", folder / "study.toml", example=True)
    text = file.read_text()
    head, _, rest = text.partition("models = [")
    text = head + 'models = [{ name = "rocker", file = "a.ply", class = "manifold" }]\n'
    text += rest.partition("\n]\n")[2]
    text = text.replace(
        'methods = ["qem_orig", "qem_bp", "qem4vr"]', 'methods = ["qem_bp", "qem4vr"]'
    )
    for name, value in {
        "step_percent": 15,
        "highest_percent": 80,
        "reversals": 3,
        **options,
    }.items():
        lines = [
            f"{name} = {value}" if line.startswith(f"{name} =") else line
            for line in text.splitlines()
        ]
        text = "\n".join(lines) + "\n"
    file.write_text(text)
    models.rocker(5000).write(folder / "a.ply")
    return file


@pytest.mark.parametrize(
    ("name", "methods"),
    [
        ("jnd-non-textured", ("qem_orig", "qem_bp", "qem4vr")),
        ("jnd-textured", ("qem_tp", "qem_btp", "qem4vr")),
    ],
)
def test_both_planned_studies_are_there(
    name: str, methods: tuple[str, ...], tmp_path: Path
) -> None:
    study, _ = read_study(write_template(name, tmp_path / "study.toml", example=True))
    assert isinstance(study, JndStudy)
    assert study.methods == methods
    kinds = [model.kind for model in study.models]
    # No public non-manifold mesh has texture coordinates everywhere, which QEM_TP needs.
    others = [] if name == "jnd-textured" else ["non-manifold"] * 2
    assert kinds == ["manifold"] * 2 + ["boundaries"] * 2 + others
    assert study.rules.step == 5
    assert pickle.loads(pickle.dumps(study)) == study


def test_stimuli_have_the_faces_that_their_names_say(tmp_path: Path) -> None:
    file = small(tmp_path)
    made = make_stimuli(file)
    assert made.problems == ()
    study, _ = read_study(file)
    assert isinstance(study, JndStudy)
    assert made.count == len(study.files()) == 1 + 2 * len(study.levels)
    assert all(path.is_file() for path in study.files().values())
    lines = (made.folder / "levels.csv").read_text().splitlines()
    assert lines[0] == "file,model,method,difference_percent,faces,reached_percent"
    for line in lines[1:]:
        _, _, _, wanted, _, reached = line.split(",")
        assert abs(float(wanted) - float(reached)) < 0.5
    with pytest.raises(InputError, match=r"exists already; overwrite=True"):
        make_stimuli(file)


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["jnd-non-textured", "jnd-textured"])
def test_each_method_applies_to_each_model_of_a_template(name: str, tmp_path: Path) -> None:
    file = write_template(name, tmp_path / "study.toml", example=True)
    study, _ = read_study(file)
    assert isinstance(study, JndStudy)
    if not all(is_here(get(model.file.removeprefix("data:"))) for model in study.models):
        pytest.skip("the public meshes are not here")
    text = file.read_text().replace("step_percent = 5", "step_percent = 15")
    file.write_text(text)
    made = make_stimuli(file)
    assert made.count == len(study.models) + 7 * len(study.conditions)


def with_tetrahedra(mesh: Mesh, share: float) -> Mesh:
    """A mesh and so many separate tetrahedra, none of whose edges QEM_BP may collapse."""
    count = round(mesh.num_faces * share / (1.0 - share) / 4)
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    sides = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    size = 0.01 * np.ptp(mesh.vertices)
    places = mesh.vertices.max(axis=0) + 3.0 * size * np.arange(1, count + 1)[:, None] * [1, 0, 0]
    vertices = (places[:, None] + size * corners).reshape(-1, 3)
    faces = (len(mesh.vertices) + 4 * np.arange(count)[:, None, None] + sides).reshape(-1, 3)
    return Mesh(np.vstack([mesh.vertices, vertices]), np.vstack([mesh.faces, faces]))


def test_a_method_that_refuses_a_model_is_named(tmp_path: Path) -> None:
    """Both pictures of its comparisons were the original."""
    file = small(tmp_path)
    file.write_text(file.read_text().replace('"qem_bp"', '"qem_tp"'))  # without texture coordinates
    with pytest.raises(InputError, match=r"models: expected models that qem_tp can .* got rocker:"):
        make_stimuli(file)
    assert not (tmp_path / "stimuli-non-textured").exists()


def test_a_model_of_which_too_few_faces_can_be_removed_is_refused(tmp_path: Path) -> None:
    file = small(tmp_path)
    with_tetrahedra(read_mesh(tmp_path / "a.ply"), 0.6).write(tmp_path / "a.ply")
    with pytest.raises(
        InputError, match=r"qem_bp can remove 50 % of the faces, got rocker, .* 39\.5 %"
    ):
        make_stimuli(file)


def test_thresholds_count_the_differences_that_were_shown(tmp_path: Path) -> None:
    file = small(tmp_path, reversals=6, step_percent=10, lowest_percent=10, highest_percent=90)
    with_tetrahedra(read_mesh(tmp_path / "a.ply"), 0.4).write(tmp_path / "a.ply")
    made = make_stimuli(file)
    assert any("rocker, qem_bp: cannot be simplified beyond 59.3 %" in p for p in made.problems)
    study, content = read_study(file)
    assert isinstance(study, JndStudy)
    with StudyFolder(tmp_path / "answers", content) as folder:
        session = folder.begin("P1")
        while (step := study.step(session)) is not None:
            values: dict[str, Any] = {f.name: f.choices[0][0] for f in step.fields if f.choices}
            if step.id == "screen":
                values = {"card_px": 324.0, "distance_cm": 60.0}
            elif "original" in step.condition:  # sees no difference, whatever is shown
                values["chosen"] = "left"
            elif step.id == "about":
                values = {"age": 30.0, **values}
            folder.store("P1", Answer(step.id, dict(step.condition), values, elapsed_ms=9.0))
        asked = [a for a in session.answers if a.condition.get("method") == "qem_bp"]
        assert max(a.condition["difference_percent"] for a in asked) > 60
        assert max(a.condition["reached_percent"] for a in asked) == 59
        expected = estimate_threshold(
            [
                (a.condition["reached_percent"], a.values["chosen"] == a.condition["original"])
                for a in asked
            ]
        )
        rows = {r["method"]: r for r in study.summary([session]) if r["participant"]}
        assert rows["qem_bp"]["jnd_percent"] == expected.threshold
        assert rows["qem_bp"]["reversal_mean"] <= 59
        assert study.wide(session)["c1_jnd"] == round(expected.threshold, 3)


def test_stimuli_that_equal_their_originals_are_not_shown(tmp_path: Path) -> None:
    file = small(tmp_path)
    made = make_stimuli(file)
    table = made.folder / "levels.csv"
    lines = table.read_text().splitlines()
    lines[1] = ",".join([*lines[1].split(",")[:-1], "0.0"])
    table.write_text("\n".join(lines) + "\n")
    study, content = read_study(file)
    with (
        StudyFolder(tmp_path / "answers", content) as folder,
        pytest.raises(FormatError, match=r"levels.csv: rocker-.*expected a difference from"),
    ):
        run_study(study, folder, seconds=0.1)


def test_a_definition_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    file = write_template("display", tmp_path / "study.toml", example=True)
    plain, _ = read_study(file)
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    assert read_study(file)[0] == plain


def test_the_truth_never_reaches_the_page(tmp_path: Path) -> None:
    study, content = read_study(small(tmp_path))
    assert isinstance(study, JndStudy)
    with StudyFolder(tmp_path / "answers", content) as folder:
        simulate_participants(study, folder, 2)
        session = folder.sessions["sim-000"]
        session.answers = [a for a in session.answers if not a.step.startswith("t")]
        step = study.step(session)
        assert step is not None
        told = str(step.message(px_per_degree=40.0))
        for word in ("rocker", "qem", "original", "35", "50"):
            assert word not in told.replace(step.stimuli[0].address, "").replace(
                step.stimuli[1].address, ""
            )


def test_sides_are_balanced_and_the_same_again(tmp_path: Path) -> None:
    study, content = read_study(small(tmp_path, reversals=20, most_trials=100))
    assert isinstance(study, JndStudy)
    with StudyFolder(tmp_path / "answers", content) as folder:
        simulate_participants(study, folder, 4)
        sides = [
            a.condition["original"]
            for s in folder.sessions.values()
            for a in s.answers
            if "original" in a.condition
        ]
        assert abs(sides.count("left") / len(sides) - 0.5) < 3 * 0.5 / math.sqrt(len(sides))
        first = [(a.step, dict(a.condition)) for a in folder.sessions["sim-001"].answers]
    with StudyFolder(tmp_path / "again", content) as folder:
        simulate_participants(study, folder, 4)
        assert [(a.step, dict(a.condition)) for a in folder.sessions["sim-001"].answers] == first


def test_results_have_a_threshold_for_each_staircase(tmp_path: Path) -> None:
    pytest.importorskip("scipy")
    study, content = read_study(small(tmp_path, reversals=6))
    with StudyFolder(tmp_path / "answers", content) as folder:
        simulate_participants(study, folder, 3)
        rows = study.summary(list(folder.sessions.values()))
        assert len(rows) == 3 * 2 + 2
        assert all(row["low"] < row["jnd_percent"] < row["high"] for row in rows)
        results = write_results(study, folder, tmp_path / "results")
    header, *lines = (results / "participants.csv").read_text().splitlines()
    assert header.startswith(
        "record_id,state,age,glasses,card_px,distance_cm,c1_jnd,c1_low,c1_high"
    )
    assert len(lines) == 3
    assert "shown_deg" in (results / "answers.csv").read_text().splitlines()[0]


class Client:
    """Stands in for a page's connection."""

    def __init__(self, **screen: float) -> None:
        self.screen = screen
        self.heard: list[dict[str, Any]] = []

    def say(self, text: str) -> None:
        self.heard.append(json.loads(text))


def test_who_goes_on_at_another_screen_measures_it(tmp_path: Path) -> None:
    study, content = read_study(small(tmp_path))
    with StudyFolder(tmp_path / "answers", content) as folder:
        conductor = Conductor(study, folder)

        def say(client: Client, **message: Any) -> dict[str, Any]:
            conductor.hear(client, json.dumps(message))  # type: ignore[arg-type]
            return client.heard[-1]

        def begin(client: Client) -> dict[str, Any]:
            return say(client, type="begin", participant="P1", **client.screen)

        def answer(client: Client, step: str, shown_px: float = 0.0, **values: Any) -> Any:
            given = {f"answer.{name}": value for name, value in values.items()}
            return say(client, type="answer", step=step, elapsed_ms=9.0, shown_px=shown_px, **given)

        folder.begin("P1")
        for step in ("consent", "about", "introduction"):
            folder.store("P1", Answer(step, {}, {"agree": "yes"} if step == "consent" else {}))
        desk = Client(screen_px=1920, pixel_ratio=1)
        assert begin(desk)["id"] == "screen"
        first = answer(desk, "screen", card_px=324.0, distance_cm=60.0)
        assert answer(desk, first["id"], first["width_px"], chosen="left")["id"] == "t0001"
        assert begin(Client(screen_px=1920, pixel_ratio=1))["id"] == "t0001"
        assert begin(Client())["id"] == "t0001"  # a page that does not tell
        laptop = Client(screen_px=1440, pixel_ratio=2)
        assert begin(laptop)["id"] == "screen_2"
        second = answer(laptop, "screen_2", card_px=486.0, distance_cm=60.0)
        assert second["id"] == "t0001"
        assert second["width_px"] == pytest.approx(1.5 * first["width_px"], abs=0.01)
        answer(laptop, "t0001", second["width_px"], chosen="left")
        assert begin(laptop)["id"] == "t0002"
        assert begin(desk)["id"] == "screen_3"
        write_results(study, folder, tmp_path / "results")
    with (tmp_path / "results" / "answers.csv").open(encoding="utf-8-sig", newline="") as stream:
        rows = {row["step"]: row for row in csv.DictReader(stream)}
    # Each at the scale of the screen that it was answered at.
    assert [float(rows[step]["shown_deg"]) for step in ("t0000", "t0001")] == [12.0, 12.0]
    assert rows["screen_2"]["condition"] == "screen_px=1440.0; pixel_ratio=2.0"
    with (tmp_path / "results" / "participants.csv").open(encoding="utf-8", newline="") as stream:
        (row,) = csv.DictReader(stream)
    assert row["card_px"] == "486.0"


def by_hand(trials: list[tuple[int, bool]]) -> list[float]:
    """The posterior's 2.5 %, 50 % and 97.5 % points of the threshold, summed point by point."""
    step, cells = 0.5, []
    for number in range(200):
        threshold, total = (number + 0.5) * step, 0.0
        for slope in np.geomspace(0.5, 12.0, 36):
            prior = math.exp(-0.5 * (2.0 * math.log(slope / 3.0) / math.log(3.0)) ** 2)
            for lapse, weight in [(0.0, 0.35), (0.015, 0.3), (0.03, 0.2), (0.06, 0.15)]:
                most = 0.5 - lapse
                c = -math.log(1.0 - (math.sqrt(0.5) - 0.5) / most)
                likelihood = prior * weight
                for level, is_right in trials:
                    share = 0.5 + most * (1.0 - math.exp(-c * (level / threshold) ** slope))
                    share = min(max(share, 1e-6), 1.0 - 1e-6)
                    likelihood *= share if is_right else 1.0 - share
                total += likelihood
        cells.append(total)
    heaped = np.concatenate([[0.0], np.cumsum(cells)])
    edges = step * np.arange(len(heaped))
    return [float(np.interp(p, heaped / heaped[-1], edges)) for p in (0.025, 0.5, 0.975)]


def test_the_posterior_is_the_sum_over_slopes_and_lapses() -> None:
    """Few answers, among them a slip at the largest difference: priors matter."""
    trials = [(100, False), (40, True), (40, True), (30, True), (20, False), (25, True)]
    found = estimate_threshold(trials)
    assert [found.low, found.threshold, found.high] == pytest.approx(by_hand(trials), rel=1e-9)


def test_no_effect_is_too_large_for_the_power() -> None:
    """SciPy's far tails are NaN for some, which made 4 participants of 3 at an effect of 10.5."""
    needed = [required_participants(effect) for effect in (1.0, 2.0, 4.0, 10.5, 20.0, 50.0, 100.0)]
    assert needed == sorted(needed, reverse=True)
    assert needed[3] == required_participants(-10.5) == 3
    for participants in (2, 3, 5, 100):
        powers = [paired_power(participants, 0.01 * 1.25**step) for step in range(41)]
        assert all(0.0 < a <= b + 1e-9 for a, b in itertools.pairwise(powers))

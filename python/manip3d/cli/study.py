"""``manip3d study``: run studies with people in a browser on this computer."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from manip3d.cli.options import Force, Json, Quiet, Seed
from manip3d.cli.signals import ended_like_ctrl_c
from manip3d.cli.terminal import (
    Terminal,
    check_folder,
    check_output,
    check_place,
    counted,
    naming_options,
    table,
)
from manip3d.errors import InputError

app = typer.Typer(
    name="study",
    help="Run studies with people: rating of forgeries, JND, displays.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

Definition = Annotated[
    Path,
    typer.Argument(
        metavar="STUDY", help="Definition of the study, as 'manip3d study define' writes it."
    ),
]
Answers = Annotated[
    Path, typer.Argument(metavar="ANSWERS", help="Folder of answers of a study that was run.")
]
AnswersOut = Annotated[
    Path,
    typer.Option("-o", "--output", help="Folder of the answers; an existing one is continued."),
]
Folder = Annotated[Path, typer.Option("-o", "--output", help="Output folder to create.")]
Participant = Annotated[
    str | None,
    typer.Option(help="Code of the only participant; by default the page asks for a code."),
]
Port = Annotated[int, typer.Option(min=0, max=65535, help="Port on this machine; 0: a free one.")]
Opened = Annotated[bool, typer.Option("--open/--no-open", help="Open the page in the browser.")]
Seconds = Annotated[
    float | None, typer.Option(help="Stop after this many seconds; by default at Ctrl-C.")
]


class Template(StrEnum):
    """Templates of definitions."""

    rating = "rating"
    jnd_non_textured = "jnd-non-textured"
    jnd_textured = "jnd-textured"
    display = "display"


@app.command("define")
def study_define(
    template: Annotated[
        Template,
        typer.Argument(
            metavar="TEMPLATE",
            help="Kind of study: rating, jnd-non-textured, jnd-textured or display.",
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Definition, .toml.")],
    example: Annotated[
        bool,
        typer.Option("--example", help="Fill empty texts with placeholders, for a trial run."),
    ] = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Write a definition to fill in.

    The consent, and questions whose wording the dissertation does not give, are left empty. A study
    with an empty text does not start.

    Example: manip3d study define display -o study.toml
    """
    from manip3d.study import write_template

    check_output(output, (".toml",), force=force)
    write_template(template.value, output, example=example)
    Terminal(quiet=quiet).say(f"wrote {output}")


@app.command("stimuli")
def study_stimuli(
    definition: Definition,
    frames: Annotated[int, typer.Option(min=2, help="Frames of each clip of a rating.")] = 24,
    surfaces: Annotated[
        int,
        typer.Option(
            min=0,
            help="Number of surfaces from LiDAR scans for a rating, for each of three kinds: real, "
            "with an added object, and deformed.",
        ),
    ] = 0,
    images: Annotated[
        Path | None,
        typer.Option(
            help="Folder of your own pictures and clips for a rating, in subfolders real, type1, "
            "type2, added or deformed; below these depth, color (the default), rendered or surface."
        ),
    ] = None,
    seed: Seed = 0,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make the stimuli that a definition names: streams or meshes.

    They are written beside the definition, under the name that it gives. Stimuli of --images get
    names that do not reveal their kind; a rating of them needs composition = "any".

    Example: manip3d study stimuli study.toml
    """
    from manip3d.study import make_stimuli

    shell = Terminal(as_json=as_json, quiet=quiet)
    with (
        shell.progress("stimuli") as progress,
        naming_options("images", "surfaces", "frames", "seed"),
    ):
        made = make_stimuli(
            definition,
            frames=frames,
            surfaces=surfaces,
            images=images,
            seed=seed,
            overwrite=force,
            progress=progress or shell.line,  # without a terminal, a line is printed for each
        )
    shell.say(f"wrote {counted(made.count, 'stimulus', 'stimuli')} to {made.folder}")
    for problem in made.problems:
        shell.say(problem)
    shell.result(
        {
            "folder": str(made.folder),
            "seed": seed,
            "stimuli": made.count,
            "problems": list(made.problems),
        }
    )


_RUNS = {
    "rating": "Run a rating: real, manipulated or undecidable, and why. Ctrl-C ends it.",
    "jnd": "Measure the just noticeable difference of simplification. Ctrl-C ends it.",
    "display": "Run the comparison of displays: practice, play, questionnaire. Ctrl-C ends it.",
}
"""Kinds of studies, and the help of their commands."""


def _add_run(kind: str, words: str) -> None:
    """Add the command that runs studies of a kind; all have the same options."""

    def run(
        definition: Definition,
        output: AnswersOut,
        participant: Participant = None,
        port: Port = 0,
        is_opened: Opened = True,
        seconds: Seconds = None,
        as_json: Json = False,
        quiet: Quiet = False,
    ) -> None:
        shell = Terminal(as_json=as_json, quiet=quiet)
        run_kind(kind, definition, output, participant, port, is_opened, seconds, shell)

    example = f"manip3d study {kind} study.toml -o answers --no-open --seconds 2"
    run.__doc__ = f"{words}\n\n    Example: {example}\n"
    app.command(kind)(run)


for _kind, _words in _RUNS.items():
    _add_run(_kind, _words)


def check_answers(output: Path) -> None:
    """Check the folder of the answers: a new or empty one, or that of a study.

    Raises
    ------
    InputError
        See `check_folder`.
    """
    from manip3d.study._store import is_file_of_study

    check_folder(output, lambda name: is_file_of_study(output, name))


def run_kind(
    kind: str,
    definition: Path,
    output: Path,
    participant: str | None,
    port: int,
    is_opened: bool,
    seconds: float | None,
    shell: Terminal,
) -> None:
    """Run a study of one kind, and print the numbers of participants and answers."""
    from manip3d.study import StudyFolder, read_study, run_study

    study, content = read_study(definition)
    if study.common.kind != kind:
        raise InputError(
            f"{definition}: expected a definition of a {kind}, got {study.common.kind}"
        )
    study.check_stimuli()  # before the folder is made
    check_answers(output)

    def on_start(url: str) -> None:
        shell.say(f"open {url}")
        if is_opened:
            import webbrowser

            webbrowser.open(url)

    with (
        StudyFolder(output, content) as folder,
        naming_options("seconds", "participant"),
        ended_like_ctrl_c(),
    ):
        report = run_study(
            study,
            folder,
            participant=participant,
            port=port,
            seconds=seconds,
            on_start=on_start,
        )
    states = list(report.participants.values())
    shell.say(
        f"{counted(len(states), 'participant')}, {states.count('finished')} to the end; "
        f"{counted(report.answers, 'answer')} in {output}"
    )
    for reason, number in report.refused.items():
        shell.say(f"refused {counted(number, 'time')}: {reason}")
    shell.result(
        {
            "participants": dict(report.participants),
            "answers": report.answers,
            "refused": dict(report.refused),
        }
    )


@app.command("simulate")
def study_simulate(
    definition: Definition,
    output: AnswersOut,
    participants: Annotated[int, typer.Option(min=1, help="Number of simulated people.")] = 12,
    seed: Seed = 0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Let simulated people answer, to try a study before people do.

    A folder that holds answers of people is refused.

    Example: manip3d study simulate study.toml -o answers --participants 6
    """
    from manip3d.study import StudyFolder, read_study, simulate_participants

    study, content = read_study(definition)
    check_answers(output)
    shell = Terminal(as_json=as_json, quiet=quiet)
    with StudyFolder(output, content) as folder, naming_options("seed"):
        codes = simulate_participants(study, folder, participants, seed=seed)
    shell.say(f"{counted(len(codes), 'simulated participant')} in {output}")
    shell.result({"seed": seed, "participants": codes})


@app.command("results")
def study_results(
    answers: Answers,
    output: Folder,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write answers as CSV with a REDCap data dictionary. A summary compares them with the
    published numbers.

    This works during the study, too, with the answers that are stored so far. A damaged journal is
    reported, and the others are written.

    Example: manip3d study results answers -o tables
    """
    from manip3d.study import StudyFolder, study_of, write_results
    from manip3d.study._results import FILES

    check_place(output, force=force, is_ours=FILES.__contains__)
    shell = Terminal(as_json=as_json, quiet=quiet)
    with StudyFolder(answers, read_only=True) as folder, naming_options("output"):
        study = study_of(folder.definition)
        written = write_results(study, folder, output, overwrite=force)
        damaged = folder.damaged
    names = sorted(file.name for file in written.iterdir())
    shell.say(f"wrote {output}: {', '.join(names)}")
    for code, problem in damaged.items():
        shell.say(f"left out {code}: {problem}")
    shell.result({"output": str(output), "files": names, "damaged": damaged})


@app.command("withdraw")
def study_withdraw(
    answers: Answers,
    participant: Annotated[str, typer.Argument(metavar="CODE", help="Participant code.")],
    quiet: Quiet = False,
) -> None:
    """Delete all answers of a participant who has withdrawn consent.

    Results that were written earlier still hold them: write those again.

    Example: manip3d study withdraw answers P07
    """
    from manip3d.study import StudyFolder

    with StudyFolder(answers) as folder:
        folder.withdraw(participant)
    Terminal(quiet=quiet).say(f"deleted the answers of {participant}")


# A negative effect is a number, not an option.
@app.command("power", context_settings={"ignore_unknown_options": True})
def study_power(
    effect: Annotated[
        float,
        typer.Argument(
            metavar="EFFECT",
            help="Mean difference of two methods' JNDs, divided by its standard deviation.",
        ),
    ],
    power: Annotated[float, typer.Option(help="Power to reach.")] = 0.8,
    alpha: Annotated[
        float, typer.Option(help="Significance level (type I error), two-sided.")
    ] = 0.05,
    comparisons: Annotated[
        int,
        typer.Option(
            min=1,
            help="Number of comparisons that share the level, such as QEM4VR with two others.",
        ),
    ] = 2,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Print how many participants a comparison of two methods needs.

    Example: manip3d study power 0.5
    """
    from manip3d.study import paired_power, required_participants

    with naming_options("power", "alpha", "comparisons"):
        needed = required_participants(effect, power=power, alpha=alpha, comparisons=comparisons)
    rows = [
        (count, paired_power(count, effect, alpha=alpha, comparisons=comparisons))
        for count in sorted({max(2, needed // 2), needed, 2 * needed})
    ]
    Terminal(as_json=as_json, quiet=quiet).result(
        {"participants": needed, "power": dict(rows)},
        lambda console: table(
            console,
            [[str(count), f"{reached:.3f}"] for count, reached in rows],
            ("participants", "power"),
        ),
    )

"""Engine of all studies: base class, web server, and simulated participants."""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import math
import threading
import time
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.reprs import short_repr
from manip3d.errors import FormatError, InputError
from manip3d.serve import Kind, Limits, LocalServer, Page, StreamClient, bundled_pages, read_message
from manip3d.study._definition import Common
from manip3d.study._steps import ABOUT, CONSENT, Field, Step, Stimulus, Value, px_per_degree
from manip3d.study._store import SIMULATED, Answer, Session, StudyFolder

LOG = logging.getLogger("manip3d.study")

MAX_MESSAGE = 150_000
"""Largest number of characters of a message: 30 texts of `MAX_TEXT` characters, each of which may
be escaped, and the other fields."""

_TYPES = {
    ".png": ("image", "image/png"),
    ".jpg": ("image", "image/jpeg"),
    ".jpeg": ("image", "image/jpeg"),
    ".webp": ("image", "image/webp"),
    ".gif": ("image", "image/gif"),
    ".webm": ("video", "video/webm"),
    ".mp4": ("video", "video/mp4"),
    ".glb": ("mesh", "model/gltf-binary"),
}
SHOWABLE = tuple(_TYPES)
"""File name suffixes of stimuli that a page can show."""


class Study(ABC):
    """A study by its definition: what a participant is asked next, given their answers so far.

    Attributes
    ----------
    common : Common
    """

    common: Common

    @abstractmethod
    def next_step(self, session: Session) -> Step | None:
        """Return the first of the study's own steps without an answer; None: all are answered.

        Parameters
        ----------
        session : Session
            The participant's answers so far.
        """

    @abstractmethod
    def progress(self, session: Session) -> float:
        """Return how far the participant is, 0 to 1.

        Parameters
        ----------
        session : Session
            The participant's answers so far.
        """

    @property
    def num_orders(self) -> int:
        """Number of orders of the conditions, which participants get in turn."""
        return 1

    @abstractmethod
    def files(self) -> Mapping[str, Path]:
        """Return the files of the stimuli, by name."""

    @abstractmethod
    def variables(self) -> Sequence[tuple[str, Field]]:
        """Return the variables of the answers: title of the part, and question.

        Names are those of `wide`.
        """

    @abstractmethod
    def wide(self, session: Session) -> dict[str, Value]:
        """Return the row of a participant: given answers, by the names of `variables`.

        Parameters
        ----------
        session : Session
            The participant's answers so far.
        """

    @abstractmethod
    def summary(self, sessions: Sequence[Session]) -> list[dict[str, Any]]:
        """Return the summary of the answers as rows of a table.

        Parameters
        ----------
        sessions : sequence of Session
            One per participant.
        """

    @abstractmethod
    def simulate(self, session: Session, step: Step, rng: np.random.Generator) -> dict[str, Value]:
        """Return the answers of a simulated participant to one of the study's own steps.

        Parameters
        ----------
        session : Session
            The participant's answers so far.
        step : Step
            The step to answer.
        rng : numpy.random.Generator
            Source of the answers.
        """

    def check_stimuli(self) -> None:
        """Check that people can be shown the stimuli.

        Raises
        ------
        InputError
            A file is missing.
        FormatError
            A table of the stimuli is damaged.
        """
        missing = [file for file in self.files().values() if not file.is_file()]
        if missing:
            raise InputError(
                f"{missing[0]}: expected a stimulus, found none ({len(missing)} missing); "
                "'manip3d study stimuli' makes them"
            )

    def stimulus(self, name: str) -> Stimulus:
        """Return a stimulus under an address that does not reveal its name.

        Parameters
        ----------
        name : str
            Name among `files`.
        """
        kind = _TYPES[Path(name).suffix.lower()][0]
        return Stimulus(address_of(self.common.seed, name), kind)  # type: ignore[arg-type]

    def order(self, session: Session, purpose: str, count: int) -> list[int]:
        """Return a permutation of 0 to ``count`` - 1, fixed for this participant and purpose.

        Parameters
        ----------
        session : Session
            The participant.
        purpose : str
            Name of the use, so that each use has random numbers of its own.
        count : int
            Length of the order.
        """
        return [int(n) for n in self.generator(session, purpose).permutation(count)]

    def generator(self, session: Session, purpose: str) -> np.random.Generator:
        """Return a generator of random numbers for one purpose of one participant.

        Parameters
        ----------
        session : Session
            The participant.
        purpose : str
            Name of the use, so that each use has random numbers of its own.
        """
        text = f"{self.common.seed}/{session.number}/{purpose}"
        return np.random.default_rng(int.from_bytes(hashlib.sha256(text.encode()).digest()))

    def step(self, session: Session) -> Step | None:
        """Return the participant's current step; None: they have finished or did not consent.

        Parameters
        ----------
        session : Session
            The participant's answers so far.
        """
        for step in self.opening():
            answer = session.answer(step.id)
            if answer is None:
                return step
            if step.id == CONSENT and answer.values["agree"] != "yes":
                return None
        return self.next_step(session)

    def opening(self) -> list[Step]:
        """Return the steps before the study's own: consent, demographics, introduction."""
        agree = Field("agree", "", "choice", (("yes", "I agree"), ("no", "I do not agree")))
        steps = [Step(CONSENT, "Consent", self.common.consent, (agree,))]
        about = list(self.common.demographics)
        if self.common.groups:
            choices = tuple((name, name) for name in self.common.groups)
            about.insert(0, Field("group", "Which group do you belong to?", "choice", choices))
        if about:
            steps.append(Step(ABOUT, "About you", (), tuple(about)))
        if self.common.introduction:
            steps.append(Step("introduction", self.common.title, self.common.introduction))
        return steps


def address_of(seed: int, name: str) -> str:
    """Return the path under which a stimulus is fetched."""
    return "/stimulus/" + hashlib.sha256(f"{seed}/{name}".encode()).hexdigest()[:24]


def study_pages(study: Study) -> dict[str, Page]:
    """Return the page and all files that it loads, by path.

    Raises
    ------
    RenderError
        The script is not built.
    InputError
        A stimulus is of a kind that a page does not show.
    """
    pages = bundled_pages("study", study.common.title, '<main id="study"></main>')
    for name, file in study.files().items():
        if file.suffix.lower() not in _TYPES:
            raise InputError(f"{file}: expected a stimulus that ends in {', '.join(_TYPES)}")
        media = _TYPES[file.suffix.lower()][1]
        pages[address_of(study.common.seed, name)] = Page(media, file)
    return pages


def study_server(
    study: Study, folder: StudyFolder, participant: str | None = None, port: int = 0
) -> LocalServer:
    """Return the server of a study, which accepts answers as long as the page allows.

    Raises
    ------
    RenderError
        The script is not built.
    InputError
        A stimulus is of a kind that a page does not show.
    MissingExtraError
        aiohttp is not installed.
    """
    limits = Limits(message_bytes=4 * MAX_MESSAGE)  # UTF-8 has up to four bytes per character
    conductor = Conductor(study, folder, participant)
    return LocalServer(study_pages(study), conductor.hear, port=port, limits=limits)


class ListedStudy(Study):
    """A study whose own steps are known before the first of them is answered."""

    @abstractmethod
    def steps(self, session: Session) -> list[Step]:
        """Return all steps of the study's own, in this participant's order.

        Parameters
        ----------
        session : Session
            The participant's answers so far.
        """

    def next_step(self, session: Session) -> Step | None:
        """Return the first of `steps` without an answer; None: all are answered.

        Parameters
        ----------
        session : Session
            The participant's answers so far.
        """
        done = {answer.step for answer in session.answers}
        return next((step for step in self.steps(session) if step.id not in done), None)


class Conductor:
    """Handles the messages of pages: codes of participants, and answers to steps.

    Parameters
    ----------
    study : Study
    folder : StudyFolder
        Folder of the answers.
    participant : str, optional
        Code of the only participant who may take part. Default: everybody who enters a code.
    """

    def __init__(self, study: Study, folder: StudyFolder, participant: str | None = None) -> None:
        self.study, self.folder, self.participant = study, folder, participant
        self._who: weakref.WeakKeyDictionary[StreamClient, Session] = weakref.WeakKeyDictionary()
        # Time at which a step was shown, by participant and step.
        self._shown_since: dict[tuple[str, str], float] = {}

    def hear(self, client: StreamClient, text: str) -> None:
        """Handle a message of a page, and send the page its next step.

        Raises
        ------
        FormatError
            The page may not send this message now.
        """
        session = self._who.get(client)
        step = None if session is None else self.study.step(session)
        types: dict[str, dict[str, Kind]] = {
            "hello": _SCREEN,
            "begin": {"participant": Kind(str, length=32), **_SCREEN},
        }
        if step is not None:
            types["answer"] = _answer_kinds(step)
        name, values = read_message(text, types, max_length=MAX_MESSAGE)
        if name == "hello":
            code = self.participant
            if code is None:
                client.say(_message("who", title=self.study.common.title))
                return
            self._begin(client, code, values)
        elif name == "begin":
            self._begin(client, str(values["participant"]), values)
        else:
            assert session is not None
            assert step is not None
            self._store(client, session, step, values)

    def _begin(
        self, client: StreamClient, code: str, values: Mapping[str, int | float | str]
    ) -> None:
        if self.participant is not None and code != self.participant:
            raise FormatError(f"participant: expected {self.participant}")
        try:
            _refuse_simulated(code)
            session = self.folder.begin(code)
        except InputError as error:
            client.say(_message("who", title=self.study.common.title, problem=str(error)))
            return
        except OSError as error:
            self._complain(client, error)
            return
        self._who[client] = session
        session.screen = {name: float(values[name]) for name in _SCREEN if name in values}
        self._tell(client, session)

    def _store(
        self,
        client: StreamClient,
        session: Session,
        step: Step,
        values: Mapping[str, int | float | str],
    ) -> None:
        key = session.participant, step.id
        # For a step that was never shown, the time is -inf, so that it cannot be answered.
        shown_s = time.monotonic() - self._shown_since.get(key, math.inf)
        if shown_s < step.minimum_s:
            raise FormatError(f"{step.id}: expected an answer after {step.minimum_s:g} s")
        given = {f.name: f.read(values[f"answer.{f.name}"]) for f in step.fields}
        answer = Answer(
            step.id,
            dict(step.condition) | (session.screen if is_screen(step.id) else {}),
            given,
            elapsed_ms=float(values["elapsed_ms"]),
            shown_px=float(values["shown_px"]),
            assigned=_assigned(self.study, self.folder, step.id, given),
        )
        try:
            self.folder.store(session.participant, answer)
        except OSError as error:
            self._complain(client, error)
            return
        self._shown_since.pop(key, None)
        self._tell(client, session)

    def _complain(self, client: StreamClient, error: OSError) -> None:
        LOG.error("not stored: %s", error)
        client.say(_message("problem", text="The answer could not be stored. Call the researcher."))

    def _tell(self, client: StreamClient, session: Session) -> None:
        step = self.study.step(session)
        if step is None:
            agreed = session.answer(CONSENT)
            declined = agreed is not None and agreed.values["agree"] != "yes"
            client.say(_message("end", declined=declined, participant=session.participant))
            return
        self._shown_since.setdefault((session.participant, step.id), time.monotonic())
        message = step.message(px_per_degree=scale_of(session))
        progress = round(self.study.progress(session), 4)
        client.say(json.dumps(message | {"progress": progress, "participant": session.participant}))


_SCREEN = {
    "screen_px": Kind(float, 0.0, 1e6, optional=True),
    "pixel_ratio": Kind(float, 0.0, 1e3, optional=True),
}
"""Fields about a browser's screen: width in CSS pixels, and device pixels per CSS pixel."""


def _assigned(
    study: Study, folder: StudyFolder, step: str, values: Mapping[str, Value]
) -> int | None:
    """Return the place in the sequence of orders that an answer assigns; None: it assigns none."""
    has_about = any(each.id == ABOUT for each in study.opening())
    if step == ABOUT or (step == CONSENT and not has_about and values["agree"] == "yes"):
        return folder.next_place(str(values.get("group") or ""), study.num_orders)
    return None


def _refuse_simulated(code: str) -> None:
    """Refuse people who enter the code of a simulated participant."""
    if code.lower().startswith(SIMULATED):
        raise InputError(
            f"participant: expected a code that does not begin with {SIMULATED}, which simulated "
            f"participants have, got {code}"
        )


def is_screen(step: str) -> bool:
    """Return whether the step with this id measures the screen."""
    return step == "screen" or step.startswith("screen_")


def screens_of(session: Session) -> list[Answer]:
    """Return the answers that measured a participant's screens, in order of time."""
    return [answer for answer in session.answers if is_screen(answer.step)]


def scale_of(session: Session, answer: Answer | None = None) -> float | None:
    """Return the CSS pixels per visual degree of a participant's screen; None: not measured.

    The screen is the one on which ``answer`` was given; without ``answer``, the current one.
    """
    found = None
    for each in session.answers:
        if each is answer:
            break
        if is_screen(each.step):
            found = each
    if found is None:
        return None
    card, distance = found.values["card_px"], found.values["distance_cm"]
    return px_per_degree(float(card or 0), float(distance or 0))


def next_screen_step(session: Session) -> Step | None:
    """Return the step that measures the screen; None: the current screen has been measured.

    A participant who opens the page on another screen, or at another zoom, measures again. Answers
    of older versions, which do not describe the screen, count as given on the current one.
    """
    measured = screens_of(session)
    if not measured:
        return screen_step()
    last = {name: measured[-1].condition.get(name) for name in session.screen}
    if None in last.values() or last == session.screen:
        return None
    return screen_step(len(measured) + 1)


def screen_step(number: int = 1) -> Step:
    """Return the step that measures the screen, for stimuli in visual degrees."""
    return Step(
        "screen" if number == 1 else f"screen_{number}",
        "Your screen",
        (
            "Hold a bank card to the screen and move the slider until the drawn card is as wide "
            "as yours. Then measure from your eyes to the screen, and keep that distance.",
        ),
        (
            Field("card_px", "Width of the card", "card", low=100, high=1200),
            Field("distance_cm", "From your eyes to the screen, cm", "number", low=20, high=300),
        ),
    )


def _answer_kinds(step: Step) -> dict[str, Kind]:
    own = {f"answer.{each.name}": each.kind for each in step.fields}
    return {
        "step": Kind(str, choices=[step.id]),
        "elapsed_ms": Kind(float, 0.0, 1e9),
        "shown_px": Kind(float, 0.0, 20_000.0),
        **own,
    }


def _message(kind: str, **values: Any) -> str:
    return json.dumps({"type": kind, **values})


@dataclass(frozen=True)
class StudyReport:
    """Result of `run_study`.

    Attributes
    ----------
    participants : mapping of str to str
        State of each participant in the folder: ``finished``, ``declined`` or ``unfinished``.
    answers : int
        Number of answers in the folder.
    refused : mapping of str to int
        Number of messages or connections that the server refused, by reason.
    """

    participants: Mapping[str, str]
    answers: int
    refused: Mapping[str, int]

    __repr__ = short_repr


@checked
def state_of(study: Study, session: Session) -> str:
    """Return the state of a participant.

    Parameters
    ----------
    study : Study
    session : Session

    Returns
    -------
    str
        ``finished``, ``declined`` or ``unfinished``.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from manip3d import study
    >>> with tempfile.TemporaryDirectory() as place:
    ...     file = study.write_template("display", Path(place) / "study.toml", example=True)
    ...     study.state_of(study.read_study(file)[0], study.Session("P1", 0))
    'unfinished'
    """
    agreed = session.answer(CONSENT)
    if agreed is not None and agreed.values["agree"] != "yes":
        return "declined"
    return "unfinished" if study.step(session) is not None else "finished"


@checked
def run_study(
    study: Study,
    folder: StudyFolder,
    *,
    participant: str | None = None,
    port: int = 0,
    seconds: float | None = None,
    on_start: Callable[[str], object] | None = None,
) -> StudyReport:
    """Serve a study to browsers on this machine, until Ctrl-C.

    Parameters
    ----------
    study : Study
    folder : StudyFolder
        Folder of the answers. A participant who was interrupted continues by entering the same
        code.
    participant : str, optional
        Code of the only participant who may take part.
    port : int
        Port of the server; 0: any free port.
    seconds : float, optional
        Stop after this time.
    on_start : callable(str), optional
        Called with the page's address as soon as it can be opened.

    Returns
    -------
    StudyReport

    Raises
    ------
    InputError
        An argument is out of range, a stimulus is missing, or the folder holds simulated
        participants, which people must not mix with.
    RenderError
        The page is not built.
    MissingExtraError
        aiohttp is not installed.
    """
    if seconds is not None and not 0 < seconds <= threading.TIMEOUT_MAX:
        raise InputError(f"seconds: expected > 0 and <= {threading.TIMEOUT_MAX:.0f}, got {seconds}")
    if participant is not None:
        _refuse_simulated(participant)
        folder.check_code(participant)
    simulated = [code for code, session in folder.sessions.items() if session.is_simulated]
    if simulated:
        raise InputError(
            f"{folder.path}: expected no simulated participants, found {simulated[0]}; "
            "people need another folder"
        )
    study.check_stimuli()
    server = study_server(study, folder, participant, port)
    # Ctrl-C is the normal end.
    with server, contextlib.suppress(KeyboardInterrupt):
        if on_start is not None:
            on_start(server.new_url())
        threading.Event().wait(seconds)
    return StudyReport(
        {code: state_of(study, session) for code, session in folder.sessions.items()},
        sum(len(session.answers) for session in folder.sessions.values()),
        dict(server.refused),
    )


@checked
def simulate_participants(
    study: Study,
    folder: StudyFolder,
    count: int,
    *,
    seed: int = 0,
) -> list[str]:
    """Let simulated participants take part, to try a study before people do.

    Answers in the folder are kept: participants who began before finish, and a larger ``count``
    adds others. The answers are those of one call.

    Parameters
    ----------
    study : Study
    folder : StudyFolder
        Folder of the answers, without answers of people, because they must not be mixed.
    count : int
        Number of participants, 1 to 10000.
    seed : int
        Seed of the answers; they also depend on the study's own seed.

    Returns
    -------
    list of str
        Codes of the participants, which begin with ``sim-``.

    Raises
    ------
    InputError
        ``count`` or ``seed`` is out of range, or the folder holds other participants.
    OSError
        An answer could not be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from manip3d import study
    >>> with tempfile.TemporaryDirectory() as place:
    ...     file = study.write_template("display", Path(place) / "study.toml", example=True)
    ...     asked, definition = study.read_study(file)
    ...     with study.StudyFolder(Path(place) / "answers", definition) as folder:
    ...         study.simulate_participants(asked, folder, 2)
    ['sim-000', 'sim-001']
    """
    if not 1 <= count <= 10_000:
        raise InputError(f"count: expected 1 to 10000, got {count}")
    if seed < 0:
        raise InputError(f"seed: expected 0 or more, got {seed}")
    people = [code for code, session in folder.sessions.items() if not session.is_simulated]
    if people:
        raise InputError(
            f"{folder.path}: expected no participants but simulated ones, found {people[0]}; "
            "simulate into another folder"
        )
    codes = [f"{SIMULATED}{number:03d}" for number in range(count)]
    for number, code in enumerate(codes):
        session = folder.begin(code)
        while (step := study.step(session)) is not None:
            # Each answer has its own generator, so that it is the same after an interruption.
            rng = np.random.default_rng([seed, study.common.seed, number, len(session.answers)])
            own = {CONSENT, ABOUT, "introduction", "screen"}
            if step.id in own:
                values = {f.name: _plausible(f, rng, number) for f in step.fields}
            else:
                values = study.simulate(session, step, rng)
            folder.store(
                code,
                Answer(
                    step.id,
                    dict(step.condition),
                    values,
                    assigned=_assigned(study, folder, step.id, values),
                ),
            )
    return codes


def _plausible(question: Field, rng: np.random.Generator, number: int) -> Value:
    if question.name == "agree":
        return "yes"
    if question.name == "group":
        return question.choices[number % len(question.choices)][0]
    if question.type == "choice":
        return question.choices[int(rng.integers(len(question.choices)))][0]
    if question.type == "text":
        return ""
    if question.name == "card_px":
        return 324.0
    if question.name == "distance_cm":
        return 60.0
    value = rng.uniform(question.low, question.high)
    return float(min(max(round(value), question.low), question.high))

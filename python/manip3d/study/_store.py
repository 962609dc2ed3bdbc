"""Folder of answers with a journal for each participant; acknowledged answers are never lost."""

from __future__ import annotations

import json
import os
import re
import threading
import time
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from manip3d._util.checked import checked
from manip3d._util.closing import Closing
from manip3d._util.durable import sync_folder
from manip3d._util.locks import locked_file
from manip3d._util.paths import path_of
from manip3d._util.reprs import short_repr
from manip3d._util.texts import counted
from manip3d.errors import FormatError, InputError
from manip3d.io._files import atomic_write, limited_bytes, regular_bytes
from manip3d.study._steps import ABOUT, CONSENT, Value

CODE = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,31}")
"""Codes of participants: pseudonyms, which are also file names."""

SIMULATED = "sim-"
"""Prefix of the codes of simulated participants; codes of people must not have it."""

CHECKSUMS = "sha256"
"""Key of a stored definition under which the SHA-256 of each stimulus is listed by name."""

_DEFINITION = "study.json"
_PARTICIPANTS = "participants"
_LOCK = ".lock"
_TEMPORARY = ".manip3d-"  # begin of the names of files that a killed writer leaves
_MAX_BYTES = 16 << 20  # largest size of a stored definition with the checksums of its stimuli


@dataclass(frozen=True)
class Answer:
    """Answer of a participant to one step.

    Attributes
    ----------
    step : str
        Id of the step.
    condition : mapping
        Truth about the stimuli of the step.
    values : mapping of str to value
        Answers by the names of the fields.
    elapsed_ms : float
        Time between display of the step and the answer, milliseconds, by the page's clock.
    shown_px : float
        Width at which each stimulus was shown, in CSS pixels; 0 without stimuli.
    time_ns : int
        Time of storage, as of `time.time_ns`.
    assigned : int or None
        Place in the sequence of orders, from `StudyFolder.next_place`. It is set in the step about
        the participant (group or demographics), or in the consent if the study asks for neither.
    """

    step: str
    condition: Mapping[str, Any]
    values: Mapping[str, Value]
    elapsed_ms: float = 0.0
    shown_px: float = 0.0
    time_ns: int = 0
    assigned: int | None = None


@dataclass
class Session:
    """Answers and conditions of one participant.

    Attributes
    ----------
    participant : str
    number : int
        One more than the largest number of the participants at the begin; 0 for the first. Random
        orders depend on it, so that no two participants of a study share a number. The number of a
        participant who has withdrawn may be given again: nothing of theirs is left to share it.
    answers : list of Answer
        Answers in order of time.
    screen : dict
        Last report of the page about its screen; empty if no page is open. Not stored.
    """

    participant: str
    number: int
    answers: list[Answer] = field(default_factory=list)
    screen: dict[str, float] = field(default_factory=dict, compare=False)

    __repr__ = short_repr

    def answer(self, step: str) -> Answer | None:
        """Return the answer to a step; None: there is none.

        Parameters
        ----------
        step : str
            Id of the step.
        """
        return next((each for each in self.answers if each.step == step), None)

    @property
    def is_simulated(self) -> bool:
        """Whether the code has the prefix of simulated participants and no answer took any time."""
        timed = any(answer.elapsed_ms > 0 for answer in self.answers)
        return self.participant.startswith(SIMULATED) and not timed

    @property
    def group(self) -> str:
        """The participant's group; empty if the study did not ask for it."""
        about = self.answer(ABOUT)
        return str(about.values.get("group") or "") if about else ""

    @property
    def assigned(self) -> int:
        """Place of the participant in the sequence of orders."""
        place = self._place
        return self.number if place is None else place

    @property
    def _place(self) -> int | None:
        found = [self.answer(step) for step in (ABOUT, CONSENT)]
        return next((a.assigned for a in found if a is not None and a.assigned is not None), None)


def is_file_of_study(folder: Path, name: str) -> bool:
    """Return whether a file of a folder may stand where the answers of a study are stored.

    Beside a definition any file may; a run that was killed early left no definition.
    """
    if (folder / _DEFINITION).is_file():
        return True
    return name in (_PARTICIPANTS, _LOCK) or name.startswith(_TEMPORARY)


@checked
class StudyFolder(Closing):
    """The answers of a study in a folder, for one process at a time; others may read them.

    Parameters
    ----------
    path : path-like
        The folder, created if absent.
    definition : mapping, optional
        Definition of the study, which is stored in a new folder. A folder with answers to another
        definition, or to stimuli whose files have changed, is refused. Without a definition the
        folder must exist.
    read_only : bool
        Read the answers stored at this moment, even while another process runs the study. Nothing
        can be stored, and damaged journals are skipped.

    Attributes
    ----------
    sessions : dict of str to Session
        Sessions by the codes of participants.
    damaged : dict of str to str
        Errors of skipped journals, by the codes of participants.

    Raises
    ------
    InputError
        The folder contains another definition or answers to other stimuli, or is in use.
    FormatError
        A file in the folder is damaged.
    OSError
        The folder cannot be read or written.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        definition: Mapping[str, Any] | None = None,
        *,
        read_only: bool = False,
    ) -> None:
        self.path = path_of(path)
        self.read_only = read_only
        self._mutex = threading.RLock()  # held while a method writes, or closes the folder
        self._lock: int | None = None
        if read_only and definition is not None:
            raise InputError("definition: cannot be given with read_only")
        if definition is None and not (self.path / _DEFINITION).is_file():
            raise InputError(f"{self.path}: expected a folder of a study, found no {_DEFINITION}")
        if not read_only:
            self._lock = self._locked()
        try:
            self.definition = self._agreed(definition)
            self.sessions: dict[str, Session] = {}
            self.damaged: dict[str, str] = {}
            for file in sorted((self.path / _PARTICIPANTS).glob("*.jsonl")):
                try:
                    self.sessions[file.stem] = self._read(file)
                except FileNotFoundError:
                    if not read_only:  # in read-only mode a participant may just have withdrawn
                        raise
                except FormatError as error:
                    if not read_only:
                        raise
                    self.damaged[file.stem] = str(error)
        except BaseException:
            self.close()
            raise

    def __repr__(self) -> str:
        people = counted(len(self.sessions), "participant")
        return f"<manip3d.study.StudyFolder: {self.path}, {people}>"

    def _locked(self) -> int:
        """Create the folder if it is absent, and lock it against other writers."""
        if not self.path.exists():
            self.path.mkdir(mode=0o700, parents=True)  # only the owner may read people's answers
        (self.path / _PARTICIPANTS).mkdir(exist_ok=True)
        lock = locked_file(self.path / _LOCK)
        if lock is None:
            raise InputError(f"{self.path}: another process is using this study")
        return lock

    def _refuse_if_read_only(self) -> None:
        if self.read_only:
            raise InputError(f"{self.path}: opened for reading only")
        if self._lock is None:
            raise InputError(f"{self.path}: this study was closed")

    def _agreed(self, definition: Mapping[str, Any] | None) -> dict[str, Any]:
        file = self.path / _DEFINITION
        if file.exists():
            try:
                stored = json.loads(limited_bytes(file, _MAX_BYTES))
            except (ValueError, RecursionError) as error:
                raise FormatError(f"expected JSON: {error}", file=str(file)) from None
            if not isinstance(stored, dict) or not isinstance(stored.get(CHECKSUMS, {}), dict):
                raise FormatError("expected an object", file=str(file))
            if definition is None:
                return stored
            if _canonical(_without_checksums(definition)) != _canonical(_without_checksums(stored)):
                raise InputError(
                    f"{self.path}: holds answers to another definition; a study that has changed "
                    "needs another folder"
                )
            if any((self.path / _PARTICIPANTS).glob("*.jsonl")):
                self._check_stimuli(stored.get(CHECKSUMS, {}), definition.get(CHECKSUMS, {}))
                return stored
        assert definition is not None
        atomic_write(file, _canonical(definition) + "\n")
        return dict(definition)

    def _check_stimuli(self, stored: Mapping[str, Any], given: Mapping[str, Any]) -> None:
        """Refuse changed stimuli; studies of older versions have no checksums and are accepted."""
        for name in sorted(stored.keys() & given.keys()):
            if stored[name] != given[name]:
                raise InputError(
                    f"{self.path}: holds answers to another file {name}, of SHA-256 "
                    f"{stored[name]}; stimuli that have changed need another folder"
                )

    def begin(self, participant: str) -> Session:
        """Return the session of a participant, a new or an interrupted one.

        Parameters
        ----------
        participant : str
            Code of the participant.

        Returns
        -------
        Session

        Raises
        ------
        InputError
            The code is malformed or differs from another one only in case, or the folder was opened
            read-only.
        """
        with self._mutex:
            self.check_code(participant)
            if participant in self.sessions:
                return self.sessions[participant]
            self._refuse_if_read_only()
            number = 1 + max((s.number for s in self.sessions.values()), default=-1)
            file = self._file(participant)
            atomic_write(file, _line({"participant": participant, "number": number}))
            self.sessions[participant] = Session(participant, number)
            return self.sessions[participant]

    def next_place(self, group: str, period: int) -> int:
        """Return the place in the sequence of orders for the next participant of a group.

        The place is free until `store` has stored the answer that it is assigned to. No lock is
        held in between: assign places in one thread, as the server of `run_study` does.

        Parameters
        ----------
        group : str
            Group of the participant; empty if the study has no groups.
        period : int
            Number of orders, after which the sequence begins again.

        Returns
        -------
        int
            The place, 0 to ``period`` - 1, that the fewest participants of the group have; of equal
            ones the first. The places of participants who have withdrawn do not count.

        Raises
        ------
        InputError
            ``period`` is less than 1.

        Examples
        --------
        >>> import tempfile
        >>> from manip3d.study import Answer, StudyFolder
        >>> with tempfile.TemporaryDirectory() as place:
        ...     with StudyFolder(place, {}) as folder:
        ...         for code in ("P0", "P1"):
        ...             _ = folder.begin(code)
        ...             own = folder.next_place("expert", 6)
        ...             about = Answer("about", {}, {"group": "expert"}, assigned=own)
        ...             _ = folder.store(code, about)
        ...         folder.withdraw("P0")
        ...         folder.next_place("expert", 6), folder.next_place("healthy", 6)
        (0, 0)
        """
        if period < 1:
            raise InputError(f"period: expected >= 1, got {period}")
        own = (s._place for s in self.sessions.copy().values() if s.group == group)
        taken = Counter(place % period for place in own if place is not None)
        return min(range(period), key=lambda place: taken[place])

    def check_code(self, participant: str) -> None:
        """Refuse a code that is malformed or too much like another participant's.

        Parameters
        ----------
        participant : str
            Code of the participant.

        Raises
        ------
        InputError
            The code has more than 32 characters or characters other than letters, digits, - and _,
            or differs from another code only in case.
        """
        if not CODE.fullmatch(participant):
            raise InputError(
                "participant: expected letters, digits, - and _, at most 32, "
                f"got {participant[:40]!r}"
            )
        others = [code.lower() for code in self.sessions.copy() if code != participant]
        if participant.lower() in others:
            raise InputError(f"participant: {participant} differs from another code only in case")

    def store(self, participant: str, answer: Answer) -> Answer:
        """Append an answer, and return after it is on the disk.

        Parameters
        ----------
        participant : str
            Code of the participant.
        answer : Answer

        Returns
        -------
        Answer
            The answer with the time of storage.

        Raises
        ------
        InputError
            There is no such participant, or the folder was opened for reading only.
        OSError
            The answer could not be written; the file is unchanged.
        """
        with self._mutex:
            self._refuse_if_read_only()
            self._refuse_unknown(participant)
            session = self.sessions[participant]
            stamped = replace(answer, time_ns=time.time_ns())
            content = _line(vars(stamped)).encode()
            descriptor = os.open(self._file(participant), os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC)
            try:
                size = os.fstat(descriptor).st_size
                try:
                    rest = memoryview(content)
                    while rest:
                        rest = rest[os.write(descriptor, rest) :]
                    os.fsync(descriptor)
                except BaseException:
                    os.ftruncate(descriptor, size)
                    raise
            finally:
                os.close(descriptor)
            session.answers.append(stamped)
        return stamped

    def withdraw(self, participant: str) -> None:
        """Delete all answers of a participant who has withdrawn their consent.

        Parameters
        ----------
        participant : str
            Code of the participant.

        Raises
        ------
        InputError
            There is no such participant, or the folder was opened for reading only.
        """
        with self._mutex:
            self._refuse_if_read_only()
            self._refuse_unknown(participant)
            self._file(participant).unlink()
            sync_folder(self.path / _PARTICIPANTS)
            del self.sessions[participant]

    def _refuse_unknown(self, participant: str) -> None:
        if participant not in self.sessions:
            raise InputError(f"participant: expected one of this study, got {participant!r}")

    def close(self) -> None:
        """Unlock the folder; may be called twice.

        Answers in memory can still be read, but nothing can be stored afterwards.
        """
        with self._mutex:
            if self._lock is not None:
                os.close(self._lock)
                self._lock = None

    def _file(self, participant: str) -> Path:
        return self.path / _PARTICIPANTS / f"{participant}.jsonl"

    def _read(self, file: Path) -> Session:
        """Read a journal without an incomplete last line, which was never acknowledged."""
        content = regular_bytes(file)
        whole = content[: content.rfind(b"\n") + 1]
        records = list(_records(whole, file))
        # In read-only mode the writer may just be appending to the last line.
        if len(whole) != len(content) and not self.read_only:
            with file.open("rb+") as stream:
                stream.truncate(len(whole))
                os.fsync(stream.fileno())
        try:
            head, *rest = records
            session = Session(str(head["participant"]), int(head["number"]))
            session.answers = [Answer(**record) for record in rest]
        except (KeyError, TypeError, ValueError) as error:
            raise FormatError(f"expected a journal of answers: {error}", file=str(file)) from None
        if session.participant != file.stem:
            raise FormatError(f"expected answers of {file.stem}", file=str(file))
        return session


def _canonical(definition: Mapping[str, Any]) -> str:
    return json.dumps(definition, sort_keys=True, ensure_ascii=False, indent=1)


def _without_checksums(definition: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in definition.items() if key != CHECKSUMS}


def _line(record: Mapping[str, Any]) -> str:
    """Return a record and its checksum as one line."""
    text = json.dumps(record, ensure_ascii=True, separators=(",", ":"))
    return f"{zlib.crc32(text.encode()):08x} {text}\n"


def _records(content: bytes, file: Path) -> Iterator[dict[str, Any]]:
    for number, line in enumerate(content.splitlines(), 1):
        check, _, text = line.partition(b" ")
        try:
            good = int(check, 16) == zlib.crc32(text)
            record = json.loads(text) if good else None
        except (ValueError, RecursionError):
            record = None
        if not isinstance(record, dict):
            raise FormatError(f"line {number}: damaged", file=str(file))
        yield record

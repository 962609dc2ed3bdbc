"""A damaged diary: what can be read is copied, what cannot is said."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import sqlite3
import stat
import subprocess
import sys
from datetime import datetime, timedelta, timezone
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from command_line import error_line, manip3d
from manip3d import FormatError, InputError

pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
pytest.importorskip("cryptography", reason="the extra 'diary' is not installed")

from manip3d.diary import Diary, DiaryGame, _rescue, export_csv, make_key, rescue_diary

PAGE = 4096
START = datetime(2026, 3, 2, 9, 0, tzinfo=timezone(timedelta(hours=-6)))
GAMES = 120
FILM = b"\xff\xd8" + bytes(9000)  # it goes on in other pages than its row's


def game(number: int) -> DiaryGame:
    return DiaryGame(
        at=START + timedelta(minutes=number), game="piano", difficulty=2, seed=number,
        ending="time", seconds=60.0, paused_s=2.5, score=17, misses=3, by_phantom=8,
        anomalies=((4.0, 16.5),) if number == 0 else (), limb="left_leg",
        source="openni2:", version="0.1", latency_ms=31.5, tracked=0.96,
    )  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A diary of two people; the second one plays."""
    path = tmp_path_factory.mktemp("made") / "kept.diary"
    make_key(path.with_name("a.key"))
    with Diary(path, key=path.with_name("a.key"), create=True) as diary:
        diary.enrol("P01", at=START)
        diary.enrol("P02", clips=True, at=START)
        session = diary.start_session("P02", at=START)
        for number in range(GAMES):
            diary.add_game(session, game(number), [[(0.0, FILM)]] if number == 0 else [])
        diary.add_rating("P02", 4, session=session, at=START)
    with contextlib.closing(sqlite3.connect(path)) as raw:
        raw.execute("PRAGMA journal_mode = DELETE")
    return path


@pytest.fixture
def kept(made: Path, tmp_path: Path) -> Path:
    """A copy of it, to be damaged."""
    shutil.copy(made.with_name("a.key"), tmp_path)
    return Path(shutil.copy(made, tmp_path))


def pages(path: Path, name: str, kind: str) -> list[int]:
    """Number of the root of a table or an index, or of the leaves below a root."""
    content = path.read_bytes()
    with contextlib.closing(sqlite3.connect(path)) as raw:
        (root,) = raw.execute(
            "SELECT rootpage FROM sqlite_master WHERE name = ?", (name,)
        ).fetchone()
    begin = PAGE * (root - 1)
    if kind == "root":
        return [root]
    assert content[begin] == 5, "the table has one page only"
    cells = int.from_bytes(content[begin + 3 : begin + 5], "big")
    found = []
    for cell in range(cells):  # a cell of an inner page begins with the number of its child
        at = begin + 12 + 2 * cell
        place = begin + int.from_bytes(content[at : at + 2], "big")
        found.append(int.from_bytes(content[place : place + 4], "big"))
    return [*found, int.from_bytes(content[begin + 8 : begin + 12], "big")]


def destroy(path: Path, page: int) -> bytes:
    content = bytearray(path.read_bytes())
    content[PAGE * (page - 1) : PAGE * page] = b"\xa5" * PAGE
    path.write_bytes(content)
    return bytes(content)


def games(path: Path) -> dict[int, int]:
    """Number and seed of each game of a diary in which nothing is damaged."""
    with Diary(path, key=path.with_name("a.key")) as diary:
        diary.check()
        found = [one for session in diary.sessions("P02") for one in session.games]
        return {one.number: one.seed for one in found}


def test_a_damaged_index_loses_nothing(kept: Path, tmp_path: Path) -> None:
    before = games(kept)
    damaged = destroy(kept, pages(kept, "games_of_participant", "root")[0])
    with pytest.raises(FormatError, match="'manip3d diary rescue' copies what can be read"):
        Diary(kept, key=tmp_path / "a.key")
    new = tmp_path / "new.diary"
    found = rescue_diary(kept, new)
    assert found.missing == ()
    assert found.output == new
    assert kept.read_bytes() == damaged
    assert stat.S_IMODE(new.stat().st_mode) == 0o600
    assert games(new) == before
    with Diary(new, key=tmp_path / "a.key") as diary:
        assert [person.identifier for person in diary.participants()] == ["P01", "P02"]
        assert [clip.pictures[0] for clip in diary.clips("P02")] == [(0.0, FILM)]
        export_csv(diary, tmp_path / "tables")
    assert len((tmp_path / "tables" / "games.csv").read_text().splitlines()) == 1 + GAMES


def test_a_diary_whose_name_is_not_utf_8_is_rescued(kept: Path, tmp_path: Path) -> None:
    odd = kept.rename(tmp_path / os.fsdecode(b"caf\xe9#%41.diary"))
    found = rescue_diary(odd, tmp_path / os.fsdecode(b"neu\xe9.diary"))
    assert found.missing == ()
    assert len(games(found.output)) == GAMES


def test_the_diary_is_left_as_it_was_without_files_beside_it(kept: Path, tmp_path: Path) -> None:
    with contextlib.closing(sqlite3.connect(kept)) as raw:
        raw.execute("PRAGMA journal_mode = WAL")  # as all diaries that the application has made
    damaged = destroy(kept, pages(kept, "games_of_participant", "root")[0])
    before = {path.name for path in tmp_path.iterdir()}
    rescue_diary(kept, tmp_path / "new.diary")
    assert kept.read_bytes() == damaged
    assert {path.name for path in tmp_path.iterdir()} == before | {"new.diary"}


def test_what_a_killed_program_left_in_the_log_is_read_and_stays(
    kept: Path, tmp_path: Path
) -> None:
    live = shutil.copy(kept, tmp_path / "live.diary")
    with contextlib.closing(sqlite3.connect(live, isolation_level=None)) as raw:
        raw.execute("PRAGMA journal_mode = WAL")
        raw.execute("DELETE FROM ratings")
        for ending in ("", "-wal"):
            shutil.copy(f"{live}{ending}", f"{kept}{ending}")
    log = kept.with_name(f"{kept.name}-wal")
    before = kept.read_bytes(), log.read_bytes()
    assert len(before[1]) > 0
    rescue_diary(kept, tmp_path / "new.diary")
    assert (kept.read_bytes(), log.read_bytes()) == before
    with contextlib.closing(sqlite3.connect(tmp_path / "new.diary")) as raw:
        assert raw.execute("SELECT count(*) FROM ratings").fetchone() == (0,)


def test_a_damaged_page_loses_its_rows_only(kept: Path, tmp_path: Path) -> None:
    before = games(kept)
    leaves = pages(kept, "games", "leaves")
    assert len(leaves) > 4
    destroy(kept, leaves[2])
    missing = rescue_diary(kept, tmp_path / "new.diary").missing
    # Numbers of rows are random: the page may hold the game that has an anomaly and a clip.
    (told,) = (told for told in missing if told.startswith("games: "))
    numbers = re.fullmatch(r"games: rows after (\d+) before (\d+) cannot be read", told)
    assert numbers is not None
    first, last = map(int, numbers.groups())
    lost = {number for number in before if first < number < last}
    assert 0 < len(lost) < GAMES // 2
    found = games(tmp_path / "new.diary")
    assert found == {number: seed for number, seed in before.items() if number not in lost}


def test_a_row_that_goes_on_in_a_damaged_page_is_missing_alone(kept: Path, tmp_path: Path) -> None:
    before = games(kept)
    with contextlib.closing(sqlite3.connect(kept)) as raw:
        number, payload = raw.execute("SELECT id, payload FROM clips").fetchone()
    destroy(kept, kept.read_bytes().index(payload[2000:2100]) // PAGE + 1)
    found = rescue_diary(kept, tmp_path / "new.diary")
    assert found.missing == (f"clips: row {number} cannot be read",)
    assert games(tmp_path / "new.diary") == before


def test_rows_of_somebody_who_is_missing_go_with_them(kept: Path, tmp_path: Path) -> None:
    destroy(kept, pages(kept, "participants", "root")[0])
    found = rescue_diary(kept, tmp_path / "new.diary")
    assert found.missing[0] == "participants: rows from the first to the last cannot be read"
    assert f"games: {GAMES} of participants that cannot be read" in found.missing
    assert any("a check calls them damaged" in told for told in found.missing)
    with Diary(tmp_path / "new.diary", key=tmp_path / "a.key") as diary:
        assert diary.participants() == []
        with pytest.raises(FormatError, match="audit"):
            diary.check()


def test_what_lies_between_two_damaged_pages_is_read(kept: Path, tmp_path: Path) -> None:
    before = games(kept)
    leaves = pages(kept, "games", "leaves")
    assert len(leaves) > 4
    destroy(kept, leaves[1])
    destroy(kept, leaves[-2])
    missing = rescue_diary(kept, tmp_path / "new.diary").missing
    lost = set()
    gaps = [told for told in missing if told.startswith("games: ")]
    assert len(gaps) == 2
    for told in gaps:
        numbers = re.fullmatch(r"games: rows after (\d+) before (\d+) cannot be read", told)
        assert numbers is not None
        first, last = map(int, numbers.groups())
        lost |= {number for number in before if first < number < last}
    assert 0 < len(lost) < GAMES * 3.5 / len(leaves)
    found = games(tmp_path / "new.diary")
    assert found == {number: seed for number, seed in before.items() if number not in lost}


def test_a_page_that_repeats_an_earlier_one_ends(kept: Path, tmp_path: Path) -> None:
    """A write went to the wrong place: the rows of the page lead back to what was read."""
    before = games(kept)
    leaves = pages(kept, "games", "leaves")
    content = bytearray(kept.read_bytes())
    source, target = (slice(PAGE * (page - 1), PAGE * page) for page in (leaves[1], leaves[3]))
    content[target] = content[source]
    kept.write_bytes(content)
    rescue_diary(kept, tmp_path / "new.diary")
    rescued = games(tmp_path / "new.diary")
    assert rescued.items() <= before.items()
    assert len(rescued) > GAMES * (1 - 3.0 / len(leaves))


@pytest.mark.parametrize(("share", "least"), [(0.5, 0), (0.8, 50), (0.95, 100)])
def test_what_a_copy_that_stopped_still_holds_is_read(
    share: float, least: int, kept: Path, tmp_path: Path
) -> None:
    """SQLite itself reads nothing of a file that is shorter than its head says."""
    size = kept.stat().st_size
    with kept.open("r+b") as file:
        file.truncate(int(share * size) + 100)  # within a page
    before = kept.read_bytes()
    with pytest.raises(FormatError, match=r"damaged: .*'manip3d diary rescue' copies what can be"):
        Diary(kept, key=tmp_path / "a.key")
    found = rescue_diary(kept, tmp_path / "rescued.diary")
    assert found.missing
    assert kept.read_bytes() == before
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]
    with Diary(found.output, key=tmp_path / "a.key") as diary:
        assert {person.identifier for person in diary.participants()} == {"P01", "P02"}
        (session,) = diary.sessions("P02")
        assert len(session.games) >= least


def test_a_disk_that_fails_is_no_damage(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A full disk while the diary is opened, where SQLite needs a file beside it."""

    def fails(*_: object, **__: object) -> None:
        error = sqlite3.OperationalError("disk I/O error")
        error.sqlite_errorcode = sqlite3.SQLITE_IOERR
        raise error

    monkeypatch.setattr("manip3d.diary._file.sqlite3.connect", fails)
    with pytest.raises(OSError, match="disk I/O error: '"):
        Diary(kept)
    full = SimpleNamespace(f_bavail=3, f_frsize=4096)
    monkeypatch.setattr("manip3d.diary._file.os.statvfs", lambda _: full)
    told = "the disk is full, and a diary needs some room even to be read; 'manip3d diary rescue'"
    with pytest.raises(OSError, match=told):
        Diary(kept)


def test_an_empty_log_of_a_full_disk_stops_no_rescue(
    kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To read a diary with a log, SQLite needs room for an index of the log."""
    with contextlib.closing(sqlite3.connect(kept)) as raw:
        raw.execute("PRAGMA journal_mode = WAL")
    Path(f"{kept}-wal").touch()
    modes, connected = {}, _rescue._connected

    def noted(path: Path, mode: str) -> contextlib.closing[sqlite3.Connection]:
        modes[path] = mode
        return connected(path, mode)

    monkeypatch.setattr(_rescue, "_connected", noted)
    assert rescue_diary(kept, kept.with_name("new.diary")).missing == ()
    assert modes[kept] == "ro&immutable=1"


def test_a_full_disk_is_no_damage(kept: Path, tmp_path: Path) -> None:
    resource = pytest.importorskip("resource")
    new, limits = tmp_path / "new.diary", resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (5 * PAGE, limits[1]))
    try:
        with pytest.raises(OSError, match="cannot be written"):
            rescue_diary(kept, new)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not new.exists()
    assert rescue_diary(kept, new).missing == ()


ON_A_FULL_DISK = """
import errno, os, shutil, sys
from pathlib import Path
from manip3d.diary import rescue_diary

kept, full = Path(sys.argv[1]), Path(sys.argv[2])
diary = Path(shutil.copy(kept, full))
with open(full / "rest", "wb", buffering=0) as rest:
    try:
        while rest.write(bytes(1024)):
            pass
    except OSError as error:
        assert error.errno == errno.ENOSPC, error
beside = sorted(os.listdir(full))
new = kept.with_name("new.diary")
print(rescue_diary(diary, new).missing)  # onto another disk
whole = diary.stat().st_size
for size in (whole, whole - 4096):  # the latter is copied before it is read
    os.truncate(diary, size)
    try:
        rescue_diary(diary, full / "new.diary")
    except OSError as error:
        print(error.errno == errno.ENOSPC, os.path.basename(error.filename))
    assert sorted(os.listdir(full)) == beside, os.listdir(full)
"""


def test_a_diary_on_a_full_disk_is_rescued_onto_another(kept: Path, tmp_path: Path) -> None:
    with contextlib.closing(sqlite3.connect(kept)) as raw:
        raw.execute("PRAGMA journal_mode = WAL")  # as all diaries that the application has made
    full = tmp_path / "full"
    full.mkdir()
    mount = f"mount -t tmpfs -o size={kept.stat().st_size // 1024 + 20}k none {full} && exec "
    namespace = ["unshare", "-rm", "sh", "-c"]
    if subprocess.run([*namespace, mount + "true"], capture_output=True).returncode:
        pytest.skip("no mount namespaces here")
    script = mount + f'{sys.executable} -c "$0" {kept} {full}'
    done = subprocess.run([*namespace, script, ON_A_FULL_DISK], capture_output=True, text=True)
    assert done.stdout.splitlines() == ["()", "True new.diary", "True new.diary"], done.stderr
    assert len(games(tmp_path / "new.diary")) == GAMES


def test_a_full_disk_beside_a_log_is_no_damage(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """SQLite makes an index of a log beside it."""
    connected = _rescue._connected

    class Fails:
        def execute(self, query: str) -> None:
            error = sqlite3.OperationalError("disk I/O error")
            error.sqlite_errorcode = sqlite3.SQLITE_IOERR
            if query == "BEGIN":
                raise error

        def close(self) -> None:
            pass

    monkeypatch.setattr(
        _rescue,
        "_connected",
        lambda path, mode: contextlib.closing(Fails()) if path == kept else connected(path, mode),
    )
    new = kept.with_name("new.diary")
    with pytest.raises(FormatError, match=r"kept\.diary: cannot be rescued: disk I/O error"):
        rescue_diary(kept, new)
    full = SimpleNamespace(f_bavail=3, f_frsize=4096)
    monkeypatch.setattr("manip3d.diary._file.os.statvfs", lambda _: full)
    with pytest.raises(OSError, match=r"the disk is full, and a diary .*kept\.diary'$"):
        rescue_diary(kept, new)


def test_a_diary_that_is_written_meanwhile_is_no_damage(
    kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with contextlib.closing(sqlite3.connect(kept)) as raw:
        raw.execute("PRAGMA journal_mode = WAL")
    make_tables, new = _rescue._make_tables, kept.with_name("new.diary")

    def write_meanwhile(*arguments: Any) -> None:
        make_tables(*arguments)
        with contextlib.closing(sqlite3.connect(kept, isolation_level=None)) as other:
            other.execute("DELETE FROM ratings")

    monkeypatch.setattr(_rescue, "_make_tables", write_meanwhile)
    with pytest.raises(OSError, match=r"another program wrote to the diary meanwhile: .*kept"):
        rescue_diary(kept, new)
    assert not new.exists()

    def find_damage_meanwhile(*_: Any) -> int:
        os.utime(kept, ns=(0, 0))
        raise sqlite3.DatabaseError("database disk image is malformed")

    monkeypatch.setattr(_rescue, "_version", find_damage_meanwhile)
    with pytest.raises(OSError, match=r"another program wrote to the diary meanwhile: .*kept"):
        rescue_diary(kept, new)


def test_a_diary_that_is_written_is_no_damage(kept: Path, tmp_path: Path) -> None:
    new = tmp_path / "new.diary"
    with contextlib.closing(sqlite3.connect(kept, isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        with pytest.raises(OSError, match="locked"):
            rescue_diary(kept, new)
    new.with_name("new.diary-wal").write_bytes(b"of another diary")
    with pytest.raises(InputError, match=r"output: .*new.diary-wal belongs to a diary"):
        rescue_diary(kept, new, overwrite=True)


def test_what_would_not_open_is_no_rescue(kept: Path, tmp_path: Path) -> None:
    new = tmp_path / "new.diary"
    with pytest.raises(InputError, match="output: expected another file than the diary"):
        rescue_diary(kept, kept, overwrite=True)
    destroy(kept, pages(kept, "meta", "root")[0])
    with pytest.raises(FormatError, match=r"audit key, check, study cannot be read"):
        rescue_diary(kept, new)
    (tmp_path / "text").write_text("no diary\n" * 1000)
    with pytest.raises(FormatError, match="file is not a database"):
        rescue_diary(tmp_path / "text", new)
    with contextlib.closing(sqlite3.connect(tmp_path / "other")) as other:
        other.execute("CREATE TABLE a (b)")
    with pytest.raises(FormatError, match="expected a diary, got another file"):
        rescue_diary(tmp_path / "other", new)
    with pytest.raises(FileNotFoundError):
        rescue_diary(tmp_path / "absent", new)
    with pytest.raises(FormatError, match="expected a regular file"):
        rescue_diary(tmp_path, new)
    (tmp_path / "empty").touch()
    with pytest.raises(FormatError, match="expected a diary, got an empty file"):
        rescue_diary(tmp_path / "empty", new)
    assert not new.exists()
    new.write_text("mine")
    with pytest.raises(InputError, match=r"output: .*new.diary exists already; overwrite=True "):
        rescue_diary(kept, new)
    assert new.read_text() == "mine"
    os.mkfifo(tmp_path / "pipe")
    for place in (tmp_path / "pipe", tmp_path):
        with pytest.raises(InputError, match="output: expected the name of a regular file"):
            rescue_diary(kept, place, overwrite=True)
        done = manip3d("diary", "rescue", kept, "-o", place, "--force")
        assert f"-o {place}: exists already; give another name" in error_line(done)
    assert (tmp_path / "pipe").is_fifo()


def test_the_command_says_what_is_missing(kept: Path, tmp_path: Path) -> None:
    whole = manip3d("diary", "rescue", kept, "-o", tmp_path / "whole.diary")
    assert whole.returncode == 0, whole.stderr
    assert "nothing is missing" in whole.stderr
    destroy(kept, pages(kept, "games", "leaves")[2])
    done = manip3d("diary", "rescue", kept, "-o", tmp_path / "new.diary", "--json")
    assert done.returncode == 1
    assert "games: rows after" in done.stdout
    assert (tmp_path / "new.diary").exists()


def plain(tmp_path: Path) -> Path:
    """A diary that is not encrypted, of two people with a rating each."""
    path = tmp_path / "plain.diary"
    with Diary(path, create=True) as diary:
        for name in ("P01", "P02"):
            diary.enrol(name, at=START)
            session = diary.start_session(name, at=START)
            diary.add_rating(name, 4, session=session, at=START)
    with contextlib.closing(sqlite3.connect(path)) as raw:
        raw.execute("PRAGMA journal_mode = DELETE")
    return path


def set_payload(path: Path, table: str, payload: object) -> int:
    with contextlib.closing(sqlite3.connect(path)) as raw:
        (number,) = raw.execute(f"SELECT min(id) FROM {table}").fetchone()
        raw.execute(f"UPDATE {table} SET payload = ? WHERE id = ?", (payload, number))
        raw.commit()
    return int(number)


@pytest.mark.parametrize("payload", [b'{2at":1}', b"[]", 7, b"\xff"])
def test_a_payload_that_is_not_json_is_left_out(tmp_path: Path, payload: object) -> None:
    path = plain(tmp_path)
    number = set_payload(path, "ratings", payload)
    done = manip3d("diary", "rescue", path, "-o", tmp_path / "new.diary")
    said = done.stderr
    assert done.returncode == 1
    assert f"ratings: the content of row {number} cannot be read" in said
    with Diary(tmp_path / "new.diary") as diary:
        diary.check()
        found = [diary.sessions(name)[0].ratings for name in ("P01", "P02")]
    assert sorted(map(len, found)) == [0, 1]


def test_a_participant_that_is_not_json_is_left_out_with_all_rows(tmp_path: Path) -> None:
    path = plain(tmp_path)
    number = set_payload(path, "participants", b"{2}")
    missing = rescue_diary(path, tmp_path / "new.diary").missing
    assert missing[0] == f"participants: the content of row {number} cannot be read"
    assert "sessions: 1 of participants that cannot be read" in missing
    with Diary(tmp_path / "new.diary") as diary:
        assert len(diary.participants()) == 1
        assert all(len(diary.sessions(one.identifier)) == 1 for one in diary.participants())


def test_with_the_key_encrypted_payloads_are_checked(kept: Path, tmp_path: Path) -> None:
    key, new = tmp_path / "a.key", tmp_path / "new.diary"
    numbers = {table: set_payload(kept, table, bytes(60)) for table in ("ratings", "clips")}
    assert rescue_diary(kept, new).missing == ()
    assert rescue_diary(kept, new, key=key, overwrite=True).missing == tuple(
        f"{table}: the content of row {numbers[table]} cannot be read"
        for table in ("clips", "ratings")
    )
    with Diary(new, key=key) as diary:
        diary.check()
        assert len(diary.sessions("P02")[0].games) == GAMES


def test_a_key_that_does_not_fit_is_refused(kept: Path, tmp_path: Path) -> None:
    make_key(tmp_path / "other.key")
    with pytest.raises(FormatError, match="this key does not open it"):
        rescue_diary(kept, tmp_path / "new.diary", key=tmp_path / "other.key")
    with pytest.raises(InputError, match="not encrypted"):
        rescue_diary(plain(tmp_path), tmp_path / "new.diary", key=tmp_path / "other.key")
    assert not (tmp_path / "new.diary").exists()


def test_a_damaged_payload_of_a_plain_diary_names_the_rescue(tmp_path: Path) -> None:
    path = plain(tmp_path)
    set_payload(path, "ratings", b"{2}")
    with Diary(path) as diary, pytest.raises(FormatError, match=r"damaged; .*rescue") as caught:
        diary.check()
    assert "encrypted" not in str(caught.value)


def test_an_audit_that_is_not_utf8_loses_that_row(tmp_path: Path) -> None:
    path = plain(tmp_path)
    content = bytearray(path.read_bytes())
    with contextlib.closing(sqlite3.connect(path)) as raw:
        ((number, at),) = raw.execute(
            "SELECT number, at FROM audit WHERE action = 'rating' ORDER BY number LIMIT 1"
        ).fetchall()
    content[content.index(f"{at}rating".encode()) + len(at)] |= 0x80
    path.write_bytes(content)
    with Diary(path) as diary, pytest.raises(FormatError, match="damaged"):
        diary.audit()
    found = rescue_diary(path, tmp_path / "new.diary")
    assert found.missing == (f"audit: row {number} cannot be read",)
    with Diary(tmp_path / "new.diary") as diary:
        assert [len(diary.sessions(name)[0].ratings) for name in ("P01", "P02")] == [1, 1]


def test_a_list_of_tables_that_is_not_utf8_is_damage(tmp_path: Path) -> None:
    path = plain(tmp_path)
    content = bytearray(path.read_bytes())
    content[content.index(b"ratings_of_participant")] |= 0x80
    path.write_bytes(content)
    with pytest.raises(FormatError, match="damaged"):
        Diary(path)
    with pytest.raises(FormatError, match="cannot be rescued"):
        rescue_diary(path, tmp_path / "new.diary")

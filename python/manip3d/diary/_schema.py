"""Tables of a diary, and migrations of older files.

Column ``payload`` contains a participant's data as JSON, encrypted with the participant's key if
the diary is encrypted. The other columns only relate rows to each other.
"""

from __future__ import annotations

from collections.abc import Sequence

from manip3d.errors import MissingExtraError

try:
    from sqlalchemy import (
        Column,
        Connection,
        ForeignKey,
        Integer,
        LargeBinary,
        MetaData,
        Table,
        Text,
    )
except ModuleNotFoundError as error:
    raise MissingExtraError("sqlalchemy", "diary") from error

APPLICATION = 0x4D334459  # "M3DY", the application id that marks an SQLite file as a diary

OWNERSHIP, FELT, FORM = "ownership", "felt", "form"
"""Kinds of questionnaires in payloads; McGill questionnaires are stored without a kind."""

_metadata = MetaData()


def _belongs_to(table: str) -> ForeignKey:
    return ForeignKey(f"{table}.id", ondelete="CASCADE")


META = Table(
    "meta",
    _metadata,
    Column("name", Text, primary_key=True),
    Column("value", LargeBinary, nullable=False),
)
PARTICIPANTS = Table(
    "participants",
    _metadata,
    Column("id", Integer, primary_key=True),
    Column("key", LargeBinary, nullable=False),
    Column("payload", LargeBinary, nullable=False),
)


_TABLE_OF = {"anomaly": "anomalies"}


def _table(name: str, *parents: str) -> Table:
    return Table(
        name,
        _metadata,
        Column("id", Integer, primary_key=True),
        Column("participant", _belongs_to("participants"), nullable=False),
        *(Column(parent, _belongs_to(_TABLE_OF.get(parent, f"{parent}s"))) for parent in parents),
        Column("payload", LargeBinary, nullable=False),
    )


SESSIONS = _table("sessions")
GAMES = _table("games", "session")
ANOMALIES = _table("anomalies", "game")
CLIPS = _table("clips", "anomaly")
RATINGS = _table("ratings", "session")
QUESTIONNAIRES = _table("questionnaires")
EVENTS = _table("events", "session")
AUDIT = Table(
    "audit",
    _metadata,
    Column("number", Integer, primary_key=True),
    Column("at", Text, nullable=False),
    Column("action", Text, nullable=False),
    Column("participant", ForeignKey("participants.id", ondelete="SET NULL")),
    Column("erased", Text, nullable=False),
    Column("salt", Text, nullable=False),
    Column("digest", Text, nullable=False),
    Column("link", Text, nullable=False),
)

TABLES = _metadata.tables
"""Tables by name."""

_ID = "id INTEGER PRIMARY KEY"
_GONE_TOO = "ON DELETE CASCADE"
_ROW = f"{_ID}, participant INTEGER NOT NULL REFERENCES participants {_GONE_TOO}"
_SESSION = f"session INTEGER REFERENCES sessions {_GONE_TOO}"
_GAME = f"game INTEGER REFERENCES games {_GONE_TOO}"
_ANOMALY = f"anomaly INTEGER REFERENCES anomalies {_GONE_TOO}"
_PAYLOAD = "payload BLOB NOT NULL"
_WITH_PARTICIPANT = (
    "sessions", "games", "anomalies", "ratings", "questionnaires", "events", "audit",
)  # fmt: skip

# Statements that migrate each version to the next. Never change an entry; only append new ones.
MIGRATIONS: Sequence[Sequence[str]] = (
    (  # 0 (an empty file) to 1: participants, sessions, games and audit
        "CREATE TABLE meta (name TEXT PRIMARY KEY, value BLOB NOT NULL)",
        f"CREATE TABLE participants ({_ID}, key BLOB NOT NULL, {_PAYLOAD})",
        f"CREATE TABLE sessions ({_ROW}, {_PAYLOAD})",
        f"CREATE TABLE games ({_ROW}, {_SESSION}, {_PAYLOAD})",
        f"CREATE TABLE audit ({_ID}, at TEXT NOT NULL, action TEXT NOT NULL, "
        f"participant INTEGER REFERENCES participants {_GONE_TOO})",
    ),
    (  # 1 to 2: anomalies, ratings, questionnaires and adverse events
        f"CREATE TABLE anomalies ({_ROW}, {_GAME}, {_PAYLOAD})",
        f"CREATE TABLE ratings ({_ROW}, {_SESSION}, {_PAYLOAD})",
        f"CREATE TABLE questionnaires ({_ROW}, {_PAYLOAD})",
        f"CREATE TABLE events ({_ROW}, {_SESSION}, {_PAYLOAD})",
    ),
    tuple(  # 2 to 3: indices, so that deleting and listing read only a participant's own rows
        f"CREATE INDEX {table}_of_participant ON {table} (participant)"
        for table in _WITH_PARTICIPANT
    ),
    (  # 3 to 4: clips of anomalies
        f"CREATE TABLE clips ({_ROW}, {_ANOMALY}, {_PAYLOAD})",
        "CREATE INDEX clips_of_participant ON clips (participant)",
    ),
    (),  # 4 to 5: payloads of games have new fields, which older programs do not understand
    # 5 to 6: `meta` contains the study's identifier, which `Diary` writes because it is encrypted
    # like payloads; any questionnaire can be stored.
    (),
    (  # 6 to 7: the audit is a chain of hashes; `Diary` converts the existing rows
        "DROP TABLE audit",
        "CREATE TABLE audit (number INTEGER PRIMARY KEY, at TEXT NOT NULL, action TEXT NOT NULL, "
        "participant INTEGER REFERENCES participants ON DELETE SET NULL, erased TEXT NOT NULL, "
        "salt TEXT NOT NULL, digest TEXT NOT NULL, link TEXT NOT NULL)",
        "CREATE INDEX audit_of_participant ON audit (participant)",
    ),
)
VERSION = len(MIGRATIONS)
WITH_STUDY = 6  # first version whose `meta` names the study
WITH_CHAIN = 7  # first version whose audit rows are linked by hashes


def migrate(connection: Connection, start: int, to: int = VERSION) -> None:
    """Migrate a file to a version, within the transaction of the connection."""
    for statements in MIGRATIONS[start:to]:
        for statement in statements:
            connection.exec_driver_sql(statement)
    connection.exec_driver_sql(f"PRAGMA application_id = {APPLICATION}")
    connection.exec_driver_sql(f"PRAGMA user_version = {to}")

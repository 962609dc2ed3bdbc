"""A keyed watermark: scans that were not changed since they were embedded, and proof of it."""

from __future__ import annotations

import hashlib
import hmac
import os
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from manip3d import _core
from manip3d._util.arrays import vector
from manip3d._util.checked import checked
from manip3d._util.closing import Closing
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.paths import path_of
from manip3d._util.showing import Showable
from manip3d.authenticate._keys import KeyFile, KeyRing
from manip3d.authenticate._picture_records import checked_picture
from manip3d.authenticate._verdict import Calibration, Power, Region
from manip3d.authenticate._verified_frames import VerifiedFrames
from manip3d.errors import Error, FormatError, InputError
from manip3d.io._scan_tables import measured_points
from manip3d.lidar import Box, LidarFrame, ScanFormat, ScanLike, as_frame, to_scan

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

Embedding: TypeAlias = Literal["detached", "lbm", "qim"]
WatermarkVerdict: TypeAlias = Literal["authentic", "tampered", "undecidable"]
"""``authentic``: the content holds, and order and freshness are as the policy demands.
``tampered``: points, columns or carrier bits are not those that were embedded, or the frame was
seen before. ``undecidable``: nothing can be said, the reason tells why (no record, another key, a
gap in the stream ...)."""

EMBEDDINGS: tuple[Embedding, ...] = ("detached", "lbm", "qim")
CARRIERS: tuple[str, ...] = ("sidecar", "picture")
_VERDICTS: tuple[WatermarkVerdict, ...] = ("authentic", "tampered", "undecidable")
_CONTENT = ("intact", "tampered", "unverifiable")
_ORDER = ("unknown", "in order", "gap", "replay")
_FRESHNESS = ("unknown", "fresh", "stale")
_TILES = ("intact", "bits", "changed")

MAX_MOVE_M: Mapping[str, float] = ReadOnlyMapping(
    {"detached": 0.0, "lbm": 3.0**0.5 / 1000.0, "qim": 0.001875}
)
"""Largest move of a point by each embedding, metres (QIM: of points not within 3 mm of the
origin; LBM: on a grid of 1 mm, on another one in proportion to its step)."""


def _verifier_of(ring: KeyRing) -> _core.WatermarkVerifier:
    verifier = _core.WatermarkVerifier(ring.newest._key)
    for newer, older in pairwise(ring.keys):
        verifier.add_older_key(older._key, newer.created_ns)
    return verifier


@checked
@dataclass(frozen=True)
class Policy:
    """Policy of a verifier. A record is compared with it, never obeyed.

    Attributes
    ----------
    embeddings : sequence of str
        Names out of ``detached``, ``lbm`` and ``qim``.
    order : 'chain' or 'any'
        ``chain``: a frame must follow the one before it, or begin its session. ``any``: a frame
        whose place is not known is accepted, such as a single one; gaps and replays never are.
    sensors : sequence of str
        Names of the sensors that are expected; none: any.
    sessions : sequence of str
        Hexadecimal identifiers of the sessions that are expected; none: any.
    max_age_s : float or None
        Largest difference, seconds, between a record's time and the verifier's clock; None: age
        does not matter, as for recordings.
    max_points : int
        Larger scans are not looked at.
    units_per_m : sequence of int
        Grids, in steps a metre, whose points may carry bits; none: any that a record states.
    carriers : sequence of str
        Names out of ``sidecar`` (a record beside the scan) and ``picture``.
    """

    embeddings: Sequence[str] = EMBEDDINGS
    order: str = "chain"
    sensors: Sequence[str] = ()
    sessions: Sequence[str] = ()
    max_age_s: float | None = None
    max_points: int = 10_000_000
    units_per_m: Sequence[int] = ()
    carriers: Sequence[str] = CARRIERS

    def __post_init__(self) -> None:
        for each in self.embeddings:
            _embedding_number(each)
        for carrier in self.carriers:
            if carrier not in CARRIERS:
                raise InputError(f"carriers: expected {' or '.join(CARRIERS)}, got {carrier!r}")
        if self.order not in ("chain", "any"):
            raise InputError(f"order: expected chain or any, got {self.order!r}")
        if self.max_age_s is not None and not 0.0 < self.max_age_s < 9e9:
            raise InputError(f"max_age_s: expected more than 0 and below 9e9, got {self.max_age_s}")
        if not 0 < self.max_points < 2**31:
            raise InputError(f"max_points: expected 1 to 2147483647, got {self.max_points}")
        for units in self.units_per_m:
            _check_units(units)
        for each in self.sensors:
            _sensor_bytes(each)
        for each in self.sessions:
            _session_bytes(each)

    def _core(self) -> _core.WatermarkPolicy:
        return _core.WatermarkPolicy(
            [_embedding_number(each) for each in self.embeddings],
            [CARRIERS.index(each) for each in self.carriers],
            [_sensor_bytes(each) for each in self.sensors],
            [_session_bytes(each) for each in self.sessions],
            self.max_points,
            self.order == "any",
            0 if self.max_age_s is None else round(self.max_age_s * 1e9),
            None,
            list(self.units_per_m),
        )


@dataclass(frozen=True, eq=False, repr=False)
class Watermarked(Showable):
    """A scan with its watermark.

    Attributes
    ----------
    frame : LidarFrame
        As it came, with the points that carry the bits; ``exact`` coordinates follow.
    record : bytes
        What `Watermarker.verify` needs beside the scan, about 1 kB.
    number : int
        Number of the frame in its session.
    num_tiles : int
        Sectors that are verified one by one.
    is_detached : bool
        The points stayed as they were.
    picture : (H, W) or (H, W, 3) uint8, or None
        The picture with the record in its lowest bits, if one was given: nothing else has to
        travel beside the scan then.
    """

    frame: LidarFrame
    record: bytes
    number: int
    num_tiles: int
    is_detached: bool = False
    picture: NDArray[np.uint8] | None = field(default=None, repr=False)

    @property
    def points(self) -> NDArray[np.float32]:
        """(N, 3) float32, metres: those of `frame`."""
        return self.frame.points

    def __repr__(self) -> str:
        return (
            f"<manip3d.authenticate.Watermarked: frame {self.number}, "
            f"{self.frame.num_points} points, {self.num_tiles} tiles, "
            f"record of {len(self.record)} bytes>"
        )


@dataclass(frozen=True)
class Tile:
    """A sector of the scan that is verified by itself.

    Attributes
    ----------
    state : 'intact', 'bits' or 'changed'
        ``bits``: its content holds, but carrier bits differ. ``changed``: its points are not those
        that were embedded; which of them is not said, because that would help a forger.
    azimuths_deg : tuple of (float, float)
        Where its slices begin and end, degrees, counter-clockwise from x.
    """

    state: str
    azimuths_deg: tuple[tuple[float, float], ...]


@dataclass(frozen=True, eq=False, repr=False)
class WatermarkResult(Showable):
    """Result of a verifier, in the words that all detectors share.

    Attributes
    ----------
    verdict : 'authentic', 'tampered' or 'undecidable'
    reason : str
        The verdict's reason in words.
    content : 'intact', 'tampered' or 'unverifiable'
    order : 'in order', 'gap', 'replay' or 'unknown'
    gap : int
        Frames that are missing before this one.
    freshness : 'fresh', 'stale' or 'unknown'
    tiles : tuple of Tile
        Empty where the record could not be used.
    regions : tuple of Region
        Tiles that do not hold, with boxes around the points that are there now.
    suspected : (K,) int64
        Rows of points of which only carrier bits were changed. Keep them from whoever may have
        changed the scan.
    number : int or None
        Number of the frame in its session; None: the record could not be used.
    session : str
        Hexadecimal; empty where the record could not be used.
    embedding : str
    time_ns : int or None
        Time of the frame that the record states, nanoseconds since 1970.
    is_end : bool
        The session ends with this frame.
    scan : LidarFrame or None
        What was verified.
    units_per_m : int
        Steps a metre of the grid whose points carry the bits; 0: none does.
    key_id : str
        Identifier of the key that made the record; empty where the record could not be used.
    """

    verdict: WatermarkVerdict
    reason: str
    content: str
    order: str
    gap: int
    freshness: str
    tiles: tuple[Tile, ...] = ()
    regions: tuple[Region, ...] = ()
    suspected: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    number: int | None = None
    session: str = ""
    embedding: str = ""
    time_ns: int | None = None
    is_end: bool = False
    scan: LidarFrame | None = None
    units_per_m: int = 0
    key_id: str = ""

    name = "watermark"
    title = "Keyed watermark"

    @property
    def score(self) -> float | None:
        """Share of the tiles that do not hold; None: nothing could be compared."""
        if not self.tiles:
            return None
        return sum(tile.state != "intact" for tile in self.tiles) / len(self.tiles)

    @property
    def p_value(self) -> float | None:
        """None: any mismatch counts."""
        return None

    @property
    def power(self) -> Mapping[str, Power]:
        """Empty: what a key protects is not measured on samples."""
        return ReadOnlyMapping({})

    @property
    def calibration(self) -> Calibration | None:
        """None: there are no thresholds."""
        return None

    @property
    def changed_tiles(self) -> tuple[int, ...]:
        """Numbers of the tiles that do not hold."""
        return tuple(n for n, tile in enumerate(self.tiles) if tile.state != "intact")

    def record(self, *, operator: bool = False) -> dict[str, Any]:
        """Return the result as JSON values.

        Parameters
        ----------
        operator : bool
            With the rows of the suspected points: for the owner's eyes.
        """
        values: dict[str, Any] = {
            "verdict": self.verdict,
            "reason": self.reason,
            "content": self.content,
            "order": self.order,
            "gap": self.gap,
            "freshness": self.freshness,
            "frame": self.number,
            "session": self.session,
            "key_id": self.key_id,
            "embedding": self.embedding,
            "is_end": self.is_end,
            "tiles": len(self.tiles),
            "changed_tiles": [
                {
                    "tile": number,
                    "state": self.tiles[number].state,
                    "azimuths_deg": [list(pair) for pair in self.tiles[number].azimuths_deg],
                }
                for number in self.changed_tiles
            ],
        }
        if operator:
            values["suspected_rows"] = self.suspected.tolist()
        return values

    def __repr__(self) -> str:
        return f"<manip3d.authenticate.WatermarkResult: {self.verdict}; {self.reason}>"


@checked
class Watermarker(Closing):
    """Embeds watermarks into the frames of a stream, and verifies such frames.

    Parameters
    ----------
    key : KeyFile or KeyRing
        The newest key of a ring embeds, and each one verifies what was signed in its time.
    sensor : str
        Name of the sensor, at most 16 bytes of UTF-8; the records are bound to it.
    embedding : 'lbm', 'qim' or 'detached'
        ``lbm``: lowest bits of x, y and z, which moves points by up to sqrt(3) mm; also of
        coordinates that need float64 (LAS, a national grid). ``qim``: z in cells of 2.5 mm, up to
        1.875 mm. Both need coordinates on a grid, of 1 mm as KITTI's raw scans have them if no
        other one is stated. ``detached``: nothing is changed, for any scanner's points.
    slices : int
        Sectors of the full turn, 4 to 360.
    least_points : int
        Sectors with fewer points are joined with a neighbour.
    round_points : bool
        Move points that are not on the grid onto it: up to sqrt(3)/2 of its step more.
    units_per_m : int
        Steps of the grid a metre, which the record states: 100 for a file in whole centimetres.
        ``lbm`` moves points by up to sqrt(3) steps then. Others than 1000 for ``lbm`` only.
    origin : (float, float, float) or None, metres
        For coordinates that need float64 (`LidarFrame.exact`): where the sectors meet, and where
        the grid's steps are counted from, which the record states, too. Rounded to the nearest
        step; None: the middle of each scan.
    state : path, optional
        File that keeps what the verifier has seen, so that replays are noticed after a restart; it
        is authenticated with the key. Each frame is in it before `verify` returns, so that a
        killed process forgets none; a loss of power may take the last 600. One verifier at a time
        uses it, until `close`: a lock beside it (``.NAME.lock``) keeps others out.

    Raises
    ------
    InputError
        An argument is out of range; another verifier is using the state file.
    FormatError
        The state file is damaged, or of another key.
    OSError
        It cannot be read or written.

    Notes
    -----
    The watermark protects scans from here to the verifier, not the laser before it: what an
    attacker makes the sensor see is signed as genuine, and only the forensics of `inspect` can
    notice it. The first frame embedded begins a session; frames are chained, so that dropped,
    repeated and reordered ones are noticed. `embed` and `verify` have separate states. Other
    columns than coordinates and intensity are not bound.

    Points whose order was changed, or which were written as float32 and read again, verify, and so
    do decimals that say no more than the float32 does, as in text.
    Coordinates in float64 are bound as points of the grid: one within 2^-13 steps of such a point
    stands for it, since formats with a scale and an offset, such as LAS, do not give the nearest
    float64 back.

    Examples
    --------
    >>> import tempfile, numpy as np, manip3d
    >>> from manip3d.authenticate import KeyFile, Watermarker
    >>> scan = manip3d.LidarFrame(np.arange(9000, dtype=np.float32).reshape(3000, 3) / 8)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     key = KeyFile.create(folder + "/sensor.key")
    ...     marker = Watermarker(key)
    ...     sent = marker.embed(scan)
    ...     print(marker.verify(sent.frame, sent.record).verdict)
    authentic
    """

    def __init__(
        self,
        key: KeyFile | KeyRing,
        *,
        sensor: str = "",
        embedding: str = "lbm",
        slices: int = 36,
        least_points: int = 1000,
        round_points: bool = False,
        units_per_m: int = 1000,
        origin: ArrayLike | None = None,
        state: str | os.PathLike[str] | None = None,
    ) -> None:
        if not 1 <= least_points < 2**31:
            raise InputError(f"least_points: expected 1 to 2147483647, got {least_points}")
        if not 4 <= slices <= 360:
            raise InputError(f"slices: expected 4 to 360, got {slices}")
        self._embedding = _embedding_number(embedding)
        self._sensor = _sensor_bytes(sensor)
        _check_units(units_per_m)
        if embedding == "qim" and units_per_m != 1000:
            raise InputError(f"units_per_m: expected 1000 with embedding 'qim', got {units_per_m}")
        self._options = (slices, least_points, round_points, units_per_m)
        self._origin = None if origin is None else vector(origin, 3, "origin")
        ring = key if isinstance(key, KeyRing) else KeyRing([key])
        self._key = ring.newest
        self._embedder: _core.WatermarkEmbedder | None = None
        self._verifier = _verifier_of(ring)
        self._turn = threading.Lock()
        self._is_closed = False
        self._kept = None if state is None else VerifiedFrames(path_of(state), self._verifier)

    @property
    def embedding(self) -> str:
        """Name of the embedding: ``lbm``, ``qim`` or ``detached``."""
        return EMBEDDINGS[self._embedding]

    @property
    def session(self) -> str:
        """Hexadecimal identifier of the session of `embed`, drawn at its first frame."""
        return "" if self._embedder is None else self._embedder.session.hex()

    def embed(
        self,
        scan: ScanLike,
        *,
        time_ns: int | None = None,
        is_end: bool = False,
        picture: ArrayLike | None = None,
    ) -> Watermarked:
        """Embed the watermark of the next frame.

        Parameters
        ----------
        scan : LidarFrame, (N, 3) or (N, 4) float32
            Metres; (N, 4) with intensity.
        time_ns : int, optional
            Nanoseconds since 1970; by default the frame's, else the clock's.
        is_end : bool
            The session ends with this frame.
        picture : (H, W) or (H, W, 3) uint8, optional
            Picture of the same moment, as the camera gave it. It will carry the record in the
            lowest bits of its first 16384 samples, and the record binds the others.

        Returns
        -------
        Watermarked

        Raises
        ------
        InputError
            Points are not on the grid; coordinates that need float64 with
            ``qim``, or whose points in float32 are others; the key has expired; a picture that
            cannot carry the record, or one beside a detached scan in float64.
        Error
            The watermarker is closed, or its session has ended.
        """
        given = to_scan(scan)
        frame = as_frame(scan)
        carries = frame.exact is not None and self.embedding != "detached"
        if carries:
            _check_exact(frame, self.embedding)
        exact_hash = None if carries else _exact_hash(frame)
        carrier = None if picture is None else checked_picture(picture)
        if carrier is not None and exact_hash is not None:
            raise InputError(
                "picture: expected a scan without float64 coordinates, or embedding 'lbm': a "
                "detached record binds these where it would bind the picture"
            )
        clock = time.time_ns()
        if self._key.expires_ns and clock >= self._key.expires_ns:
            raise InputError("key: it has expired, and embeds no more")
        if time_ns is None:
            time_ns = clock if frame.time_ns is None else frame.time_ns
        points, record, number, tiles, exact, samples = self._begun().embed(
            given.points,
            given.intensity,
            time_ns,
            frame.num_dropped,
            is_end,
            exact_hash,
            frame.exact if carries else None,
            self._offset(frame) if carries else (0, 0, 0),
            carrier,
        )
        if len(exact):
            marked = frame.replace(points=_in_float32(frame, exact), exact=exact)
        else:
            marked = frame if not len(points) else frame.replace(points=points)
        is_detached = not len(points) and not len(exact)
        carried = None if carrier is None else samples.reshape(carrier.shape)
        return Watermarked(marked, record, number, tiles, is_detached, carried)

    def resume(self, record: bytes) -> None:
        """Go on with a session whose embedding was stopped, after the frame of a record.

        Parameters
        ----------
        record : bytes
            Record of the last frame that is kept, as `embed` gave it; the next frame has the next
            number. Frames after it that were lost are embedded again.

        Raises
        ------
        InputError
            Embedding has begun already; the record's session has ended, or has another embedding
            or grid.
        FormatError
            The record is damaged, or of another key or sensor.
        Error
            The watermarker is closed.

        Notes
        -----
        A lost frame that was signed anew exists twice with one number if the first version turns up
        after all. Both are genuine, and each verifies alone. In a chain the first one is followed
        by a frame whose place is not known, so that the chain is undecidable. Where others may have
        received frames after the last one that is kept, begin a new session instead.

        Examples
        --------
        >>> import numpy as np
        >>> from manip3d.authenticate import KeyFile, Watermarker
        >>> scan = np.arange(9000, dtype=np.float32).reshape(3000, 3) / 8
        >>> key = KeyFile.create("sensor.key")
        >>> record = Watermarker(key).embed(scan).record
        >>> marker = Watermarker(key)
        >>> marker.resume(record)
        >>> marker.embed(scan).number
        1
        """
        with self._turn:
            if self._embedder is not None:
                raise InputError("record: expected before the first frame is embedded")
            self._embedder = self._new_embedder(record)

    def _begun(self) -> _core.WatermarkEmbedder:
        """The embedder, whose making draws the session: one, however many threads ask for it."""
        with self._turn:
            if self._embedder is None or self._is_closed:
                self._embedder = self._new_embedder(None)
            return self._embedder

    def _new_embedder(self, last: bytes | None) -> _core.WatermarkEmbedder:
        """An embedder of a new session, or of that of a last record."""
        if self._is_closed:
            raise Error("the watermarker is closed")
        slices, least, rounding, units = self._options
        return _core.WatermarkEmbedder(
            self._key._key,
            self._sensor,
            None,
            self._embedding,
            slices,
            least,
            False,
            rounding,
            units,
            after=last,
        )

    def _offset(self, frame: LidarFrame) -> tuple[int, int, int]:
        """The origin in steps of the grid."""
        if self._origin is not None:
            place = self._origin
        elif frame.exact is None or not len(frame.exact):
            place = np.zeros(3)
        else:
            place = np.round((frame.exact.min(axis=0) + frame.exact.max(axis=0)) / 2.0)
        steps = place * self._options[3]
        if not (np.abs(steps) < _FARTHEST_STEP).all():
            raise InputError(f"origin: expected at most 2^37 steps of the grid, got {place}")
        x, y, z = (round(step) for step in steps.tolist())
        return x, y, z

    def own_verifier(self) -> Watermarker:
        """Return another watermarker of the embedding key, which has verified nothing so far.

        Returns
        -------
        Watermarker
            Verifies what this one embeds, and leaves the frames that this one has verified alone.
        """
        return Watermarker(self._key)

    def verify(
        self,
        scan: ScanLike,
        record: bytes | None,
        *,
        policy: Policy | None = None,
        now_ns: int | None = None,
        picture: ArrayLike | None = None,
    ) -> WatermarkResult:
        """Verify the next frame of a stream.

        Parameters
        ----------
        scan : LidarFrame, (N, 3) or (N, 4) float32
            In any order.
        record : bytes or None
            As `embed` gave it; None: the picture carries it, or there is none, and the verdict is
            ``undecidable``.
        policy : Policy, optional
        now_ns : int, optional
            Nanoseconds since 1970; by default the clock's.
        picture : (H, W) or (H, W, 3) uint8, optional
            Picture that carries the record, and is verified with it.

        Returns
        -------
        WatermarkResult

        Raises
        ------
        InputError
            Coordinates that are not finite; a record beside a picture, or a picture too small for
            one.
        Error
            The watermarker is closed.
        OSError
            The state file cannot be written.
        """
        given = to_scan(scan)
        frame = as_frame(scan)
        chosen = Policy() if policy is None else policy
        carrier = None if picture is None else checked_picture(picture)
        if carrier is not None:
            if record is not None:
                raise InputError("record: cannot be given with a picture, which carries its own")
            try:
                record = _core.watermark_in_picture(carrier)
            except FormatError as error:
                return _unverifiable(f"the picture has no record: {error.reason}", frame)
        with self._turn:
            found = self._verifier.verify(
                given.points,
                given.intensity,
                record or b"",
                chosen._core(),
                frame.num_dropped,
                time.time_ns() if now_ns is None else now_ns,
                frame.exact,
                carrier,
            )
            if self._kept is not None:
                self._kept.add()
        return _with_exact(_result(found, frame), found["header"], frame)

    def verify_without_scan(
        self,
        record: bytes | None,
        reason: str,
        *,
        policy: Policy | None = None,
        picture: ArrayLike | None = None,
    ) -> WatermarkResult:
        """Take the record of a frame whose scan is missing or cannot be read.

        The frame is ``undecidable`` (``tampered``, if it was seen before), but keeps its place in
        the chain, so that those after it are judged as if it were there.

        Parameters
        ----------
        record, policy, picture
            As for `verify`.
        reason : str
            Why there is no scan.

        Raises
        ------
        InputError, Error
            As `verify`.
        """
        empty = LidarFrame(np.empty((0, 3), np.float32))
        found = self.verify(empty, record, policy=policy, picture=picture)
        verdict: WatermarkVerdict = "tampered" if found.order == "replay" else "undecidable"
        if found.order == "replay":
            reason = f"{reason}, and the frame was seen before, or comes after a later one"
        return replace(
            found, verdict=verdict, reason=reason, content="unverifiable", tiles=(), regions=()
        )

    def reset(self) -> None:
        """Forget the frames that were verified, also in the state file."""
        with self._turn:
            self._verifier.reset()
            if self._kept is not None:
                self._kept.fold()

    def close(self) -> None:
        """Let others use the state file, and wipe what was derived from the key."""
        with self._turn:
            self._is_closed = True
            try:
                if self._kept is not None:
                    self._kept.close()
            finally:
                if self._embedder is not None:
                    self._embedder.close()
                self._verifier.close()

    def __repr__(self) -> str:
        session = f", session {self.session[:8]}" if self.session else ""
        return (
            f"<manip3d.authenticate.Watermarker: {self.embedding}, key "
            f"{self._key.key_id[:8]}{session}>"
        )


_MOST_UNITS = 1_000_000  # a metre
_SAME_M = 1e-10  # metres: rounding where a decimal is made of a number of steps and an offset
_FARTHEST_STEP = 2.0**37


def _check_units(units_per_m: int) -> None:
    if not 1 <= units_per_m <= _MOST_UNITS:
        raise InputError(f"units_per_m: expected 1 to {_MOST_UNITS}, got {units_per_m}")


def _in_float32(frame: LidarFrame, exact: NDArray[np.float64]) -> NDArray[np.float32]:
    """The points of coordinates in float64, as the frame's format has them."""
    return measured_points(exact, frame.format or ScanFormat(""), frame.source)


def _check_exact(frame: LidarFrame, embedding: str) -> None:
    """Refuse a scan with float64 coordinates that the embedding would move and cannot."""
    if embedding != "lbm":
        raise InputError(
            "scan: its coordinates need float64, whose z has no cells; expected embedding "
            "'lbm' or 'detached', or a scan without `exact`"
        )
    if not _is_of_one_piece(frame):
        raise InputError("scan: expected points that are its exact coordinates in float32")


def _is_of_one_piece(frame: LidarFrame) -> bool:
    """Whether the points are the exact coordinates in float32, so that either says the same."""
    if frame.exact is None:
        return True
    return np.array_equal(_in_float32(frame, frame.exact), frame.points)


def _embedding_number(name: str) -> int:
    if name not in EMBEDDINGS:
        raise InputError(f"embedding: expected one of {', '.join(EMBEDDINGS)}, got {name!r}")
    return EMBEDDINGS.index(name)


def _sensor_bytes(name: str) -> bytes:
    encoded = name.encode()
    if len(encoded) > 16:
        raise InputError(f"sensor: expected at most 16 bytes of UTF-8, got {len(encoded)}")
    return encoded.ljust(16, b"\0")


def _session_bytes(text: str) -> bytes:
    try:
        session = bytes.fromhex(text)
    except ValueError:
        session = b""
    if len(session) != 16:
        raise InputError(f"sessions: expected 32 hexadecimal digits each, got {text!r}")
    return session


def _unverifiable(reason: str, frame: LidarFrame) -> WatermarkResult:
    return WatermarkResult(
        "undecidable", reason, "unverifiable", "unknown", 0, "unknown", scan=frame
    )


def _azimuths(slices: Iterable[int], num_slices: int) -> tuple[tuple[float, float], ...]:
    """Beginnings and ends of runs of slices, degrees."""
    width = 360.0 / num_slices
    runs: list[list[int]] = []
    for each in slices:
        if runs and runs[-1][1] == each:
            runs[-1][1] = each + 1
        else:
            runs.append([each, each + 1])
    return tuple((begin * width, end * width) for begin, end in runs)


def _box_around(points: NDArray[np.float32]) -> Box:
    if not len(points):
        return Box((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    low, high = points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)
    center, size = ((low + high) / 2).tolist(), (high - low).tolist()
    return Box((center[0], center[1], center[2]), (size[0], size[1], size[2]))


def _result(found: Mapping[str, Any], frame: LidarFrame) -> WatermarkResult:
    header = found["header"]
    common: dict[str, Any] = {
        "verdict": _VERDICTS[found["verdict"]],
        "reason": found["reason"],
        "content": _CONTENT[found["content"]],
        "order": _ORDER[found["order"]],
        "gap": found["gap"],
        "freshness": _FRESHNESS[found["freshness"]],
        "scan": frame,
    }
    if header is None:
        return WatermarkResult(**common)
    tile_of_slice = header["tile_of_slice"]
    tiles = tuple(
        Tile(
            _TILES[state],
            _azimuths(
                (s for s, tile in enumerate(tile_of_slice) if tile == number), len(tile_of_slice)
            ),
        )
        for number, state in enumerate(found["tiles"])
    )
    rows = found["rows"].astype(np.int64)
    tile_of_row = found["tile_of_row"]
    regions = []
    for number, tile in enumerate(tiles):
        if tile.state == "intact":
            continue
        box = _box_around(frame.points[tile_of_row == number])
        mine = rows[tile_of_row[rows] == number]
        regions.append(Region(box, mine))
    return WatermarkResult(
        **common,
        tiles=tiles,
        regions=tuple(regions),
        suspected=rows,
        number=header["frame"],
        session=header["session"].hex(),
        embedding=EMBEDDINGS[header["embedding"]],
        time_ns=header["time_ns"],
        is_end=header["is_end"],
        units_per_m=header["units_per_m"],
        key_id=found["key"].hex(),
    )


def _exact_hash(frame: LidarFrame) -> bytes | None:
    """Hash of coordinates that need float64, with the intensities, in any order of the points.

    It is bound as what was recorded beside the points: rows of the exact x, y, z, of those in
    float32, and of the intensity, 0 without, as the bits of little-endian float64, in ascending
    order of these.
    """
    if frame.exact is None:
        return None
    shine = np.zeros(len(frame.exact)) if frame.intensity is None else frame.intensity
    columns = [frame.exact, frame.points.astype(np.float64), shine[:, None].astype(np.float64)]
    bits = np.ascontiguousarray(np.hstack(columns), "<f8").view("<u8")
    rows = np.ascontiguousarray(bits[np.lexsort(bits.T[::-1])])
    digest = hashlib.blake2b(b"m3d-float64", digest_size=32)
    digest.update(rows.data)
    return digest.digest()


def _are_decimals_of_float32(frame: LidarFrame) -> bool:
    """Whether coordinates in float64 only write those in float32 in decimals, as text and LAS do.

    The float32 that is nearest to 12.345 is 12.34500026...; the file says 12.345, or 12.3450003.
    Digits that say more than the float32 does were never signed.
    """
    if frame.exact is None or not _is_of_one_piece(frame):
        return False
    points = frame.points.astype(np.float64)
    is_open = np.ones(points.shape, bool)  # the coordinates that no number of digits gave so far
    for digits in range(13):  # 9 that count, of coordinates from tenths of a millimetre on
        is_open &= np.abs(np.round(points, digits) - frame.exact) > _SAME_M
    return not is_open.any()


def _with_exact(
    result: WatermarkResult, header: Mapping[str, Any] | None, frame: LidarFrame
) -> WatermarkResult:
    """The result with what the record says of coordinates in float64."""
    if header is None or result.content != "intact":
        return result
    if header["is_exact"]:
        if _is_of_one_piece(frame):
            return result
        reason = "the points in float32 are not those of the coordinates that were signed"
        return replace(result, verdict="tampered", content="tampered", reason=reason)
    exact = _exact_hash(frame)
    has_exact = header["has_context"] and header["carrier"] == CARRIERS.index("sidecar")
    if exact is None and not has_exact:
        return result
    if exact is None:
        reason = "coordinates were signed in float64, of which the scan has the float32 part only"
    elif not has_exact and _are_decimals_of_float32(frame):
        return result
    elif not has_exact:
        reason = "the scan's coordinates need float64, of which the float32 part only was signed"
    elif hmac.compare_digest(header["context"], exact):
        return result
    else:
        reason = "coordinates are not those that were signed, by less than float32 can tell"
        return replace(result, verdict="tampered", content="tampered", reason=reason)
    return replace(result, verdict="undecidable", content="unverifiable", reason=reason)

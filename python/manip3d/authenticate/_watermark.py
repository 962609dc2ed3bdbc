"""A keyed watermark: proof that a scan is unchanged since the watermark was embedded."""

from __future__ import annotations

import functools
import hashlib
import hmac
import math
import os
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from manip3d import _core
from manip3d._util.arrays import MAX_ROUNDED_M, as_array, rounded_by, rows, vector
from manip3d._util.checked import checked
from manip3d._util.closing import Closing
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.paths import path_of
from manip3d._util.showing import Showable
from manip3d._util.texts import counted
from manip3d.authenticate._keys import KeyFile, KeyRing
from manip3d.authenticate._picture_records import checked_picture
from manip3d.authenticate._verdict import Calibration, Power, Region, verdict_repr
from manip3d.authenticate._verified_frames import VerifiedFrames
from manip3d.errors import Error, FormatError, InputError
from manip3d.io._scan_tables import measured_points
from manip3d.lidar import Box, LidarFrame, ScanFormat, ScanLike, as_frame, to_scan

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

Embedding: TypeAlias = Literal["detached", "lbm", "qim"]
WatermarkVerdict: TypeAlias = Literal["authentic", "tampered", "undecidable"]
"""``authentic``: the content is unchanged, and order and freshness fulfil the policy.
``tampered``: points, columns or carrier bits differ from the embedded ones, or the frame is a
replay. ``undecidable``: neither can be proved; the reason states why (no record, another key, a gap
in the stream ...)."""

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
"""Largest move of a point by each embedding, metres. ``qim``: for points more than 3 mm from the
origin. ``lbm``: for a grid of 1 mm; for other grids it is proportional to the step."""


def _verifier_of(ring: KeyRing) -> _core.WatermarkVerifier:
    verifier = _core.WatermarkVerifier(ring.newest._key)
    for newer, older in pairwise(ring.keys):
        verifier.add_older_key(older._key, newer.created_ns)
    return verifier


@checked
@dataclass(frozen=True)
class Policy:
    """Conditions under which a verifier accepts a record, whatever the record states itself.

    Attributes
    ----------
    embeddings : sequence of str
        Accepted embeddings, of ``detached``, ``lbm`` and ``qim``.
    order : 'chain' or 'any'
        ``chain``: a frame must follow the previous frame, or begin its session. ``any``: a frame
        whose place in the session is unknown is accepted, too, such as a single frame. Gaps and
        replays are never accepted.
    sensors : sequence of str
        Accepted names of sensors; empty: any.
    sessions : sequence of str
        Accepted hexadecimal identifiers of sessions; empty: any.
    max_age_s : float or None
        Largest difference, seconds, between a record's time and the verifier's clock; None: any, as
        for recordings.
    max_points : int
        Scans with more points are not verified.
    units_per_m : sequence of int
        Accepted grids of points that carry bits, in steps per metre; empty: any.
    carriers : sequence of str
        Accepted carriers of the record, of ``sidecar`` (a file beside the scan) and ``picture``.
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
            0 if self.max_age_s is None else math.ceil(self.max_age_s * 1e9),
            None,
            list(self.units_per_m),
        )


@dataclass(frozen=True, eq=False, repr=False)
class Watermarked(Showable):
    """A scan with its watermark.

    Attributes
    ----------
    frame : LidarFrame
        The given scan with points (and ``exact`` coordinates) that carry the bits.
    record : bytes
        The record that `Watermarker.verify` needs beside the scan, about 1 kB.
    number : int
        Number of the frame in its session.
    num_tiles : int
        Number of sectors that are verified separately.
    is_detached : bool
        Whether the points are unchanged.
    picture : (H, W) or (H, W, 3) uint8, or None
        The given picture with the record in its lowest bits. It replaces the record as a file
        beside the scan.
    """

    frame: LidarFrame
    record: bytes
    number: int
    num_tiles: int
    is_detached: bool = False
    picture: NDArray[np.uint8] | None = field(default=None, repr=False)

    @property
    def points(self) -> NDArray[np.float32]:
        """Points of `frame`, (N, 3) float32, metres."""
        return self.frame.points

    def __repr__(self) -> str:
        return (
            f"<manip3d.authenticate.Watermarked: frame {self.number}, "
            f"{counted(self.frame.num_points, 'point')}, {counted(self.num_tiles, 'tile')}, "
            f"record of {counted(len(self.record), 'byte')}>"
        )


@dataclass(frozen=True)
class Tile:
    """A sector of the scan that is verified separately.

    Attributes
    ----------
    state : 'intact', 'bits' or 'changed'
        ``bits``: the content is unchanged, but carrier bits differ. ``changed``: the points differ
        from the embedded ones; which points is not stated, because that would help a forger.
    azimuths_deg : tuple of (float, float), degrees
        Begin and end of the sector's runs of slices, counter-clockwise from x.
    """

    state: str
    azimuths_deg: tuple[tuple[float, float], ...]


@dataclass(frozen=True, eq=False, repr=False)
class WatermarkResult(Showable):
    """Result of a verifier, with the attributes that all detectors share (`Detection`).

    Attributes
    ----------
    verdict : 'authentic', 'tampered' or 'undecidable'
        `WatermarkVerdict` states what they mean.
    reason : str
        Reason of the verdict in words.
    content : 'intact', 'tampered' or 'unverifiable'
        Verdict on the points and columns alone.
    order : 'in order', 'gap', 'replay' or 'unknown'
        Verdict on the frame's place in its session.
    gap : int
        Number of frames that are missing before this one.
    freshness : 'fresh', 'stale' or 'unknown'
        Whether the age of the record fulfils the policy.
    tiles : tuple of Tile
        Sectors of the scan; empty if the record could not be used.
    regions : tuple of Region
        Tiles that are not intact, with boxes around the points that are in them now.
    suspected : (K,) int64
        Rows of points whose carrier bits alone were changed. Do not show them to anyone who may
        have changed the scan.
    number : int or None
        Number of the frame in its session; None if the record could not be used.
    session : str
        Hexadecimal identifier of the session; empty if the record could not be used.
    embedding : str
        Embedding that the record states.
    time_ns : int or None
        Time of the frame that the record states, nanoseconds since 1970.
    is_end : bool
        Whether the session ends with this frame.
    scan : LidarFrame or None
        The scan that was verified.
    units_per_m : int
        Grid steps per metre of the points that carry bits; 0: no point carries bits.
    key_id : str
        Identifier of the key that made the record; empty if the record could not be used.
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
        """Share of the tiles that are not intact; None if the record could not be used."""
        if not self.tiles:
            return None
        return sum(tile.state != "intact" for tile in self.tiles) / len(self.tiles)

    @property
    def p_value(self) -> float | None:
        """None, because any mismatch is proof."""
        return None

    @property
    def power(self) -> Mapping[str, Power]:
        """Empty, because cryptography, not a sample of edits, states what is found."""
        return ReadOnlyMapping({})

    @property
    def calibration(self) -> Calibration | None:
        """None, because there are no thresholds."""
        return None

    @property
    def changed_tiles(self) -> tuple[int, ...]:
        """Numbers of the tiles that are not intact."""
        return tuple(n for n, tile in enumerate(self.tiles) if tile.state != "intact")

    def record(self, *, operator: bool = False) -> dict[str, Any]:
        """Return the result as JSON values.

        Parameters
        ----------
        operator : bool
            Include the rows of the suspected points, which only the owner may see.
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

    __repr__ = verdict_repr


@checked
class Watermarker(Closing):
    """Embeds watermarks into the frames of a stream, and verifies such frames.

    Parameters
    ----------
    key : KeyFile or KeyRing
        The newest key of a ring embeds; each key verifies what was signed in its time.
    sensor : str
        Name of the sensor, at most 16 bytes of UTF-8; the records are bound to it.
    embedding : 'lbm', 'qim' or 'detached'
        ``lbm`` stores bits in the lowest bits of x, y and z, which moves points by up to sqrt(3)
        mm; it also works for coordinates that need float64 (LAS, a national grid). ``qim``
        (quantisation index modulation) stores bits in cells of z of 2.5 mm, which moves points by
        up to 1.875 mm. Both need coordinates on a grid: of 1 mm, as in KITTI's raw scans, or as
        ``units_per_m`` states. ``detached`` changes no point, and takes the points of any scanner.
        In all of them -0 is the same number as 0.
    slices : int
        Number of equal azimuth slices of the full turn, 4 to 360. Each is a sector (`Tile`), or
        part of one.
    least_points : int
        Slices with fewer points are joined with a neighbour.
    round_points : bool
        Move points that are not on the grid onto it, which adds up to sqrt(3)/2 steps to the move.
    units_per_m : int
        Grid steps per metre, which the record states: 100 for a file in whole centimetres. ``lbm``
        moves points by up to sqrt(3) steps. Only ``lbm`` takes another number than 1000.
    origin : (float, float, float) or None, metres
        For coordinates that need float64 (`LidarFrame.exact`): the point at which the sectors meet
        and from which the grid's steps are counted, rounded to the nearest step. The record states
        it. None: the middle of each scan, rounded to whole metres.
    state : path, optional
        File in which the verifier keeps the frames that it has seen, so that it notices replays
        after a restart. It is authenticated with the key. Each frame is written before `verify`
        returns, so that a killed process loses none; a loss of power may lose the last 600. Only
        one verifier at a time can use it, until `close`: it holds the lock ``.NAME.lock``.

    Raises
    ------
    InputError
        An argument is out of range; another verifier is using the state file.
    FormatError
        The state file is damaged, or of another key.
    OSError
        The state file cannot be read or written.

    Notes
    -----
    The watermark protects scans between the embedder and the verifier, not the measurement: laser
    pulses that an attacker injects into the sensor are signed as genuine, and only the forensics of
    `inspect` can notice them. The first embedded frame begins a session. Frames are chained, so
    that dropped, repeated and reordered ones are noticed. If a frame of another session comes
    before the session has ended, it is ``undecidable``, and so is the first frame with which the
    session that was left continues. `embed` and `verify` have separate states. Columns other than
    coordinates and intensity are not protected, nor are the grid and the viewpoint of a PCD file.

    A scan still verifies after its points were reordered, after it was written as float32 and read
    again, and after it was written with as many decimals as float32 has, as in text. Coordinates in
    float64 are bound as points of the grid. A coordinate within 2^-13 steps of a grid point counts
    as that point, because formats with a scale and an offset, such as LAS, do not restore the exact
    float64.

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
    def units_per_m(self) -> int:
        """Grid steps per metre of `embed`."""
        return self._options[3]

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
            Points in metres; (N, 4) with intensity. Arrays are rounded to float32.
        time_ns : int, optional
            Time in nanoseconds since 1970; default: that of the frame, or of the clock if the frame
            has none.
        is_end : bool
            End the session with this frame.
        picture : (H, W) or (H, W, 3) uint8, optional
            Camera picture of the same moment, unchanged. A copy carries the record in the lowest
            bits of its first 16384 samples; the record protects all other bits.

        Returns
        -------
        Watermarked

        Raises
        ------
        InputError
            Points are not on the grid; coordinates need float64 with ``qim``, or differ from the
            points in float32; the key has expired; the picture cannot carry the record, or is given
            with a detached scan in float64.
        Error
            The watermarker is closed, or its session has ended.
        """
        frame = _frame_of(scan)
        given = to_scan(frame)
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
            raise InputError("key: the key has expired, and cannot embed any more")
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
        """Continue an interrupted session after the frame of a record.

        Parameters
        ----------
        record : bytes
            Record that `embed` returned for the last frame that was kept. The next frame gets the
            next number: frames that were lost are embedded again.

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
        If a frame that was lost and embedded again turns up after all, two frames have the same
        number. Both are genuine, and each verifies alone. As a chain, the older one is followed by
        a frame whose place is unknown, so that the drive is undecidable. Begin a new session if
        others may have received frames after the last one that was kept.

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
        """Return the embedder; the first call draws the session, for all threads."""
        with self._turn:
            if self._embedder is None or self._is_closed:
                self._embedder = self._new_embedder(None)
            return self._embedder

    def _new_embedder(self, last: bytes | None) -> _core.WatermarkEmbedder:
        """Return an embedder of a new session, or of the session of its last record."""
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
        """Return the origin in grid steps."""
        if self._origin is not None:
            place = self._origin
        elif frame.exact is None or not len(frame.exact):
            place = np.zeros(3)
        else:
            place = np.round((frame.exact.min(axis=0) + frame.exact.max(axis=0)) / 2.0)
        steps = place * self.units_per_m
        if not (np.abs(steps) < _FARTHEST_STEP).all():
            where = ", ".join(f"{metres:.0f}" for metres in place.tolist())
            whose = "points: expected coordinates" if self._origin is None else "origin: expected"
            raise InputError(f"{whose} within 2^37 steps of the grid, got ({where}) m")
        x, y, z = (round(step) for step in steps.tolist())
        return x, y, z

    def own_verifier(self) -> Watermarker:
        """Return another watermarker of the embedding key with a verifier state of its own.

        Returns
        -------
        Watermarker
            Verifies the frames that this one embeds, without effect on this one's verifier.
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
            Points in metres, in any order; (N, 4) with intensity.
        record : bytes or None
            Record that `embed` returned. None: the picture carries it; without a picture the
            verdict is ``undecidable``.
        policy : Policy, optional
            Rules of acceptance; default: ``Policy()``.
        now_ns : int, optional
            Time in nanoseconds since 1970; default: that of the clock.
        picture : (H, W) or (H, W, 3) uint8, optional
            Picture that carries the record; it is verified as well.

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
            The state file cannot be written; the frame does not count, and may be verified again.
        """
        frame = _frame_of(scan)
        given = to_scan(frame)
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
            before = b"" if self._kept is None else self._verifier.state()
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
                self._kept.add(before)
        return _with_exact(_result(found, frame), found["header"], frame)

    def verify_without_scan(
        self,
        record: bytes | None,
        reason: str,
        *,
        policy: Policy | None = None,
        picture: ArrayLike | None = None,
    ) -> WatermarkResult:
        """Verify the record of a frame whose scan is missing or cannot be read.

        The frame is ``undecidable`` (``tampered`` if it is a replay), but keeps its place in the
        chain, so that the frames after it are judged as if the scan were there.

        Parameters
        ----------
        record, policy, picture
            Same as for `verify`.
        reason : str
            Reason why there is no scan.

        Raises
        ------
        InputError, Error
            As `verify`.
        """
        empty = LidarFrame(np.empty((0, 3), np.float32))
        return without_scan(self.verify(empty, record, policy=policy, picture=picture), reason)

    def reset(self) -> None:
        """Forget the verified frames, in memory and in the state file."""
        with self._turn:
            self._verifier.reset()
            if self._kept is not None:
                self._kept.fold()

    def close(self) -> None:
        """Unlock the state file, and wipe key material from memory."""
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


def without_scan(found: WatermarkResult, reason: str) -> WatermarkResult:
    """Return the result of verifying a scan without points as that of a missing scan."""
    verdict: WatermarkVerdict = "tampered" if found.order == "replay" else "undecidable"
    if found.order == "replay":
        reason = f"{reason}, and the frame was seen before, or comes after a later one"
    return replace(
        found, verdict=verdict, reason=reason, content="unverifiable", tiles=(), regions=()
    )


def of_file(found: WatermarkResult) -> WatermarkResult:
    """Return the result of a scan's file; a file without points counts as a missing scan.

    Somebody who empties a file gains no more by it than by deleting the file.
    """
    if found.content != "tampered" or found.scan is None or found.scan.num_points:
        return found
    if not found.changed_tiles:  # no points were signed, but something else was changed
        return found
    return without_scan(found, "the scan holds no points, and points were signed")


_MAX_UNITS = 1_000_000  # grid steps per metre
_SAME_M = 1e-10  # metres: rounding of decimals that are computed as steps times scale plus offset
_FARTHEST_STEP = 2.0**37  # of the origin; float64 still resolves 2^-13 steps beyond it


def _check_units(units_per_m: int) -> None:
    if not 1 <= units_per_m <= _MAX_UNITS:
        raise InputError(f"units_per_m: expected 1 to {_MAX_UNITS}, got {units_per_m}")


def _frame_of(scan: ScanLike) -> LidarFrame:
    """Return the scan as a frame; refuse arrays of coordinates that float32 rounds by over 1 mm.

    Points that moved by less than the rounding would be authentic.
    """
    if isinstance(scan, LidarFrame):
        return scan
    array = as_array(scan, "scan")
    given = array[:, :3] if array.ndim == 2 else array
    rounded = rounded_by(given, rows(given, 3, np.float32, "scan"))
    if rounded > MAX_ROUNDED_M:
        raise InputError(
            f"scan: float32 rounds these coordinates by up to {rounded:.2g} m; subtract a place "
            "near them first, or give the frame that `manip3d.io.read_scan` makes of a file, which "
            "keeps float64"
        )
    return as_frame(array)


def _in_float32(frame: LidarFrame, exact: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the points that the frame's format has for coordinates in float64."""
    return measured_points(exact, frame.format or ScanFormat(""), frame.source)


def _check_exact(frame: LidarFrame, embedding: str) -> None:
    """Raise an InputError if the embedding cannot move the float64 coordinates of a scan."""
    if embedding != "lbm":
        raise InputError(
            "embedding: expected 'lbm' or 'detached' for coordinates that need float64 (those of "
            f"LAS, or of a map), got {embedding!r}"
        )
    if not _matches_exact(frame):
        raise InputError("scan: expected points that are its exact coordinates in float32")


def _matches_exact(frame: LidarFrame) -> bool:
    """Return whether the points are the exact coordinates in float32, or there are none."""
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
    """Return begin and end of each run of adjacent slices, degrees."""
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
    """Return the kernel's answer as a result, with a region for each tile that is not intact.

    A record without a readable header has neither tiles nor regions.
    """
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


def _exact_hash(frame: LidarFrame, *, binds_signs: bool = False) -> bytes | None:
    """Return a hash of float64 coordinates and intensities that ignores the order of points.

    -0 equals 0, unless ``binds_signs``, as in early records.

    A record stores it as the hash of recorded context. It is the hash of one row for each point:
    exact x, y, z, float32 x, y, z and intensity (0 without intensities), as little-endian float64.
    Rows are sorted by their bits.
    """
    if frame.exact is None:
        return None
    shine = np.zeros(len(frame.exact)) if frame.intensity is None else frame.intensity
    columns = [frame.exact, frame.points.astype(np.float64), shine[:, None].astype(np.float64)]
    numbers = np.hstack(columns)
    if not binds_signs:
        numbers += 0.0  # makes 0 of -0, and changes no other number
    bits = np.ascontiguousarray(numbers, "<f8").view("<u8")
    rows = np.ascontiguousarray(bits[np.lexsort(bits.T[::-1])])
    digest = hashlib.blake2b(b"m3d-float64", digest_size=32)
    digest.update(rows.data)
    return digest.digest()


def _are_decimals_of_float32(frame: LidarFrame) -> bool:
    """Return whether float64 coordinates are only decimals of float32, as text and LAS have them.

    The float32 nearest to 12.345 is 12.34500026...; a file may say 12.345, or 12.3450003. More
    digits than the float32 has were never signed.
    """
    if frame.exact is None or not _matches_exact(frame):
        return False
    points = frame.points.astype(np.float64)
    differs = np.ones(points.shape, bool)  # coordinates that equal no rounding so far
    # 12 decimals are at least the 9 significant digits of float32 from 0.1 mm on.
    for digits in range(13):
        differs &= np.abs(np.round(points, digits) - frame.exact) > _SAME_M
    return not differs.any()


def _with_exact(
    result: WatermarkResult, header: Mapping[str, Any] | None, frame: LidarFrame
) -> WatermarkResult:
    """Return the result after comparing float64 coordinates with the record."""
    if header is None or result.content != "intact":
        return result
    tampered = functools.partial(replace, result, verdict="tampered", content="tampered")
    unknown = functools.partial(replace, result, verdict="undecidable", content="unverifiable")
    if header["is_exact"]:
        if _matches_exact(frame):
            return result
        return tampered(
            reason="the points in float32 are not those of the coordinates that were signed"
        )
    if header["has_context"] and header["carrier"] == CARRIERS.index("sidecar"):
        if frame.exact is None:
            return unknown(
                reason="coordinates were signed in float64, of which the scan has the float32 part "
                "only"
            )
        for binds_signs in (False, True):
            exact = _exact_hash(frame, binds_signs=binds_signs) or b""
            if hmac.compare_digest(header["context"], exact):
                return result
        return tampered(
            reason="coordinates are not those that were signed, by less than float32 can tell"
        )
    if frame.exact is None or _are_decimals_of_float32(frame):
        return result
    return unknown(
        reason="the scan's coordinates need float64, of which the float32 part only was signed"
    )

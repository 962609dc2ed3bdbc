"""Checks that the counts and sizes in LAS and LAZ files fit the file, made before decoding.

Also a correction of LASzip's record, for files that were written.

The LAZ decoder allocates the memory that a file claims to need. A chunk table of 2^32 - 1 entries,
or a layer of 4 GiB, would abort the process without an exception.
"""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NoReturn

from manip3d._util.extras import imported
from manip3d.errors import FormatError
from manip3d.io._files import open_regular
from manip3d.io._limits import check_points
from manip3d.io._scan_tables import refuse_expansion

_HEADER = 227  # bytes of the shortest header, LAS 1.0
_VLR, _EVLR = 54, 60  # bytes of the header of an (extended) variable length record
_LASZIP = (b"laszip encoded", 22204)  # user id and record id of LASzip's own record
_VARIABLE = 0xFFFFFFFF  # chunk size of files whose chunk table also holds numbers of points
_LAYERED = 3  # LASzip's compressor for point formats 6 to 10
# Number of layers of each item type in a layered chunk; extra bytes have one layer per byte.
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
_EXTRA_BYTES = 14  # item type of extra bytes
_WAVE_PACKETS = 9  # item type of the waveforms of point formats 4 and 5
_ITEMS = 34  # bytes of LASzip's record before its items: type, size and version, 16 bits each


@dataclass(frozen=True)
class _Header:
    """Fields of the public header block that the checks need; positions and sizes in bytes."""

    size: int
    start: int
    num_vlrs: int
    is_compressed: bool
    row: int
    count: int
    evlr_start: int
    num_evlrs: int


@dataclass(frozen=True)
class _LasZip:
    """LASzip's record, which describes the compression of the points."""

    compressor: int
    chunk_size: int
    items: tuple[tuple[int, int], ...]
    """Type and size in bytes of each item of a point."""
    data: bytes
    """The record as stored, for the decoder."""


class _Failure(Exception):
    """A byte offset and a reason; `check_las` adds the file's name."""


def _fail(byte: int, reason: str) -> NoReturn:
    raise _Failure(byte, reason)


def check_las(path: Path, limit: int) -> int:
    """Refuse counts and sizes that exceed the file's size, without allocating memory for them.

    Returns
    -------
    int
        Number of chunks of compressed points; 0 if the points are not compressed.

    Raises
    ------
    FormatError
        A count or size does not fit; the error names the byte where it is stored.
    """
    size = path.stat().st_size
    try:
        with open_regular(path) as stream:
            header = _read_header(stream.read(375), size)
            _check_extended_records(stream, header, size)
            check_points(header.count, str(path))
            if not header.is_compressed:
                refuse_expansion(size, size, limit, str(path))
                if header.count * header.row > size - header.start:
                    _fail(
                        107,
                        f"{header.count} points claimed, but {size - header.start} bytes follow",
                    )
                return 0
            refuse_expansion(header.count * header.row, size, limit, str(path))
            return _check_compressed(stream, header, size)
    except _Failure as failure:
        byte, reason = failure.args
        raise FormatError(reason, file=str(path), byte_offset=byte) from None


def _read_header(head: bytes, size: int) -> _Header:
    if head[:4] != b"LASF":
        _fail(0, "expected a LAS file (LASF)")
    if len(head) < _HEADER:
        _fail(len(head), "file ends within the header")
    major, minor = head[24], head[25]
    if major != 1 or minor > 4:
        _fail(24, f"expected LAS 1.0 to 1.4, got {major}.{minor}")
    header_size, start, num_vlrs, kind, row, count = struct.unpack_from("<HIIBHI", head, 94)
    evlr_start = num_evlrs = 0
    if minor == 4:
        if len(head) < 255:
            _fail(len(head), "file ends within the header")
        evlr_start, num_evlrs, count = struct.unpack_from("<QIQ", head, 235)
    if header_size < _HEADER or start < header_size or start > size:
        _fail(96, f"expected points at bytes {header_size} to {size}, got {start}")
    if num_vlrs * _VLR > start - header_size:
        _fail(100, f"{num_vlrs} records claimed, but there is room for {start - header_size} bytes")
    is_compressed = kind & 0xC0 != 0
    return _Header(header_size, start, num_vlrs, is_compressed, row, count, evlr_start, num_evlrs)


def _check_extended_records(stream: BinaryIO, header: _Header, size: int) -> None:
    if header.num_evlrs * _EVLR > max(0, size - header.evlr_start):
        _fail(243, f"{header.num_evlrs} records claimed, but the file ends before them")
    place = header.evlr_start
    for _ in range(header.num_evlrs):
        stream.seek(place)
        head = stream.read(_EVLR)
        if len(head) < _EVLR:
            _fail(place, "file ends within the head of an extended record")
        (length,) = struct.unpack_from("<Q", head, 20)
        if length > size - place - _EVLR:
            _fail(place + 20, f"a record of {length} bytes, but {size - place - _EVLR} follow")
        place += _EVLR + length


def _check_compressed(stream: BinaryIO, header: _Header, size: int) -> int:
    place, data = _laszip_record(stream, header)
    laszip = _parse_laszip(data, place, header.row)
    if header.count == 0:
        return 0
    table = _chunk_table_place(stream, header, size)
    stream.seek(table)
    head = stream.read(8)
    if len(head) < 8:
        _fail(table, "file ends within the chunk table")
    _, num_chunks = struct.unpack("<II", head)
    most = header.count
    if laszip.chunk_size != _VARIABLE:
        if laszip.chunk_size == 0:
            _fail(header.start, "expected chunks of at least one point, got 0")
        most = -(-header.count // laszip.chunk_size)
    if num_chunks > most:
        _fail(table + 4, f"{num_chunks} chunks claimed for {header.count} points, at most {most}")
    if laszip.compressor == _LAYERED:
        # If chunks are missing in the table, the decoder reads on with layers of unchecked size.
        fewest = 1 if laszip.chunk_size == _VARIABLE else most
        if num_chunks < fewest:
            _fail(table + 4, f"{num_chunks} chunks for {header.count} points, at least {fewest}")
        _check_layers(stream, header, laszip, table)
    else:
        _chunk_sizes(stream, header, laszip)
    return int(num_chunks)


def correct_wave_packets(stream: BinaryIO) -> None:
    """Change the version of wave packets in the LASzip record of a file that lazrs has written.

    lazrs states 2, which LASzip does not know and refuses; the compression is that of version 1.
    """
    size = stream.seek(0, io.SEEK_END)
    stream.seek(0)
    header = _read_header(stream.read(375), size)
    place, data = _laszip_record(stream, header)
    for number, (kind, _) in enumerate(_parse_laszip(data, place, header.row).items):
        if kind == _WAVE_PACKETS:
            stream.seek(place + _ITEMS + 6 * number + 4)
            stream.write(struct.pack("<H", 1))


def _laszip_record(stream: BinaryIO, header: _Header) -> tuple[int, bytes]:
    """Return the place of LASzip's record in the file, and its bytes."""
    place = header.size
    for _ in range(header.num_vlrs):
        stream.seek(place)
        head = stream.read(_VLR)
        if len(head) < _VLR:
            _fail(place, "file ends within the head of a record")
        user, record, length = head[2:18].rstrip(b"\0"), *struct.unpack_from("<HH", head, 18)
        if place + _VLR + length > header.start:
            _fail(place + 20, f"a record of {length} bytes reaches into the points")
        if (user, record) == _LASZIP:
            return place + _VLR, stream.read(length)
        place += _VLR + length
    _fail(header.size, "compressed points without LASzip's record")


def _parse_laszip(data: bytes, place: int, row: int) -> _LasZip:
    if len(data) < _ITEMS:
        _fail(place, "file ends within LASzip's record")
    (compressor,) = struct.unpack_from("<H", data, 0)
    (chunk_size,) = struct.unpack_from("<I", data, 12)
    (num_items,) = struct.unpack_from("<H", data, 32)
    if len(data) < _ITEMS + 6 * num_items:
        _fail(place + 32, f"{num_items} items claimed in a record of {len(data)} bytes")
    items = [struct.unpack_from("<HHH", data, _ITEMS + 6 * i)[:2] for i in range(num_items)]
    if sum(size for _, size in items) != row:
        _fail(place + _ITEMS, f"items of {sum(size for _, size in items)} bytes in points of {row}")
    return _LasZip(compressor, chunk_size, tuple((kind, size) for kind, size in items), data)


def _chunk_table_place(stream: BinaryIO, header: _Header, size: int) -> int:
    stream.seek(header.start)
    (place,) = struct.unpack("<q", stream.read(8).ljust(8, b"\0"))
    # -1: the file was written as a stream, and its last eight bytes hold the offset.
    if place == -1 and size >= header.start + 16:
        stream.seek(size - 8)
        (place,) = struct.unpack("<q", stream.read(8))
    if not header.start + 8 <= place <= size - 8:
        _fail(
            header.start,
            f"expected the chunk table at bytes {header.start + 8} to {size - 8}, got {place}",
        )
    return int(place)


def _check_layers(stream: BinaryIO, header: _Header, laszip: _LasZip, table: int) -> None:
    """Check the chunks of a layered file.

    A chunk holds its first point, the number of points, the size of each layer, and the layers.
    """
    point = sum(size for _, size in laszip.items)
    num_layers = sum(
        size if kind == _EXTRA_BYTES else _LAYERS.get(kind, 0) for kind, size in laszip.items
    )
    head = point + 4 + 4 * num_layers
    place = header.start + 8
    for num_bytes in _chunk_sizes(stream, header, laszip):
        if num_bytes < head or num_bytes > table - place:
            _fail(place, f"a chunk of {num_bytes} bytes, expected {head} to {table - place}")
        stream.seek(place + point)
        num_points, *layers = struct.unpack(f"<{1 + num_layers}I", stream.read(4 + 4 * num_layers))
        if num_points > header.count:
            _fail(place + point, f"a chunk of {num_points} points in a file of {header.count}")
        if sum(layers) > num_bytes - head:
            _fail(
                place + point + 4,
                f"layers of {sum(layers)} bytes in a chunk that has {num_bytes - head} for them",
            )
        place += num_bytes


def _chunk_sizes(stream: BinaryIO, header: _Header, laszip: _LasZip) -> list[int]:
    """Return the size of each chunk in bytes, from the compressed chunk table.

    The number of entries in the table must have been checked before.
    """
    lazrs = imported("lazrs", "las")
    stream.seek(header.start)
    try:
        table = lazrs.read_chunk_table(stream, lazrs.LazVlr(laszip.data))
    except (MemoryError, KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # a panic in Rust is a BaseException, but no Exception
        _fail(header.start, f"damaged chunk table: {str(error)[:200]}")
    if laszip.chunk_size == _VARIABLE:
        counts = [int(num_points) for num_points, _ in table]
        most = max(counts, default=0)
        if most > header.count:
            _fail(header.start, f"a chunk of {most} points in a file of {header.count}")
        if sum(counts) < header.count:
            _fail(header.start, f"chunks of {sum(counts)} points in a file of {header.count}")
    return [int(num_bytes) for _, num_bytes in table]

"""Pictures that carry the record of a scan: what they bind, and what is refused."""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import watermark_oracle as oracle
from numpy.typing import NDArray

import command_line
from manip3d import LidarFrame, _core
from manip3d.authenticate import (
    KeyFile,
    Policy,
    Watermarker,
    WatermarkResult,
    read_carrier,
    record_of_picture,
    record_path,
    without_record,
    write_carrier,
    write_watermarked,
)
from manip3d.authenticate._picture_files import picture_path
from manip3d.errors import FormatError, InputError
from watermark_scans import ROOT_KEY, grid_scan, reflectances

pytest.importorskip("PIL")

Picture = NDArray[np.uint8]
CARRIER = 16384


def frame(seed: int = 0) -> LidarFrame:
    return LidarFrame(grid_scan(6000, seed), reflectances(6000, seed))


def photo(channels: int = 1, seed: int = 0) -> Picture:
    shape = (120, 160) if channels == 1 else (75, 80, 3)
    return np.random.default_rng(seed).integers(0, 256, shape, np.uint8)


def verify(key: KeyFile, scan: LidarFrame, picture: Picture, **policy: Any) -> WatermarkResult:
    chosen = Policy(**{"order": "any", **policy})
    return Watermarker(key).verify(scan, None, policy=chosen, picture=picture)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("embedding", ["lbm", "qim", "detached"])
def test_a_picture_carries_the_record(key: KeyFile, embedding: str, channels: int) -> None:
    plain = photo(channels)
    sent = Watermarker(key, embedding=embedding).embed(frame(), picture=plain)
    assert sent.picture is not None
    assert record_of_picture(sent.picture) == sent.record
    assert verify(key, sent.frame, sent.picture).verdict == "authentic"
    changed = sent.picture != plain
    assert set(np.flatnonzero(changed)) <= set(range(CARRIER))
    assert (sent.picture[changed] ^ plain[changed] == 1).all()
    # Both ends see the same without the carrier's bits.
    np.testing.assert_array_equal(without_record(sent.picture), without_record(plain))
    assert without_record(plain).reshape(-1)[:CARRIER].max() == 254
    np.testing.assert_array_equal(
        without_record(plain).reshape(-1)[CARRIER:], plain.reshape(-1)[CARRIER:]
    )


@pytest.mark.parametrize("channels", [1, 3])
def test_the_record_is_that_of_the_independent_implementation(key: KeyFile, channels: int) -> None:
    plain = photo(channels, seed=4)
    session, sensor = bytes(range(16)), b"roof".ljust(16, b"\0")
    embedder = _core.WatermarkEmbedder(key._key, sensor, session, 1, 7, 100, False, False)
    points, shine = grid_scan(900, 3), reflectances(900, 3)
    found = embedder.embed(points, shine, 5, 0, True, None, picture=plain)
    other = oracle.Embedder(ROOT_KEY, sensor, session, oracle.LBM, 7, 100, carrier=1)
    cleared = bytearray(plain.tobytes())
    for place in range(CARRIER):
        cleared[place] &= 0xFE
    shape = struct.pack("<III", plain.shape[0], plain.shape[1], channels)
    context = oracle.blake(b"m3d-image" + shape + bytes(cleared), other.keys[4])
    rows = [tuple(map(float, row)) for row in points]
    expected = other.embed(rows, [float(v) for v in shine], 5, True, context)  # type: ignore[arg-type]
    assert found[1] == expected.record
    np.testing.assert_array_equal(found[0], np.array(expected.points, np.float32))
    bits = np.frombuffer(expected.record, np.uint8)
    for place, byte in enumerate(bits):
        for bit in range(8):
            cleared[8 * place + bit] |= (int(byte) >> bit) & 1
    assert found[5].tobytes() == bytes(cleared)


@pytest.mark.parametrize("place", [0, 100, CARRIER - 1, CARRIER, 19_199])
def test_every_sample_and_every_bit_of_the_picture_is_bound(key: KeyFile, place: int) -> None:
    sent = Watermarker(key).embed(frame(), picture=photo())
    assert sent.picture is not None
    for bit in range(8):
        other = sent.picture.copy()
        other.reshape(-1)[place] ^= 1 << bit
        found = verify(key, sent.frame, other)
        is_record = bit == 0 and place < CARRIER
        assert found.verdict == ("undecidable" if is_record else "tampered"), found.reason
        if not is_record:
            assert found.reason == "the picture is not the one that was signed"
            assert found.content == "tampered"
            assert found.changed_tiles == ()


def test_another_shape_of_the_same_samples_is_another_picture(key: KeyFile) -> None:
    sent = Watermarker(key).embed(frame(), picture=photo())
    assert sent.picture is not None
    for shape in ((160, 120), (80, 80, 3)):
        assert verify(key, sent.frame, sent.picture.reshape(shape)).verdict == "tampered"


def test_pictures_and_scans_cannot_be_swapped(key: KeyFile) -> None:
    marker = Watermarker(key)
    sent = [marker.embed(frame(n), picture=photo(seed=n)) for n in range(3)]
    for a, scan in enumerate(sent):
        for b, shown in enumerate(sent):
            assert shown.picture is not None
            found = verify(key, scan.frame, shown.picture)
            assert (found.verdict == "authentic") == (a == b)
    # A record moved into another picture.
    assert sent[0].picture is not None
    forged = without_record(photo(seed=9)).copy()
    forged.reshape(-1)[:CARRIER] |= sent[0].picture.reshape(-1)[:CARRIER] & 1
    assert verify(key, sent[0].frame, forged).verdict == "tampered"


def test_the_chain_goes_on_through_pictures(key: KeyFile) -> None:
    marker, verifier = Watermarker(key), Watermarker(key)
    sent = [marker.embed(frame(n), picture=photo(seed=n), is_end=n == 2) for n in range(3)]
    orders = [verifier.verify(s.frame, None, picture=s.picture).order for s in sent]
    assert orders == ["in order"] * 3
    assert verifier.verify(sent[1].frame, None, picture=sent[1].picture).verdict == "tampered"


def test_stripped_and_downgraded_carriers_are_unverifiable(key: KeyFile) -> None:
    sent = Watermarker(key).embed(frame(), picture=photo())
    assert sent.picture is not None
    beside = Watermarker(key).verify(sent.frame, sent.record, policy=Policy(order="any"))
    assert beside.verdict == "undecidable"
    assert "picture" in beside.reason
    assert verify(key, sent.frame, without_record(sent.picture)).verdict == "undecidable"
    assert verify(key, sent.frame, photo()).verdict == "undecidable"
    assert verify(key, sent.frame, sent.picture, carriers=["sidecar"]).verdict == "undecidable"
    plain = Watermarker(key).embed(frame())
    carried = without_record(photo()).copy()
    bits = np.unpackbits(np.frombuffer(plain.record, np.uint8), bitorder="little")
    carried.reshape(-1)[: len(bits)] |= bits
    found = verify(key, plain.frame, carried)
    assert (found.verdict, found.reason) == (
        "undecidable", "the record is not one that a picture carries",
    )  # fmt: skip


def test_bad_input_is_refused(key: KeyFile) -> None:
    marker = Watermarker(key)
    for wrong in (np.zeros((127, 129), np.uint8), np.zeros((200, 200), np.float32),
                  np.zeros((200, 200, 4), np.uint8), np.zeros(40_000, np.uint8)):  # fmt: skip
        with pytest.raises(InputError, match="picture"):
            marker.embed(frame(), picture=wrong)
        with pytest.raises(InputError, match="picture"):
            marker.verify(frame(), None, picture=wrong)
    with pytest.raises(InputError, match="record: cannot be given"):
        marker.verify(frame(), b"x", picture=photo())
    with pytest.raises(InputError, match="carriers"):
        Policy(carriers=["radio"])
    # A refused frame is no frame of the chain.
    wide = Watermarker(key, slices=360, least_points=1)
    many = LidarFrame(grid_scan(100_000))
    with pytest.raises(InputError, match="2048 bytes"):
        wide.embed(many, picture=photo())
    assert wide.embed(many).number == 0


def test_a_path_for_a_picture_that_is_not_there_is_refused(tmp_path: Path, key: KeyFile) -> None:
    sent = Watermarker(key).embed(frame())
    with pytest.raises(InputError, match=r"^picture: expected none"):
        write_watermarked(sent, tmp_path / "scan.pcd", picture=tmp_path / "scan.png")
    assert list(tmp_path.iterdir()) == [tmp_path / "sensor.key"]


def png(*chunks: tuple[bytes, bytes], end: bytes = b"") -> bytes:
    parts = [b"\x89PNG\r\n\x1a\n"]
    for name, body in chunks:
        crc = struct.pack(">I", zlib.crc32(name + body))
        parts.append(struct.pack(">I", len(body)) + name + body + crc)
    return b"".join(parts) + end


def header(bits: int = 8, color: int = 0, interlace: int = 0) -> tuple[bytes, bytes]:
    return b"IHDR", struct.pack(">IIBBBBB", 160, 120, bits, color, 0, 0, interlace)


BODY = (b"IDAT", zlib.compress(b"".join(bytes([0]) + bytes(160) for _ in range(120))))
END = (b"IEND", b"")


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"GIF89a", "expected a PNG file"),
        (png(header(bits=16), BODY, END), "16 bits"),
        (png(header(color=6), BODY, END), "colour type 6"),
        (png(header(color=3), BODY, END), "colour type 3"),
        (png(header(interlace=1), BODY, END), "interlace"),
        (png(header(), (b"tRNS", b"\0\0"), BODY, END), "transparency"),
        (png(header(), (b"acTL", bytes(8)), BODY, END), "animation"),
        (png(header(), (b"PLTE", bytes(3)), BODY, END), "PLTE"),
        (png(header(), BODY, END, end=b"x"), "behind the end"),
        (png(header(), BODY), "too early"),
        (png(header(), BODY, END)[:-5], "too early"),
        (png(header(), header(), BODY, END), "one header"),
        (png(BODY, header(), END), "one header"),
        (png((b"IHDR", b"")), "13 bytes"),
        (png(header(), (b"IDAT", b"junk"), END), "unreadable"),
        (png((b"IHDR", struct.pack(">IIBBBBB", 2**31, 2**31, 8, 0, 0, 0, 0))), "pixels"),
        (png(header(), BODY, END).replace(b"IEND", b"IENE"), "checksum"),
    ],
)
def test_files_that_could_show_something_else_are_refused(
    tmp_path: Path, data: bytes, reason: str
) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(data)
    with pytest.raises(FormatError, match=reason):
        read_carrier(path)


@pytest.mark.parametrize("channels", [1, 3])
def test_a_picture_is_written_as_it_is_read(tmp_path: Path, channels: int) -> None:
    write_carrier(photo(channels), tmp_path / "a.png")
    np.testing.assert_array_equal(read_carrier(tmp_path / "a.png"), photo(channels))
    (tmp_path / "b.png").write_bytes(png(header(), (b"tEXt", b"a\0b"), BODY, END))
    assert read_carrier(tmp_path / "b.png").shape == (120, 160)


def run(*arguments: object) -> tuple[int, dict[str, Any]]:
    done = command_line.run("watermark", *arguments, "--json", "-q")
    return done.exit_code, json.loads(done.stdout) if done.stdout.startswith("{") else {}


def test_commands_on_a_scan_and_its_picture(tmp_path: Path, key: KeyFile) -> None:
    secret, scan, shown = tmp_path / "sensor.key", tmp_path / "a.bin", tmp_path / "a.png"
    frame().write(scan)
    write_carrier(photo(), shown)
    out = tmp_path / "b.bin"
    assert run("embed", scan, "--key", secret, "--picture", shown, "-o", out)[0] == 0
    assert not record_path(out).exists()
    carried = picture_path(out)
    assert run("verify", out, "--key", secret, "--picture", carried)[0] == 0
    assert run("verify", out, "--key", secret)[0] == 4
    again = ("embed", out, "--key", secret, "--picture", carried, "-o", tmp_path / "c.bin")
    assert run(*again)[0] == 1  # the picture carries a record already
    assert run(*again, "--again")[0] == 0
    assert run("verify", out, "--key", secret, "--picture", shown)[0] == 4
    assert run("verify", out, "--key", secret, "--picture", tmp_path / "no.png")[0] == 4
    other = read_carrier(carried).copy()
    other[100, 100] ^= 4
    write_carrier(other, carried)
    code, found = run("verify", out, "--key", secret, "--picture", carried)
    assert (code, found["verdict"]) == (3, "tampered")
    assert run("embed", scan, "--key", secret, "--picture", shown, "-o", out)[0] == 1  # exists


def test_commands_on_a_drive(tmp_path: Path, key: KeyFile) -> None:
    secret, drive, out = tmp_path / "sensor.key", tmp_path / "drive", tmp_path / "signed"
    for folder in ("velodyne_points", "image_02"):
        (drive / folder / "data").mkdir(parents=True)
    for number in range(3):
        frame(number).write(drive / "velodyne_points" / "data" / f"{number:010d}.bin")
        write_carrier(photo(3, number), drive / "image_02" / "data" / f"{number:010d}.png")
    assert run("embed", drive, "--key", secret, "--picture", "image_02", "-o", out)[0] == 0
    assert not list(out.rglob("*.wm"))
    code, found = run("verify", out, "--key", secret, "--picture", "image_02")
    assert (code, found["verdict"], found["num_frames"]) == (0, "authentic", 3)
    (out / "image_02" / "data" / "0000000001.png").unlink()
    assert run("verify", out, "--key", secret, "--picture", "image_02")[0] == 4
    assert run("verify", out, "--key", secret, "--picture", "../drive/image_02")[0] == 1

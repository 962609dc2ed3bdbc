"""Live packets on the loopback: none is lost, what is refused is counted."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import sys
import textwrap
import time

import numpy as np
import pytest

from manip3d import DeviceError, InputError, capture
from velodyne_packets import LOWER, block, hdl64e_calibration, packet

PACKETS_PER_SECOND = 3500  # an HDL-64E


def turn_packets(count: int) -> bytes:
    """Packets of an HDL-64E, six columns each; the first range holds the packet's number."""
    blocks = [block(0, [500] + [2000] * 31), block(0, [3000] * 32, flag=LOWER)] * 6
    one = np.frombuffer(packet(blocks, mode=0, product=0), np.uint8)
    packets = np.tile(one, (count, 1))
    columns = packets[:, :1200].reshape(count, 6, 2, 100)
    azimuth = (np.arange(6 * count).reshape(count, 6) * 18 % 36000).astype("<u2")
    columns[..., 2:4] = azimuth[..., None].view(np.uint8)[:, :, None]
    number = (1000 + np.arange(count) % 60000).astype("<u2")
    columns[:, 0, 0, 4:6] = number[:, None].view(np.uint8)
    return packets.tobytes()


# Sends what stdin holds, packet by packet, at a steady rate, from a process of its own.
SENDER = textwrap.dedent(
    """
    import socket, sys, time
    port, rate = int(sys.argv[1]), float(sys.argv[2])
    data = sys.stdin.buffer.read()
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    start = time.monotonic()
    for i in range(len(data) // 1206):
        while time.monotonic() < start + i / rate:
            time.sleep(0.0005)
        out.sendto(data[1206 * i : 1206 * (i + 1)], ("127.0.0.1", port))
    """
)


def test_nothing_is_lost_at_the_rate_of_an_hdl64e() -> None:
    num_packets = 2 * PACKETS_PER_SECOND
    data = turn_packets(num_packets)
    calibration = hdl64e_calibration(two_points=False)
    with capture.open("velodyne:0", calibration=calibration) as source:
        command = [sys.executable, "-c", SENDER, str(source.port), str(PACKETS_PER_SECOND)]
        with subprocess.Popen(command, stdin=subprocess.PIPE) as sender:
            assert sender.stdin is not None
            sender.stdin.write(data)
            sender.stdin.close()
            # The last turn stays open: who waited for it would wait for the whole timeout.
            whole_turns = (num_packets * 6 * 18 - 1) // 36000
            frames = [source.read(timeout=20.0) for _ in range(whole_turns)]
            end = time.monotonic() + 20.0
            while source.counters["udp_packets"] < num_packets and time.monotonic() < end:
                time.sleep(0.01)
        source.stop()
        frames += list(source)
        counters = source.counters
    assert None not in frames
    assert counters["udp_packets"] == counters["packets"] == num_packets
    assert counters["udp_dropped"] == counters["udp_dropped_kernel"] == 0
    assert counters["points"] == num_packets * 384 == sum(f.num_points for f in frames)
    assert counters["backward_azimuth"] == 0
    ranges = np.concatenate([f.fields["range"] for f in frames])
    numbers = np.round(ranges[::384] * 500).astype(int) - 1000
    assert numbers.tolist() == [i % 60000 for i in range(num_packets)]
    middle = frames[1]
    assert middle.format is not None
    assert middle.format.header["is_complete"]
    assert middle.time_ns is not None
    assert abs(middle.time_ns / 1e9 - time.time()) < 3600


def send(port: int, *payloads: bytes, sender: str = "127.0.0.1") -> None:
    with contextlib.closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as out:
        out.bind((sender, 0))
        for payload in payloads:
            out.sendto(payload, ("127.0.0.1", port))


def vlp16(azimuth: int) -> bytes:
    return packet([block(azimuth + 40 * b, [1000] * 32) for b in range(12)], product=0x22)


def wait_for(source: capture.LidarSource, counter: str, value: int) -> None:
    deadline = time.monotonic() + 20.0
    while source.counters[counter] < value and time.monotonic() < deadline:
        source.read(timeout=0.01)


def test_stopping_gives_what_is_left() -> None:
    source = capture.open("velodyne:127.0.0.1:0")
    assert source.read(timeout=0.0) is None
    send(source.port, vlp16(0), b"noise", bytes(2000), vlp16(480))
    wait_for(source, "packets", 2)
    source.stop()
    (frame,) = list(source)
    assert frame.num_points == 768
    assert source.read() is None
    counters = source.counters
    assert (counters["udp_packets"], counters["udp_too_long"], counters["bad_length"]) == (3, 1, 1)


def test_a_full_ring_counts_what_it_drops() -> None:
    with capture.open("velodyne:0", ring_packets=4) as source:
        send(source.port, *[vlp16(480 * i) for i in range(10)])
        deadline = time.monotonic() + 20.0
        while source.counters["udp_dropped"] < 6 and time.monotonic() < deadline:
            time.sleep(0.01)  # nobody reads
        source.stop()
        assert sum(frame.num_points for frame in source) == 4 * 384
        assert (source.counters["udp_packets"], source.counters["udp_dropped"]) == (4, 6)


def test_other_senders_are_ignored() -> None:
    with capture.open("velodyne:0", sender="127.0.0.9") as source:
        send(source.port, vlp16(0))
        wait_for(source, "udp_other_sender", 1)
        assert source.counters["udp_other_sender"] == 1
        assert source.counters["udp_packets"] == 0


def test_two_live_sensors_are_not_mixed() -> None:
    """The first that sends data is read; stray packets before it determine nothing."""
    with capture.open("velodyne:0") as source:
        send(source.port, b"noise", bytes(1204) + b"\x37\x28", sender="127.0.0.3")
        for i in range(6):
            send(source.port, vlp16(480 * i), sender="127.0.0.1")
            send(source.port, vlp16(18000 + 480 * i), sender="127.0.0.2")
        wait_for(source, "udp_other_sender", 6)
        source.stop()
        (frame,) = list(source)
    assert frame.num_points == 6 * 384
    assert frame.fields["azimuth"].max() < 30.0
    assert source.counters["udp_other_sender"] == 6
    assert source.counters["backward_azimuth"] == 0


def test_addresses() -> None:
    first = capture.open("velodyne:0")
    with first, pytest.raises(DeviceError, match=r"UDP port 127\.0\.0\.1"):
        capture.open(f"velodyne:{first.port}")
    with pytest.raises(DeviceError, match=r"UDP port 192\.0\.2\.1:2368"):  # an example's address
        capture.open("velodyne:192.0.2.1:2368")
    with pytest.raises(InputError, match="address: expected an IPv4 address, got 'example'"):
        capture.open("velodyne:example:2368")
    with pytest.raises(InputError, match="sender: expected an IPv4 address"):
        capture.open("velodyne:0", sender="x")
    with pytest.raises(InputError, match="ring_packets: expected 1 to"):
        capture.open("velodyne:0", ring_packets=0)


def test_a_display_gets_the_newest_frame() -> None:
    with capture.open("velodyne:0") as source:
        assert source.read_latest(timeout=0.0) is None
        send(source.port, *[vlp16(480 * i) for i in range(3 * 75)])  # three turns
        deadline = time.monotonic() + 20.0
        while source.counters["udp_packets"] < 225 and time.monotonic() < deadline:
            time.sleep(0.01)
        source.stop()
        newest = source.read_latest()
        assert newest is not None
        assert source.counters["skipped"] == source.counters["frames"] - 1 == 2
        assert source.counters["points"] == 225 * 384
        assert source.read_latest() is None

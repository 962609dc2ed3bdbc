"""Points by bandwidth: no second ever has more bytes than allowed, counted from sent files."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from frame_reader import read_frame
from manip3d import FormatError, InputError, Intrinsics, read_mesh, simplify
from manip3d.simplify import DepthOptions, ReliefStream
from manip3d.simplify._bandwidth import Bandwidth, SlidingSecond, fit_bytes

CAMERA = Intrinsics(120, 90, 110.0, 110.0, 59.5, 44.5)
V, U = np.mgrid[0:90, 0:120]
SECOND = 1_000_000_000


def frames(count: int) -> list[NDArray[np.uint16]]:
    """Return frames of a scene that grows rougher, with noise and holes."""
    rng = np.random.default_rng(0)
    found = []
    for number in range(count):
        scene = 1500 + 30 * number * np.sin(U / 9) * np.cos(V / 7) + 3 * rng.normal(size=U.shape)
        scene[rng.random(U.shape) < 0.001 * number] = 0
        found.append(scene.astype(np.uint16))
    return found


def picture(seed: int) -> NDArray[np.uint8]:
    """Return colours that are hard to compress for some seeds and easy for others."""
    rng = np.random.default_rng(seed)
    noise = rng.integers(0, 256, (90, 120, 3))
    return (noise * (seed % 3) // 2).astype(np.uint8)


def most_in_a_second(times: list[int], sizes: list[int]) -> int:
    """Return the most bytes in any of the seconds that begin just before a frame."""
    return max(
        sum(size for t, size in zip(times, sizes, strict=True) if begin <= t < begin + SECOND)
        for begin in times
    )


def test_a_stream_has_no_more_bytes_than_its_bandwidth() -> None:
    for bandwidth, rate in ((40_000, 10), (123_456, 29.97), (3_000, 2.5)):
        stream = ReliefStream(CAMERA, 5000, bandwidth=bandwidth, rate=rate, effort="live")
        results = [stream.simplify(frame) for frame in frames(12)]
        sizes = [len(r.encoded or b"") for r in results]
        times = [round(i * SECOND / rate) for i in range(12)]
        assert most_in_a_second(times, sizes) <= bandwidth
        share = bandwidth // -(-rate // 1)
        # The frames use nearly all of the bandwidth.
        assert min(sizes) > 0.6 * share
        assert sum(sizes) > 0.9 * 12 * share
        for number, result in enumerate(results):
            assert result.encoded is not None
            sent = read_frame(result.encoded)
            assert (sent.sequence, sent.time_ns) == (number, times[number])
            np.testing.assert_array_equal(sent.body, result.faces)
            extent = np.ptp(result.vertices, axis=0)
            assert (np.abs(sent.vertices - result.vertices) <= extent / 65_000 + 1e-6).all()


def test_pictures_count_and_frames_that_come_too_often_share_what_is_left() -> None:
    rng = np.random.default_rng(4)
    times = np.cumsum(rng.integers(1, 80_000_000, 40)).tolist()  # up to 80 ms apart, on average 40
    stream = ReliefStream(CAMERA, 2000, bandwidth=60_000, rate=10, effort="live")
    results = [
        stream.simplify(frame, color=picture(number), time_ns=times[number])
        for number, frame in enumerate(frames(10) * 4)
    ]
    sizes = [len(r.encoded or b"") for r in results]
    assert most_in_a_second(times, sizes) <= 60_000
    assert max(sizes) <= 6_000
    skipped = [r for r in results if r.stop == "bandwidth"]
    assert 0 < len(skipped) < 40
    for result in skipped:
        assert (result.num_vertices, result.num_faces, result.encoded) == (0, 0, b"")
        assert result.coverage == 0
    assert all(read_frame(r.encoded).body_jpeg for r in results if r.encoded)


def test_what_is_sent_can_be_anything() -> None:
    def encode(found: simplify.Relief) -> bytes:
        return bytes(1000 + 100 * found.num_vertices)

    stream = ReliefStream(CAMERA, 5000, bandwidth=50_000, rate=10, encode=encode, effort="live")
    for frame in frames(5):
        result = stream.simplify(frame)
        assert result.encoded is not None
        assert len(result.encoded) == 1000 + 100 * result.num_vertices
        assert 30 <= result.num_vertices <= 40
    assert result.with_faces(result.faces[:5]).encoded is None


def test_a_stream_of_few_points_needs_no_more() -> None:
    stream = ReliefStream(CAMERA, 60, bandwidth=1e9, rate=30)
    assert [stream.simplify(frame).num_vertices for frame in frames(3)] == [60, 60, 60]
    plain = ReliefStream(CAMERA, 60)
    assert plain.simplify(frames(1)[0]).encoded is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"bandwidth": 1000.0}, "bandwidth, rate: expected both"),
        ({"rate": 30.0}, "bandwidth, rate: expected both"),
        ({"encode": bytes}, "encode only with them"),
        ({"bandwidth": 0.0, "rate": 30.0}, "bandwidth: expected > 0"),
        ({"bandwidth": float("nan"), "rate": 30.0}, "bandwidth: expected > 0"),
        ({"bandwidth": 1e6, "rate": float("inf")}, "rate: expected > 0"),
        ({"bandwidth": 20.0, "rate": 30.0}, "bandwidth: expected at least 30 bytes a second"),
    ],
)
def test_bad_options(options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        ReliefStream(CAMERA, 50, **options)  # type: ignore[arg-type]


def test_bad_times() -> None:
    stream = ReliefStream(CAMERA, 50, bandwidth=1e6, rate=30)
    stream.simplify(frames(1)[0], time_ns=1000)
    for time_ns, message in ((999, "time_ns: expected 1000 or later"), (1.5, "time_ns")):
        with pytest.raises(InputError, match=message):
            stream.simplify(frames(1)[0], time_ns=time_ns)  # type: ignore[arg-type]
    text = ReliefStream(CAMERA, 50, bandwidth=1e6, rate=30, encode=lambda _: "x")  # type: ignore[arg-type, return-value]
    with pytest.raises(InputError, match="encode: expected bytes, got str"):
        text.simplify(frames(1)[0])


@pytest.mark.parametrize("suffix", [".glb", ".ply", ".obj", ".ply.gz"])
@pytest.mark.parametrize("points", [None, 40])
def test_files_have_no_more_bytes(tmp_path: Path, suffix: str, points: int | None) -> None:
    source, output = tmp_path / "depth.npy", tmp_path / "out" / f"mesh{suffix}"
    output.parent.mkdir()
    np.save(source, frames(5)[4])
    options = DepthOptions(points, intrinsics="110,110,59.5,44.5", bandwidth=450_000, rate=29.97)
    found = simplify.simplify_depth_file(source, output, options)
    size = sum(path.stat().st_size for path in output.parent.iterdir())
    assert found.num_bytes == size <= options.max_bytes == 15_000
    if points is None:
        assert size > 0.9 * 15_000
    else:
        assert found.points == 40
    assert read_mesh(output).num_faces == found.faces
    assert not found.target_missed


def test_a_scan_and_a_picture_that_is_too_large(tmp_path: Path) -> None:
    pytest.importorskip("PIL")
    from PIL import Image

    source, color, output = (tmp_path / name for name in ("d.npy", "c.png", "o.glb"))
    np.save(source, frames(1)[0])
    Image.fromarray(picture(2)).save(color)
    options = DepthOptions(500, intrinsics="110,110,59.5,44.5", bandwidth=50_000, rate=10)
    with pytest.raises(InputError, match=r"bandwidth: expected at least .* bytes a second"):
        simplify.simplify_depth_file(source, output, options, color=color)
    assert not output.exists()
    with pytest.raises(InputError, match="bandwidth, rate: expected both"):
        DepthOptions(500, rate=30.0)
    with pytest.raises(InputError, match="points: expected a number"):
        DepthOptions(None)
    with pytest.raises(InputError, match=r"options\.points: expected a number"):
        simplify.simplify_depth(frames(1)[0], CAMERA, DepthOptions(None, bandwidth=1e5, rate=9.0))


def test_what_fills_its_share_to_the_byte_is_sent() -> None:
    def make(points: int) -> tuple[int, int, int]:
        return points, points, 10 * points

    found = fit_bytes(
        make, most_points=40, allowance=400, guess=40, bytes_per_point=10, least_share=0.9
    )
    assert found == 40


@pytest.mark.parametrize("method", ["relief", "cs3", "uniform", "poisson", "ssa"])
def test_files_of_all_methods_use_their_share(method: simplify.DepthMethod, tmp_path: Path) -> None:
    np.save(tmp_path / "d.npy", frames(4)[3])
    for share in (20_000, 100_000):
        options = DepthOptions(
            None, method, intrinsics="110,110,59.5,44.5", unit="mm", bandwidth=share, rate=1
        )
        found = simplify.simplify_depth_file(tmp_path / "d.npy", tmp_path / "o.glb", options)
        assert found.num_bytes is not None
        assert 0.95 * share <= found.num_bytes <= share


@pytest.mark.parametrize("suffix", [".glb", ".ply", ".obj", ".stl"])
@pytest.mark.parametrize("method", ["relief", "cs3", "uniform", "poisson", "ssa"])
def test_each_method_fits_into_a_share_in_each_format(
    method: simplify.DepthMethod, suffix: str, tmp_path: Path
) -> None:
    """The share is kept in each format; other formats than .glb take many more bytes per point."""
    np.save(tmp_path / "d.npy", frames(4)[3])
    for share in (5_000, 9_000, 16_000):
        options = DepthOptions(
            None, method, intrinsics="110,110,59.5,44.5", unit="mm", bandwidth=share, rate=1
        )
        output = tmp_path / f"o{suffix}"
        found = simplify.simplify_depth_file(tmp_path / "d.npy", output, options)
        assert found.num_bytes is not None
        assert 0.85 * share <= found.num_bytes <= share


@pytest.mark.parametrize(("method", "points"), [("uniform", 4), ("ssa", 5)])
def test_fewer_points_than_make_a_face_are_no_reason_to_give_up(
    method: simplify.DepthMethod, points: int, tmp_path: Path
) -> None:
    np.save(tmp_path / "wall.npy", np.full((48, 64), 2.0, np.float32))

    def made(share: int) -> simplify.DepthFileResult:
        options = DepthOptions(None, method, intrinsics="60,60,31.5,23.5", bandwidth=share, rate=1)
        return simplify.simplify_depth_file(tmp_path / "wall.npy", tmp_path / "o.glb", options)

    with pytest.raises(InputError) as caught:
        made(300)
    expected = rf"at least (\d+) bytes a second: {points} points are \1 bytes"
    told = re.search(expected, str(caught.value))
    assert told is not None
    assert made(int(told[1])).points == points  # the number that the error tells is enough
    np.save(tmp_path / "wall.npy", np.zeros((48, 64), np.float32))
    with pytest.raises(FormatError, match="found no measured pixel"):
        made(5000)


def test_a_method_that_has_no_more_points_is_not_asked_again() -> None:
    asked = []

    def make(points: int) -> tuple[int, int, int]:
        asked.append(points)
        return points, min(points - 1, 30), 10 * min(points - 1, 30)

    found = fit_bytes(
        make, most_points=1000, allowance=9000, guess=20, bytes_per_point=10, least_share=0.9
    )
    assert found == asked[1]
    assert len(asked) == 3


def test_a_frame_has_its_share_of_what_its_second_leaves() -> None:
    rng = np.random.default_rng(6)
    for bandwidth, share in ((Bandwidth(105.5, 10), 10), (Bandwidth(3, 2.5), 1)):
        assert bandwidth.share == share
        second = SlidingSecond(bandwidth)
        sent: list[tuple[int, int]] = []
        now = 0
        for _ in range(300):
            now += int(rng.choice([0, 1, SECOND // 40, SECOND // 10, SECOND - 1, SECOND]))
            left = bandwidth.bytes_per_second - sum(b for t, b in sent if t > now - SECOND)
            expected = min(share, int(left))
            assert second.allowance(now) == expected
            size = int(rng.integers(0, expected + 1))
            second.spend(now, size)
            sent.append((now, size))


def test_the_points_that_fit_are_found_in_few_tries() -> None:
    """The largest fitting number is found for sizes that grow by uneven steps."""
    for seed in range(40):
        check_the_points_that_fit(seed)


def check_the_points_that_fit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    most = int(rng.integers(3, 400))
    sizes = 200 + np.cumsum(rng.integers(1, 30, most + 1))
    allowance = int(rng.integers(150, sizes[-1] + 200)) if seed else 150  # 0: nothing fits
    asked: list[int] = []

    def make(points: int) -> tuple[int, int, int]:
        assert 3 <= points <= most
        asked.append(points)
        return points, points, int(sizes[points])

    found = fit_bytes(
        make,
        most_points=most,
        allowance=allowance,
        guess=float(rng.uniform(0, 2 * most)),
        bytes_per_point=float(rng.uniform(0.1, 60)),
        least_share=0.9,
    )
    assert len(asked) == len(set(asked)) <= 9
    fitting = [points for points in range(3, most + 1) if sizes[points] <= allowance]
    if not fitting:
        assert found is None, seed
        return
    assert found in fitting, seed
    # Steps are at most 29 bytes: a file that leaves more than one of them and a tenth has more.
    assert found == fitting[-1] or sizes[found] >= 0.9 * allowance, seed

"""Every public kernel and every object with state is called from eight threads at a time."""

from __future__ import annotations

import itertools
import random
import socket
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import capsule_body
import kernels
import rgbd_frames
import velodyne_packets
from manip3d import (
    Error,
    RgbdFrame,
    _core,
    authenticate,
    capture,
    forge,
    modify,
    serve,
    simplify,
    study,
)
from watermark_scans import grid_scan, key_file

THREADS = 8
LONG_S = 60.0


@pytest.fixture
def nightly(request: pytest.FixtureRequest) -> bool:
    """Whether ``--hypothesis-profile=nightly`` was chosen."""
    return bool(request.config.getoption("--hypothesis-profile") == "nightly")


def in_threads(jobs: Sequence[Callable[[], Any]]) -> list[Any]:
    """Run jobs at the same time, each in a thread of its own; return their results."""
    gate = threading.Barrier(len(jobs))

    def run(job: Callable[[], Any]) -> Any:
        gate.wait(LONG_S)
        return job()

    with ThreadPoolExecutor(len(jobs)) as pool:
        return [future.result(LONG_S * 10) for future in [pool.submit(run, job) for job in jobs]]


# --- functions ----------------------------------------------------------------------------------


def test_every_public_kernel_is_here() -> None:
    assert kernels.public_functions() == set(kernels.KERNELS)


def test_kernels_give_the_same_from_any_thread(nightly: bool) -> None:
    """Results do not depend on the thread; ten thousand calls are made in the nightly run."""
    expected = {name: kernels.hash_of(kernel(1)) for name, kernel in kernels.KERNELS.items()}
    rounds = -(-10_000 // (THREADS * len(expected))) if nightly else 1

    def differing(thread: int) -> list[str]:
        chance = random.Random(thread)
        wrong = []
        for _ in range(rounds):
            for name in chance.sample(sorted(expected), len(expected)):
                found = kernels.hash_of(kernels.KERNELS[name](chance.choice((1, 2))))
                wrong += [name] * (found != expected[name])
        return wrong

    assert in_threads([lambda t=t: differing(t) for t in range(THREADS)]) == [[]] * THREADS


# --- objects with state -------------------------------------------------------------------------


def serial_results(make: Callable[[], Any], calls: Sequence[Callable[[Any], object]]) -> set[Any]:
    """Return the results of the calls for every order in which they can be made."""
    found = set()
    for order in itertools.permutations(range(len(calls))):
        target = make()
        results = {i: kernels.hash_of(calls[i](target)) for i in order}
        found.add(tuple(results[i] for i in range(len(calls))))
    return found


def check_serial(
    make: Callable[[], Any], calls: Sequence[Callable[[Any], object]], trials: int
) -> None:
    """Check that simultaneous calls return the same as in some serial order."""
    allowed = serial_results(make, calls)
    for _ in range(trials):
        target = make()
        results = in_threads([lambda c=c: kernels.hash_of(c(target)) for c in calls])  # noqa: B023
        assert tuple(results) in allowed


DEPTHS = [np.roll(kernels.DEPTH, 5 * i, axis=1) for i in range(3)]
PEOPLE = [capsule_body.painted(i) for i in range(3)]
SKELETONS = [frame.skeletons[0] for frame in PEOPLE]
GRIDS = [_core.unproject(depth, kernels.CAMERA, 1) for depth in DEPTHS]


IN_COLOR = [
    replace(frame, color=np.full((*frame.depth.shape, 3), (20, 60, 90 + 60 * i), np.uint8))
    for i, frame in enumerate(PEOPLE)
]


def relief_options() -> Any:
    options = _core.ReliefOptions()
    options.target_points, options.stability, options.num_threads = 60, 30.0, 2
    return options


def solve(i: int) -> Callable[[Any], object]:
    points, valid, rows_up = GRIDS[i]
    shape = kernels.DEPTH.shape
    grid, mask = points.reshape(*shape, 3), valid.reshape(shape).view(bool)
    return lambda solver: solver.run(grid, mask, rows_up, relief_options())["vertices"]


def tables(i: int) -> Callable[[Any], object]:
    labels, squares = np.full(200, i + 4, np.uint8), np.full(200, 0.001 * (i + 1), np.float32)
    return lambda tracker: tracker.update(SKELETONS[i], labels, squares).radius


def signed_frames() -> list[authenticate.Watermarked]:
    """Return three frames of one session, embedded one after the other."""
    marker = authenticate.Watermarker(KEY)
    return [marker.embed(grid_scan(900, seed=seed)) for seed in range(3)]


def said(result: authenticate.WatermarkResult) -> tuple[object, ...]:
    return result.verdict, result.content, result.order, result.gap


with tempfile.TemporaryDirectory() as keys:
    KEY = authenticate.KeyFile(key_file(Path(keys) / "key"))
SIGNED = signed_frames()


ATTACKS = [
    authenticate.AttackObservation("additive", (8.0, 0.0), 40, 100),
    authenticate.AttackObservation("rotation", (9.0, 2.0), 10, 100),
]


def fields(frame: modify.PhantomFrame) -> tuple[object, ...]:
    return frame.state, frame.depth, frame.labels, frame.late_frames


def forged(frame: forge.ForgedFrame | None) -> object:
    return None if frame is None else (frame.frame.depth, frame.mask)


OBJECTS: dict[str, tuple[Callable[[], Any], list[Callable[[Any], object]]]] = {
    "ReliefSolver": (
        _core.ReliefSolver,
        [solve(0), solve(1), solve(2), lambda solver: solver.reset()],
    ),
    "ReliefStream": (
        lambda: simplify.ReliefStream(kernels.CAMERA, 60, threads=2),
        [lambda s, d=d: s.simplify(d).vertices for d in DEPTHS] + [lambda s: s.reset()],
    ),
    "Cs3Stream": (
        lambda: simplify.Cs3Stream(100, threads=2, frames=4),
        [lambda s, d=d: s.simplify(d, kernels.CAMERA).vertices for d in DEPTHS],
    ),
    "DepthSmoother": (
        lambda: _core.DepthSmoother(0.3, 0.1),
        [lambda s, d=d: s.add(d) for d in DEPTHS]
        + [
            lambda s: s.show(
                np.zeros((0, 2), np.int32), np.zeros(0, np.float32), np.zeros((0, 3), np.int32)
            ),
            lambda s: s.reset(),
        ],
    ),
    "PhantomPipeline": (
        modify.PhantomPipeline,
        [lambda p, f=f: fields(p.process(f)) for f in PEOPLE] + [lambda p: bool(p.reset())],
    ),
    "ArrayPool": (
        _core.ArrayPool,
        [lambda p, n=n: np.full_like(p.empty((n, 3), np.float32), n) for n in (1, 2, 2000)],
    ),
    "StreamForger": (
        lambda: forge.StreamForger(PEOPLE, kind=2, pose=SKELETONS),
        [lambda s, f=f: forged(s.process(f)) for f in PEOPLE] + [lambda s: s.reset()],
    ),
    "JointSmoother": (
        modify.JointSmoother,
        [lambda s, p=p: s.add(p) for p in SKELETONS] + [lambda s: bool(s.reset())],
    ),
    "KeyPerson": (
        modify.KeyPerson,
        [
            lambda k, i=i: k.find(SKELETONS[i:], capsule_body.SMALL, float(i)) is None
            for i in range(3)
        ],
    ),
    "ColliderTracker": (
        modify.ColliderTracker,
        [tables(0), tables(1), tables(2), lambda t: t.reset()],
    ),
    "PlacementEstimator": (
        modify.PlacementEstimator,
        [lambda e, p=p: e.update(p, "left") for p in SKELETONS] + [lambda e: e.reset()],
    ),
    "Watermarker": (
        lambda: authenticate.Watermarker(KEY),
        [lambda w, s=s: said(w.verify(s.frame, s.record)) for s in SIGNED],
    ),
    "AlertMonitor": (
        lambda: authenticate.AlertMonitor(authenticate.Watermarker(KEY)),
        [
            lambda m, s=s: m.judge(s.frame, record=s.record, speed_mps=9.0).verdict
            for s in SIGNED[:2]
        ]
        + [lambda m: m.skip().number],
    ),
    "RiskTracker": (
        authenticate.RiskTracker,
        [lambda t, a=a: t.update(a, speed_mps=90.0).record() for a in (None, *ATTACKS)]
        + [lambda t: t.reset()],
    ),
    "ShoeCoverTracker": (
        modify.ShoeCoverTracker,
        [lambda t, f=f: t.update(f, f.skeletons[0], "left") is None for f in IN_COLOR],
    ),
}


@pytest.mark.parametrize("name", OBJECTS)
def test_results_are_those_of_some_serial_order(name: str, nightly: bool) -> None:
    make, calls = OBJECTS[name]
    check_serial(make, calls, trials=200 if nightly else 5)


def test_every_object_of_the_core_with_state_is_here() -> None:
    """A new class of the core must be listed here, unless it is an enum or holds options."""
    stateful = {"ArrayPool", "Cs3Runner", "DepthSmoother", "JointSmoother", "KeyPerson",
                "PlacementEstimator", "PhantomPipeline", "ColliderTracker", "ReliefSolver",
                "RgbdRecorder", "RgbdSource", "ShoeCoverTracker", "VelodynePcapSource",
                "VelodyneUdpSource", "WatermarkEmbedder", "WatermarkKey",
                "WatermarkVerifier"}  # fmt: skip
    classes = {name for name, item in vars(_core).items() if isinstance(item, type)}
    plain = {
        name
        for name in classes
        if name.endswith(("Grid", "Options", "Policy", "Reading", "Settings"))
        or hasattr(getattr(_core, name), "__members__")
    }
    assert classes - plain == stateful


def test_an_object_cannot_be_used_from_within_itself() -> None:
    pipeline = modify.PhantomPipeline()
    frame = PEOPLE[0]

    class Hostile:
        """People that reset the pipeline while it iterates over them."""

        def __iter__(self) -> Iterator[Any]:
            pipeline._core.reset()
            return iter(())

    with pytest.raises(Error, match="from within"):
        pipeline._core.process(
            frame.depth,
            None,
            frame.calibration.depth,
            None,
            None,
            Hostile(),
            0,
            0,
            modify._phantom._Buffers.of_size(*frame.depth.shape),
        )
    assert pipeline.process(frame).depth.shape == frame.depth.shape  # the lock was let go


# --- sources and recorders ----------------------------------------------------------------------


def read_all(source: Any) -> list[Any]:
    """Read the remaining frames; iteration would begin an ended recording anew."""
    return list(iter(source.read, None))


@pytest.fixture
def recording(tmp_path: Path) -> tuple[Path, list[RgbdFrame]]:
    frames = list(rgbd_frames.frames(40))
    capture.record(frames, tmp_path / "walk", lossless_color=True)
    return tmp_path / "walk", frames


def check_shared_out(source: Any, expected: Counter[int], number: Callable[[Any], int]) -> None:
    """Check that each frame goes to exactly one reader, in order."""
    parts = in_threads([lambda: read_all(source)] * THREADS)
    numbers = [[number(frame) for frame in part] for part in parts]
    assert all(part == sorted(part) for part in numbers)
    assert Counter(itertools.chain(*numbers)) == expected


def test_readers_of_one_recording_share_its_frames(recording: tuple[Path, list[RgbdFrame]]) -> None:
    path, frames = recording
    expected = Counter(frame.number for frame in frames)
    check_shared_out(capture.open_rgbd(f"folder:{path}"), expected, lambda f: f.number)
    check_shared_out(capture.from_frames(iter(frames)), expected, lambda f: f.number)


def test_readers_of_packets_share_the_turns(tmp_path: Path) -> None:
    path = tmp_path / "r.pcap"
    path.write_bytes(velodyne_packets.whole_recording("vlp16"))
    alone = [f.num_points for f in capture.open_lidar(f"pcap:{path}")]
    source = capture.open_lidar(f"pcap:{path}")
    parts = in_threads([lambda: [f.num_points for f in read_all(source)]] * THREADS)
    assert Counter(itertools.chain(*parts)) == Counter(alone)
    assert source.counters["points"] == sum(alone)


def test_a_recording_may_be_stopped_amid_its_frames(
    recording: tuple[Path, list[RgbdFrame]],
) -> None:
    path, frames = recording
    for speed in (0.0, 5.0):
        source = capture.open_rgbd(f"folder:{path}", speed=speed)

        def stop(source: Any = source) -> None:
            time.sleep(0.01)
            source.stop()
            source.stop()

        jobs: list[Callable[[], Any]] = [lambda s=source: read_all(s)] * 4
        parts = in_threads([*jobs, stop, stop, lambda s=source: s.counters])[:4]
        numbers = [frame.number for part in parts for frame in part]
        assert len(numbers) == len(set(numbers)) <= len(frames)


@pytest.mark.parametrize("stoppers", [1, 3])
def test_stop_ends_a_read_that_waits(stoppers: int) -> None:
    for _ in range(5):
        source = capture.open_lidar("velodyne:0")
        ended = []

        def wait(source: Any = source, ended: list[float] = ended) -> None:
            assert source.read() is None
            ended.append(time.monotonic())

        def stop(source: Any = source) -> float:
            time.sleep(0.2)
            begin = time.monotonic()
            source.stop()
            source.stop()
            return begin

        results = in_threads([wait, wait, *[stop] * stoppers])
        assert len(ended) == 2
        assert min(ended) >= min(results[2:])
        assert max(ended) - min(results[2:]) < LONG_S / 2


def test_live_packets_from_many_threads() -> None:
    """Threads may start, read and stop a live source at any time, and it can go on afterwards."""
    source = capture.open_lidar("velodyne:0", model="vlp16")
    packets = velodyne_packets.whole_recording("vlp16")
    done = threading.Event()

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            while not done.is_set():
                out.sendto(packets[-1206:], ("127.0.0.1", source.port))
                time.sleep(0.001)

    def start_and_stop() -> None:
        for _ in range(20):
            source._source.start()
            source.read(0.01)
            source.stop()
        done.set()

    def look() -> None:
        while not done.is_set():
            source.read(0.01)
            assert source.counters["packets"] >= 0

    in_threads([send, start_and_stop, look, look])
    source.stop()


def test_a_recorder_takes_frames_from_any_thread(tmp_path: Path) -> None:
    frames = list(rgbd_frames.frames(40))
    recorder = _core.open_recorder(
        str(tmp_path / "walk").encode(), rgbd_frames.CALIBRATION, True, 90, False
    )

    def write(part: list[RgbdFrame]) -> int:
        written = 0
        for frame in part:
            try:
                recorder.write(frame)
                written += 1
            except Error:
                pass  # a later frame was written first, or it was closed
        return written

    jobs: list[Callable[[], Any]] = [lambda i=i: write(frames[i::4]) for i in range(4)]
    counts = in_threads(jobs)
    in_threads([recorder.close] * 4)
    found = list(capture.open_rgbd(f"folder:{tmp_path / 'walk'}"))
    assert len(found) == sum(counts) == recorder.counters()["frames"]
    by_number = {frame.number: frame for frame in frames}
    for frame in found:
        rgbd_frames.assert_same(frame, by_number[frame.number])
    with pytest.raises(Error, match="closed"):
        recorder.write(frames[-1])


# --- Objects of the package, each with a lock of its own ----------------------------------------


def test_a_diary_takes_ratings_from_any_thread(tmp_path: Path) -> None:
    pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
    from manip3d.diary import Diary

    with Diary(tmp_path / "a.diary", create=True) as kept:
        kept.enrol("P01")
        jobs: list[Callable[[], Any]] = [
            lambda i=i: [kept.add_rating("P01", i) for _ in range(5)] for i in range(THREADS)
        ]
        in_threads(jobs)
        found = Counter(rating.pain for rating in kept.ratings("P01"))
    assert found == Counter({i: 5 for i in range(THREADS)})


def test_a_study_takes_answers_from_any_thread(tmp_path: Path) -> None:
    with study.StudyFolder(tmp_path / "a", {"kind": "rating"}) as folder:
        folder.begin("p")
        jobs: list[Callable[[], Any]] = [
            lambda i=i: [
                folder.store("p", study.Answer(f"{i}-{k}", {}, {"text": "x" * 9000}))
                for k in range(5)
            ]
            for i in range(THREADS)
        ]
        in_threads(jobs)
        steps = [answer.step for answer in folder.sessions["p"].answers]
    assert sorted(steps) == sorted(f"{i}-{k}" for i in range(THREADS) for k in range(5))
    with study.StudyFolder(tmp_path / "a") as again:
        assert [answer.step for answer in again.sessions["p"].answers] == steps


def test_a_server_takes_frames_from_any_thread() -> None:
    pytest.importorskip("aiohttp", reason="the extra 'live' is not installed")
    pages = {"/": serve.Page("text/html", b"page")}
    with serve.LocalServer(pages, lambda client, text: None) as server:

        def use(first: int) -> list[str]:
            urls = []
            for number in range(20):
                server.publish(b"frame", sequence=100 * first + number, captured_ns=number)
                urls.append(server.new_url())
                server.report()
            return urls

        jobs: list[Callable[[], Any]] = [lambda i=i: use(i) for i in range(THREADS)]
        urls = [url for some in in_threads(jobs) for url in some]
        assert len(set(urls)) == 20 * THREADS  # each lets one browser in
        in_threads([server.stop] * 4)


def test_a_recorder_of_a_diary_takes_games_from_any_thread(tmp_path: Path) -> None:
    pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
    from manip3d.diary import Diary
    from manip3d.phantom._diary import DiaryRecorder

    path = tmp_path / "a.diary"
    with Diary(path, create=True) as kept:
        kept.enrol("P01")
    recorder = DiaryRecorder(path, "P01", None)
    recorder.start()
    jobs: list[Callable[[], Any]] = [
        lambda i=i: [recorder.pain(i) for _ in range(4)] for i in range(THREADS)
    ]
    in_threads(jobs)
    assert recorder.end() == []
    with Diary(path) as kept:
        found = Counter(rating.pain for rating in kept.ratings("P01"))
    assert found == Counter({i: 4 for i in range(THREADS)})

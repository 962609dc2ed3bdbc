"""``manip3d forge stream`` and ``manip3d inspect`` of recordings, as a user types them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from capsule_body import SMALL, frame, pose
from manip3d import RgbdFrame, capture, forge
from manip3d.cli.forge import forge_frames
from manip3d.cli.terminal import Terminal


def manip3d(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "manip3d", *map(str, arguments)],
        capture_output=True,
        text=True,
        env={**os.environ, "COLUMNS": "200"},
        timeout=120,
    )


@pytest.fixture
def person(tmp_path: Path) -> Path:
    """A person who stands before a noisy wall for 8 frames."""
    frames = []
    for number in range(8):
        seen = frame(pose(), SMALL, number=number)
        rng = np.random.default_rng(number)
        wall = np.rint(3600 + 20 * rng.standard_normal(seen.depth.shape)).astype(np.uint16)
        wall[rng.random(wall.shape) < 0.003] = 0
        frames.append(replace(seen, depth=np.where(seen.depth > 0, seen.depth, wall)))
    capture.record(frames, tmp_path / "person")
    return tmp_path / "person"


def test_forge_writes_a_recording_and_its_truth(person: Path, tmp_path: Path) -> None:
    out = tmp_path / "forged"
    command = ("forge", "stream", person, "--type", 2, "--pose", person, "-o", out)
    done = manip3d(*command, "--json")
    assert done.returncode == 0, done.stderr
    record = json.loads(done.stdout)
    assert (record["frames"], record["type"], record["frames_without_person"]) == (8, 2, 0)
    truth = forge.read_stream_truth(tmp_path / "forged.truth.npz")
    assert truth.masks.mean() == pytest.approx(record["forged_share"])
    assert capture.open_rgbd(f"folder:{out}").num_frames == 8
    refused = manip3d(*command)
    assert refused.returncode == 1
    assert "exists already; --force replaces it" in refused.stderr
    assert (tmp_path / "forged.truth.npz").is_file()
    assert manip3d(*command, "--force", "-q").returncode == 0


def test_a_recording_that_is_stopped_has_no_old_truth(
    person: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, truth = tmp_path / "forged", tmp_path / "forged.truth.npz"

    def forge_it(*, force: bool) -> None:
        forge_frames(
            str(person), out, Terminal(quiet=True), kind=1, pose="", background="", still=False,
            frames=8, force=force, options={},
        )  # fmt: skip

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    def fail_at_once(_: object) -> Iterator[RgbdFrame]:
        fail()
        yield from ()

    for owner, name, stopped in (
        (forge.ForgedStream, "__iter__", fail_at_once),  # before a frame is forged
        (forge.StreamTruth, "write", fail),  # after all of them
    ):
        forge_it(force=True)
        assert truth.is_file()
        with monkeypatch.context() as patch:
            patch.setattr(owner, name, stopped)
            with pytest.raises(OSError, match="No space"):
                forge_it(force=True)
        assert not truth.exists()


def test_poses_of_a_motion_file(person: Path, tmp_path: Path) -> None:
    motion, out = tmp_path / "motion.bvh", tmp_path / "forged"
    assert manip3d("capture", "export", person, "-o", motion).returncode == 0
    command = ("forge", "stream", person, "--type", 2, "--pose", motion, "-o", out, "--json")
    done = manip3d(*command)
    assert done.returncode == 0, done.stderr
    record = json.loads(done.stdout)
    assert (record["frames"], record["frames_without_person"]) == (8, 0)
    assert record["forged_share"] > 0.03
    motion.write_text("HIERARCHY\nROOT Hips {")
    broken = manip3d(*command, "--force")
    assert broken.returncode == 1
    assert "motion.bvh: line 2: expected" in broken.stderr


def test_forge_names_wrong_options(person: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = manip3d("forge", "stream", person, "--type", 2, "-o", out)
    assert done.returncode == 1
    assert "pose: expected a motion for type 2" in done.stderr
    assert manip3d("forge", "stream", person, "--type", 3, "-o", out).returncode == 2
    assert manip3d("forge", "stream", person, "-o", out).returncode == 2
    assert not out.exists()


def test_inspect_takes_recordings(person: Path, tmp_path: Path) -> None:
    out = tmp_path / "forged"
    forging = ("forge", "stream", person, "--type", 1, "--still", "--background", person)
    assert manip3d(*forging, "-o", out, "-q").returncode == 0
    evidence = tmp_path / "evidence.json"
    done = manip3d("inspect", out, "-o", evidence, "--json")
    record = json.loads(done.stdout)
    assert record == json.loads(evidence.read_text())
    # 192 x 160 pixels are no camera's: whatever was done, nobody is accused.
    assert (record["verdict"], done.returncode) == ("processed", 4)
    assert {report["name"] for report in record["detectors"]} == {
        "repetition",
        "silhouettes",
        "noise",
    }
    shown = manip3d("inspect", out)
    assert shown.stdout.startswith("processed: cropped")
    assert manip3d("inspect", out, "--policy", "processed=0", "-q").returncode == 0
    log = tmp_path / "case.jsonl"
    assert manip3d("inspect", out, "--log", log, "-q").returncode == 4
    assert json.loads(log.read_text())["verdict"] == "processed"
    for option in ("rows", "previous", "following", "lattice", "key", "watermark", "calibration"):
        ignored = manip3d("inspect", out, f"--{option}", tmp_path / "x")
        assert ignored.returncode == 1
        assert f"--{option}: expected with a LiDAR scan or drive" in ignored.stderr
    refused = manip3d("inspect", out, "-o", tmp_path / "page.pdf")
    assert "expected a name that ends in" in refused.stderr
    page = tmp_path / "page.html"
    assert manip3d("inspect", out, "-o", page, "-q").returncode == 4
    text = page.read_text()
    assert text.count("<figure>") == 6
    assert text.count("<polyline") == 2
    assert "http" not in text

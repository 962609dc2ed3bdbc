"""The watermark on all real clouds that are here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from manip3d import LidarFrame
from manip3d.authenticate import (
    MAX_MOVE_M,
    KeyFile,
    Policy,
    Watermarker,
    embed_paper,
    inspect,
    noise_blocks,
)
from manip3d.errors import InputError
from manip3d.io import SCAN_SUFFIXES, read_scan
from real_data import RealData
from watermark_scans import key_file

pytestmark = pytest.mark.realdata

ANY = Policy(order="any")


def kitti(realdata: RealData) -> list[Path]:
    found = sorted(
        path
        for folder in realdata("lidar").glob("kitti_*")
        for path in folder.rglob("*.bin*")
        if path.name.endswith((".bin", ".bin.xz", ".bin.gz"))
    )
    assert len(found) >= 47
    return found


def is_off_grid(path: Path) -> bool:
    return "kitti_odometry" in str(path)  # motion-compensated


@pytest.mark.parametrize("embedding", ["lbm", "qim"])
def test_no_wrong_bit_on_any_kitti_cloud(
    realdata: RealData, tmp_path: Path, embedding: str
) -> None:
    key = KeyFile(key_file(tmp_path / "key"))
    merged = 0
    for number, path in enumerate(kitti(realdata)):
        scan = read_scan(path)
        rounding = is_off_grid(path)
        marker = Watermarker(key, embedding=embedding, round_points=rounding)
        if rounding:
            with pytest.raises(InputError, match="grid of 1 mm"):
                Watermarker(key, embedding=embedding).embed(scan)
        sent = marker.embed(scan)
        merged += sent.num_tiles < 36
        moved = sent.points.astype(np.float64) - scan.points
        farthest = float(np.sqrt((moved**2).sum(axis=1)).max())
        rounded = 3**0.5 / 2000 if rounding else 0.0
        assert farthest <= MAX_MOVE_M[embedding] + rounded + 1.4e-5  # float32 at 80 m
        order = np.random.default_rng(number).permutation(scan.num_points)
        copy = tmp_path / "copy.bin"
        sent.frame.select(order).write(copy)
        found = marker.verify(read_scan(copy), sent.record, policy=ANY)
        assert found.verdict == "authentic", path
        row = int(order[0])
        points = sent.points.copy()
        points[row, 2] += np.float32(0.01)
        assert (
            Watermarker(key).verify(sent.frame.replace(points=points), sent.record).verdict
            == "tampered"
        )
    assert merged >= 1  # kitti_object/demo has slices with few points


def test_clouds_of_other_scanners_verify_by_manifest(realdata: RealData, tmp_path: Path) -> None:
    key = KeyFile(key_file(tmp_path / "key"))
    paths = [
        path
        for folder in ("other_sensors", "tls/3dtk_dat", "hdl32_pair", "packets/reference")
        for path in sorted(realdata(f"lidar/{folder}").rglob("*"))
        if str(path).removesuffix(".xz").endswith(SCAN_SUFFIXES)
    ]
    assert len(paths) >= 19
    for path in paths:
        scan = read_scan(path)
        marker = Watermarker(key, embedding="detached")
        sent = marker.embed(scan)
        assert np.array_equal(sent.points, scan.points)
        order = np.random.default_rng(0).permutation(scan.num_points)
        found = marker.verify(scan.select(order), sent.record)
        assert found.verdict == "authentic", path
        points = scan.points.copy()
        points[order[0], 0] = np.nextafter(points[order[0], 0], np.float32(1e9))
        changed = scan.replace(points=points)
        assert Watermarker(key).verify(changed, sent.record).verdict == "tampered", path
        if scan.exact is not None:
            exact = scan.exact.copy()
            exact[order[0], 2] = np.nextafter(exact[order[0], 2], 1e9)
            changed = scan.replace(exact=exact)
            assert Watermarker(key).verify(changed, sent.record).verdict == "tampered", path


def test_all_ordered_pairs_of_records_are_refused(realdata: RealData, tmp_path: Path) -> None:
    """Every record with the cloud of every other: a fifth of the points, all of the pairs."""
    key = KeyFile(key_file(tmp_path / "key"))
    marker = Watermarker(key, round_points=True)
    sent = []
    for path in kitti(realdata):
        scan = read_scan(path)
        sent.append(marker.embed(scan.select(np.arange(0, scan.num_points, 5))))
    verifier = Watermarker(key)
    for a, scan_of in enumerate(sent):
        frame: LidarFrame = scan_of.frame
        for b, record_of in enumerate(sent):
            verifier.reset()
            found = verifier.verify(frame, record_of.record, policy=ANY)
            assert (found.verdict == "authentic") == (a == b), (a, b)
            assert found.verdict in ("authentic", "tampered")


@pytest.mark.parametrize("embedding", ["lbm", "qim", "qim-printed"])
def test_forensics_do_not_accuse_an_embedded_scan(
    realdata: RealData, tmp_path: Path, embedding: str
) -> None:
    """Without its record a watermark is processing of the whole scan, and no forgery; with it, the
    scan is what it was before."""
    key = KeyFile(key_file(tmp_path / "key"))
    paths = [path for path in kitti(realdata) if not is_off_grid(path)]
    for path in paths[::6]:
        scan = read_scan(path)
        if embedding == "qim-printed":
            printed = embed_paper(scan, noise_blocks(1), embedding=embedding).frame
            found = inspect(printed, power=False)
            assert [step.kind for step in found.processing] == ["watermarked"], path
            assert found.verdict == "processed", path
            continue
        sent = Watermarker(key, embedding=embedding).embed(scan)
        assert inspect(sent.frame, power=False).verdict == "processed", path
        found = inspect(sent.frame, watermark=sent.record, key=key)
        assert found.verdict == inspect(scan).verdict == "no_trace", path

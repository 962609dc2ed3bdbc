"""Real scans: counts of the manifest, written back to the byte."""

from __future__ import annotations

import lzma
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from manip3d.io import read_scan
from real_data import RealData

# Points, those at (0, 0, 0), least and largest range as the manifest has them (None: not told).
SCANS = [
    ("hdl32_pair/251370668.pcd.xz", 69088, 5032, None),
    ("hdl32_pair/251371071.pcd.xz", 69792, 5107, None),
    ("packets/reference/vlp16_scan_1673400472138016708.pcd", 14831, 0, (0.5, 14.6)),
    ("packets/reference/vlp32_scan_1713492677464078412.pcd", 26216, 0, None),
    ("tls/riegl_vz400i_forest.ply.xz", 1046843, 0, (1.07, 15.38)),
    ("tls/pump_room_e57.ply.xz", 155201, 0, (1.98, 5.43)),
    ("tls/room_scan1.ply.xz", 112586, 0, (0.1, 15.61)),
    ("tls/room_scan2.ply.xz", 112624, 0, (0.09, 15.79)),
    ("tls/3dtk_dat/scan000.3d.xz", 81360, 0, (0.1, 32.8)),
    ("tls/3dtk_dat/scan001.3d.xz", 81360, 0, (0.1, 32.8)),
    ("tls/3dtk_dat/scan002.3d.xz", 81360, 0, (0.1, 32.8)),
]


@pytest.mark.parametrize(("name", "points", "empty", "reach"), SCANS, ids=[s[0] for s in SCANS])
def test_counts_and_the_same_bytes_written_back(
    realdata: RealData,
    tmp_path: Path,
    name: str,
    points: int,
    empty: int,
    reach: tuple[float, float] | None,
) -> None:
    path = realdata(f"lidar/{name}")
    frame = read_scan(path)
    assert (frame.num_points, frame.num_empty, frame.num_dropped) == (points, empty, 0)
    if reach is not None:
        distance = np.linalg.norm(frame.points.astype(np.float64), axis=1)
        assert (distance.min(), distance.max()) == pytest.approx(reach, abs=0.051)
    stored = lzma.decompress(path.read_bytes()) if path.suffix == ".xz" else path.read_bytes()
    back = tmp_path / path.name.removesuffix(".xz")
    frame.write(back)
    assert back.read_bytes() == stored


def test_a_scan_of_nuscenes_under_kitti_s_name(realdata: RealData, tmp_path: Path) -> None:
    """Its size is one of whole rows of four floats, too, of which none would be a point."""
    stored = realdata("lidar/other_sensors/nuscenes_hdl32e.pcd.bin")
    expected = read_scan(stored)
    path = tmp_path / "nuscenes.bin"
    path.write_bytes(stored.read_bytes())
    assert path.stat().st_size % 16 == 0
    frame = read_scan(path)
    assert np.array_equal(frame.points, expected.points)
    assert expected.ring is not None
    assert np.array_equal(frame.fields["column_5"], expected.ring)
    frame.write(tmp_path / "again.bin")
    assert (tmp_path / "again.bin").read_bytes() == stored.read_bytes()


def test_fields_of_the_real_scans(realdata: RealData) -> None:
    forest = read_scan(realdata("lidar/tls/riegl_vz400i_forest.ply.xz"))
    first = forest.fields["target_index"] == 1
    assert np.count_nonzero(first) == 983517
    pump = read_scan(realdata("lidar/tls/pump_room_e57.ply.xz"))
    assert (pump.fields["row"].max(), pump.fields["column"].max()) == (1073, 344)
    assert pump.intensity is not None


def test_poses_of_3dtk_bring_its_scans_together(realdata: RealData) -> None:
    """Positions and angles (R = Rx Ry Rz, as 3DTK's own EulerToMatrix4 has it) lead from a scan's
    coordinates to the common ones: walls meet, and with angles the other way round they do not."""
    frames = [read_scan(realdata(f"lidar/tls/3dtk_dat/scan00{i}.3d.xz")) for i in (1, 2)]
    poses = [frame.format.header["pose"] for frame in frames if frame.format is not None]
    clouds = [frame.points[np.linalg.norm(frame.points, axis=1) > 0.5] for frame in frames]

    def gap(inverted: bool) -> float:
        """Median distance from the planes of the other scan, metres."""
        turns = [pose[:3, :3].T if inverted else pose[:3, :3] for pose in poses]
        placed = [
            cloud.astype(np.float64) @ turn.T + pose[:3, 3]
            for cloud, turn, pose in zip(clouds, turns, poses, strict=True)
        ]
        tree = cKDTree(placed[0])
        patch = placed[0][tree.query(placed[0][::5], 12)[1]]
        middle = patch.mean(axis=1)
        spread, axes = np.linalg.eigh(
            np.einsum("mki,mkj->mij", patch - middle[:, None], patch - middle[:, None])
        )
        flat = spread[:, 0] < 0.02 * spread[:, 1]
        distance, nearest = cKDTree(middle[flat]).query(placed[1])
        near = distance < 0.2
        offset = placed[1][near] - middle[flat][nearest[near]]
        return float(
            np.median(np.abs(np.einsum("ij,ij->i", offset, axes[flat][nearest[near]][:, :, 0])))
        )

    right, wrong = gap(False), gap(True)
    assert right < 0.02
    assert wrong > 2.5 * right

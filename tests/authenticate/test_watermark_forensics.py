"""A watermark is no forgery: what `inspect` says of scans with one, with and without its record."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import lattice_scans as scans
from cave_scans import AHEAD, ball
from manip3d import InputError, LidarFrame, authenticate, report
from manip3d.authenticate import KeyFile, Watermarker, inspect
from manip3d.authenticate._carriers import ALLOWED, allowance, find_carrier, without_bits
from watermark_scans import grid_scan, key_file

LATTICE = scans.lattice()
EMBEDDINGS = ("lbm", "qim")


def street() -> LidarFrame:
    points = scans.scan(np.random.default_rng(5))
    reading = LATTICE.read(points)
    row = np.flatnonzero(reading.ring == 0)[100:101]  # something far
    beam = scans.beam_points(LATTICE, reading.ring[row], reading.count[row], np.full(1, 79.0))
    points[row] = scans.rounded(beam)
    return LidarFrame(points, scans.reflectances(points), origin=(0.0, 0.0, 0.0))


def with_moved_object(frame: LidarFrame, by: tuple[float, float, float]) -> LidarFrame:
    points = frame.points.copy()
    rows = np.all(np.abs(points - [12.0, 3.0, -0.9]) < [3.0, 1.0, 0.6], axis=1)
    assert np.count_nonzero(rows) > 30
    points[rows] = np.round((points[rows] + np.float32(by)) * 1000) / 1000
    return frame.replace(points=points)


@pytest.mark.parametrize("embedding", EMBEDDINGS)
def test_a_verified_watermark_is_allowed_for(embedding: str, key: KeyFile) -> None:
    sent = Watermarker(key, embedding=embedding).embed(street())
    bare = inspect(sent.frame, lattice=LATTICE)
    assert bare.verdict == "processed"
    assert [step.kind for step in bare.processing] == ["watermarked"]
    assert repr(embedding) in bare.reason
    assert {r.verdict for r in bare.detectors} == {"undecidable"}
    found = inspect(sent.frame, lattice=LATTICE, watermark=sent.record, key=key)
    assert (found.verdict, found.processing) == ("no_trace", ())
    assert [r.name for r in found.detectors] == [
        "density", "occlusion", "generic", "reflectance", "watermark",
    ]  # fmt: skip
    assert found.watermark is not None
    assert found.watermark.verdict == "authentic"
    assert found.record()["watermark"]["content"] == "intact"
    assert "suspected_rows" not in json.dumps(found.record())
    assert np.array_equal(found.scan.points, sent.points)
    assert found.power["moved"].share == 1.0
    same = inspect(sent.frame, lattice=LATTICE, watermark=found.watermark)
    assert same.record() == found.record()


def test_reflectances_that_were_judged_are_not_said_to_be_none(key: KeyFile) -> None:
    """The share of rewritten ones that is found was not measured in scans with a watermark."""
    sent = Watermarker(key).embed(street())
    found = inspect(sent.frame, lattice=LATTICE, watermark=sent.record, key=key)
    (judged,) = (each for each in found.detectors if each.name == "reflectance")
    assert (judged.verdict, dict(judged.power)) == ("no_trace", {})
    assert not any("the scan has none that can be judged" in name for name in found.blind)
    assert any("not measured in scans with a watermark" in note for note in found.power_notes)
    bare = inspect(street().replace(intensity=None), lattice=LATTICE)
    assert any("the scan has none that can be judged" in name for name in bare.blind)
    assert not any("watermark" in note for note in bare.power_notes)


@pytest.mark.parametrize(("units", "verdict"), [(2000, "no_trace"), (10_000, "no_trace"),
                                                (200, "processed")])  # fmt: skip
def test_a_watermark_on_another_grid_is_allowed_for(units: int, verdict: str, key: KeyFile) -> None:
    """A grid finer than the scanner's is no trace; a coarser one rounds the scan, and is named."""
    scan = street()
    points = np.round(scan.points.astype(np.float64) * units) / units
    signed = Watermarker(key, units_per_m=units).embed(scan.replace(points=np.float32(points)))
    found = inspect(signed.frame, lattice=LATTICE, watermark=signed.record, key=key)
    assert found.watermark is not None
    assert (found.watermark.verdict, found.watermark.units_per_m) == ("authentic", units)
    assert found.verdict == verdict
    if verdict == "processed":
        assert found.processing[0].kind == "rounded"
        assert found.processing[0].detail == "the watermark's grid has steps of 5 mm"


@pytest.mark.parametrize("embedding", EMBEDDINGS)
@pytest.mark.parametrize("by", [(0.05, 0.03, 0.0), (1.3, 0.7, 0.0)])
def test_what_was_moved_before_embedding_is_found(
    embedding: str, by: tuple[float, float, float], key: KeyFile
) -> None:
    forged = with_moved_object(street(), by)
    sent = Watermarker(key, embedding=embedding).embed(forged)
    found = inspect(sent.frame, lattice=LATTICE, watermark=sent.record, key=key)
    assert found.verdict == "tampered"
    assert found.accusing is not None
    assert found.accusing.name == "generic"
    assert found.watermark is not None
    assert found.watermark.content == "intact"
    center = found.regions[0].box.center
    assert np.hypot(center[0] - 12.0 - by[0], center[1] - 3.0 - by[1]) < 1.5


@pytest.mark.parametrize("embedding", ["lbm", "qim", "detached"])
def test_what_was_moved_after_embedding_is_the_watermarks_to_find(
    embedding: str, key: KeyFile, tmp_path: Path
) -> None:
    sent = Watermarker(key, embedding=embedding).embed(street())
    points = sent.points.copy()
    points[77, 1] += np.float32(1.0)
    found = inspect(
        sent.frame.replace(points=points), lattice=LATTICE, watermark=sent.record, key=key
    )
    assert found.verdict == "tampered"
    assert found.detectors[-1].verdict == "tampered"
    assert found.detectors[-1].regions
    assert not len(found.detectors[-1].suspected)  # which points: not for a forger's eyes
    assert found.reason.startswith("watermark: points or intensities of 1 of ")
    report.write_evidence(found, tmp_path / "found.json", source="scan")
    pytest.importorskip("matplotlib")
    report.write_evidence(found, tmp_path / "found.html", source="scan")
    assert "Keyed watermark" in (tmp_path / "found.html").read_text()


def test_regions_of_a_detector_are_shown_also_where_the_watermark_accuses(
    key: KeyFile, tmp_path: Path
) -> None:
    """The regions of the watermark have no rows, so that nothing could be drawn of them."""
    pytest.importorskip("matplotlib")
    sent = Watermarker(key, embedding="detached").embed(street())
    forged = with_moved_object(sent.frame, (1.3, 0.7, 0.0))
    found = inspect(forged, lattice=LATTICE, watermark=sent.record, key=key)
    accused = [each.name for each in found.detectors if each.verdict == "tampered"]
    assert accused == ["generic", "watermark"]
    assert found.accusing is not None
    assert found.accusing.name == "generic"
    report.write_evidence(found, tmp_path / "found.html", source="scan")
    assert "Regions of the accusing detector" in (tmp_path / "found.html").read_text()


def test_only_a_record_that_holds_is_allowed_for(key: KeyFile, tmp_path: Path) -> None:
    sent = Watermarker(key).embed(street())
    with KeyFile(key_file(tmp_path / "other", bytes(32))) as other:
        wrong = inspect(sent.frame, lattice=LATTICE, watermark=sent.record, key=other)
    damaged = bytes([sent.record[0] ^ 1]) + sent.record[1:]
    broken = inspect(sent.frame, lattice=LATTICE, watermark=damaged, key=key)
    unread = inspect(sent.frame, lattice=LATTICE, watermark=sent.record)
    for found in (wrong, broken, unread):
        assert found.verdict == "processed"
        assert [step.kind for step in found.processing] == ["watermarked"]
    assert wrong.watermark is not None
    assert wrong.watermark.verdict == "undecidable"
    assert unread.watermark is None


def test_results_of_other_scans_and_keys_without_records_are_refused(key: KeyFile) -> None:
    frame = LidarFrame(grid_scan())
    marker = Watermarker(key)
    sent = marker.embed(frame)
    found = marker.verify(sent.frame, sent.record)
    with pytest.raises(InputError, match="watermark: expected the result of this scan"):
        inspect(frame, watermark=found)
    with pytest.raises(InputError, match="key: can only be given with a watermark's record"):
        inspect(frame, key=key)
    with pytest.raises(InputError, match="watermark: expected bytes or WatermarkResult"):
        inspect(frame, watermark=12, key=key)  # type: ignore[arg-type]


def test_a_signed_frame_without_traces_is_judged_as_ever(key: KeyFile) -> None:
    """Detached watermarks move nothing; a scan of another kind is what it was."""
    sent = Watermarker(key, embedding="detached").embed(street())
    assert inspect(sent.frame, lattice=LATTICE, watermark=sent.record, key=key).verdict == (
        "no_trace"
    )
    cave = LidarFrame(np.concatenate([AHEAD, ball(0.6, 20_000) + np.float32([3, 1, 0])]))
    sent = Watermarker(key, embedding="detached").embed(cave)
    signed = inspect(sent.frame, origin=(0, 0, 0), watermark=sent.record, key=key)
    assert (signed.verdict, signed.accusing and signed.accusing.name) == ("tampered", "occlusion")


@pytest.mark.parametrize("embedding", ["lbm", "qim", "qim-printed"])
def test_traces_are_told_from_other_grids(embedding: str) -> None:
    points = grid_scan(6000)
    marked = authenticate.embed_paper(
        points, authenticate.noise_blocks(1), embedding=embedding
    ).frame.points
    assert find_carrier(marked) == embedding
    assert find_carrier(marked[np.random.default_rng(0).permutation(len(marked))[:2000]]) == (
        embedding
    )
    assert find_carrier(marked[:500]) is None  # too few to tell
    for plain in (
        points,
        np.round(points * 100) / 100,  # whole centimetres: all lowest bits are zeros
        np.round(points * 500) / 500,
        np.round(points * 200) / 200,
        np.round(points * 800) / 800 + np.float32(0.0003),
        np.random.default_rng(0).normal(0, 10, (6000, 3)),
        np.zeros((6000, 3)),
        points.astype(np.float16),
    ):
        assert find_carrier(plain.astype(np.float32)) is None


@pytest.mark.parametrize("embedding", EMBEDDINGS)
def test_the_allowance_is_what_the_embedding_can_have_moved(embedding: str) -> None:
    points = grid_scan(6000)
    marked = authenticate.embed_paper(
        points, authenticate.noise_blocks(1), embedding=embedding
    ).frame.points
    off = without_bits(marked, embedding).astype(np.float64) - points
    farthest = np.linalg.norm(off[np.any(points != 0, axis=1)], axis=1).max()
    allowed = ALLOWED[embedding].tolerance
    assert 0.75 * allowed < farthest <= allowed + 5e-6  # float32 at 30 m


@pytest.mark.parametrize("units", [200, 1000, 2000])
def test_the_allowance_is_in_steps_of_the_grid(units: int, key: KeyFile) -> None:
    points = (grid_scan(6000).astype(np.float64) * 1000 // 5 * 5 / 1000).astype(np.float32)
    marked = Watermarker(key, units_per_m=units).embed(points).frame.points
    assert find_carrier(marked, units) == "lbm"
    off = without_bits(marked, "lbm", units).astype(np.float64) - points
    farthest = np.linalg.norm(off[np.any(points != 0, axis=1)], axis=1).max()
    allowed = allowance("lbm", units).tolerance
    assert 0.75 * allowed < farthest <= allowed + 5e-6


def test_bits_cover_no_scan_that_was_forged_afterwards() -> None:
    """Points pasted into a watermarked scan are one tenth at most of what a trace may hide."""
    marked = authenticate.embed_paper(grid_scan(6000), authenticate.noise_blocks(1)).frame.points
    pasted = np.random.default_rng(1).normal(0, 1, (1000, 3)).astype(np.float32)
    assert find_carrier(np.concatenate([marked, pasted])) is None


@pytest.mark.parametrize("embedding", EMBEDDINGS)
def test_power_with_an_embedding(embedding: str) -> None:
    power = authenticate.measure_power([street()], LATTICE, planted=2, embedding=embedding)
    assert power["moved"].share == 1.0
    with pytest.raises(InputError, match="embedding: expected one of lbm, qim"):
        authenticate.measure_power([street()], LATTICE, embedding="noise")

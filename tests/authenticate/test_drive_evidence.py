"""Evidence that adds up over the frames of a drive."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from landmarks import assert_accessible
from manip3d import InputError, LidarFrame, authenticate, report
from manip3d._util.shares import binomial_tail, clopper_pearson, upper_limit, upper_rate
from manip3d.authenticate import DetectorReport, Inspection, drive_evidence, likelihood_ratio
from manip3d.authenticate._drives import share_with_alarms
from manip3d.authenticate._verdict import is_alarm
from manip3d.report._evidence_files import sha256_of_source

NOTHING = authenticate.inspect(LidarFrame(np.zeros((0, 3), np.float32)))


def frame(*p_values: float) -> Inspection:
    """An inspection whose detectors state these p-values."""
    reports = tuple(DetectorReport("generic", "no_trace", "", 0.0, p) for p in p_values)
    return replace(NOTHING, verdict="no_trace", detectors=reports)


def test_a_clean_frame_has_a_ratio_of_one_in_the_mean() -> None:
    """The mean over p-values that are evenly spread is the integral of 1 / (2 sqrt(p)): 1."""
    p_values = (np.arange(200_000) + 0.5) / 200_000
    mean = np.mean([likelihood_ratio(p) for p in p_values])
    assert 0.99 < mean <= 1.0
    assert likelihood_ratio(1.0) == 0.5
    assert likelihood_ratio(0.0025) == pytest.approx(10.0)


def test_a_frame_says_its_smallest_p_value_times_their_number() -> None:
    assert frame(0.5, 0.0004).likelihood_ratio == pytest.approx(0.5 / math.sqrt(0.0008))
    assert frame(0.9, 0.9).likelihood_ratio == 0.5
    assert frame().likelihood_ratio is None
    assert replace(frame(0.1), verdict="processed").likelihood_ratio is None


def test_clean_frames_of_unmeasured_scanners_take_evidence_back() -> None:
    """They are undecidable, since nobody knows what is found in them, but they were judged."""
    clean = replace(frame(0.9), verdict="undecidable")
    assert clean.likelihood_ratio == pytest.approx(0.5 / math.sqrt(0.9))
    accused_one = accused(0.002, "generic")  # a ratio of 11
    drive = ([clean] * 79 + [accused_one]) * 5
    found = drive_evidence(drive)
    assert (found.alarms, found.judged) == ((), 400)
    assert found.evidence[-1] == pytest.approx(math.log10(likelihood_ratio(0.002)))
    assert authenticate.verdict_of_drive(drive)[0] == "undecidable"


def test_weak_evidence_adds_up_and_clean_frames_take_it_back() -> None:
    weak, clean = frame(0.0025), frame(1.0)  # ratios 10 and 1/2
    found = drive_evidence([weak] * 4)
    np.testing.assert_allclose(found.evidence, [1.0, 2.0, 3.0, 4.0])
    assert found.threshold == pytest.approx(math.log10(36_000))
    assert (found.alarms, found.judged) == ((), 4)
    assert drive_evidence([weak] * 5).alarms == (4,)
    assert drive_evidence([weak] * 10).alarms == (4, 9)  # it starts anew
    mixed = drive_evidence([clean] * 50 + [weak] * 5)
    assert mixed.alarms == (54,)  # clean frames before leave no debt
    assert drive_evidence([weak, clean, clean, clean, clean] * 5).alarms == ()
    assert drive_evidence([None, NOTHING]).judged == 0


def test_the_rate_holds_for_frames_that_do_not_depend_on_each_other() -> None:
    """20 000 uniform p-values give at most 55 alarms, at a rate of one in 360 frames."""
    rng = np.random.default_rng(0)
    frames = [frame(p) for p in rng.random(20_000)]
    found = drive_evidence(frames, alarms_per_hour=100.0)
    assert len(found.alarms) <= 55
    assert "20000 frames" in found.statement


def test_the_bound_is_that_of_the_binomial_law() -> None:
    assert upper_rate(0, 100) == pytest.approx(1.0 - 0.05 ** (1.0 / 100.0))
    rate = upper_rate(2, 50)
    fewer = sum(math.comb(50, k) * rate**k * (1.0 - rate) ** (50 - k) for k in range(3))
    assert fewer == pytest.approx(0.05)
    assert upper_rate(5, 5) == 1.0
    pytest.importorskip("scipy")
    assert upper_limit(2, 50) == pytest.approx(rate, rel=1e-12)
    assert clopper_pearson(48, 50, 0.9)[0] == pytest.approx(1.0 - rate, rel=1e-12)


def test_a_drive_page_shows_the_p_value_that_accuses(tmp_path: Path) -> None:
    """Detector III states 0.002 at least, because no more clean scans tested it."""
    found, page = [accused(0.002, "generic", 7.0), accused(0.007)], tmp_path / "drive.html"
    report.write_drive_evidence(found, page, names=["a", "b"])
    text = page.read_text()
    top, scale = 38.0, 10.0  # pixels, and pixels per power of ten
    assert f'cy="{top - scale * math.log10(1.2e-6):.2f}" r="2.5"' in text
    assert f'cy="{top - scale * math.log10(0.007):.2f}" r="4.0"' in text
    assert "<td>0.002</td><td>1.2e-06</td>" in text
    assert "<td>0.007</td><td>0.007</td>" in text
    assert "detector III (p-value by its model of clean scans)" in text
    assert all(f"detector {number} (p-value" in text for number in ("III", "IV", "V"))
    record = found[0].record()
    assert (record["p_value"], record["model_p_value"]) == (0.002, pytest.approx(1.2e-6))
    assert record["detectors"]["generic"]["model_p_value"] == record["model_p_value"]
    assert found[1].record()["model_p_value"] == 0.007


def test_a_p_value_that_is_no_number_is_not_drawn_as_evidence(tmp_path: Path) -> None:
    page = tmp_path / "drive.html"
    unknown = [replace(each, verdict="undecidable") for each in (frame(math.nan), frame(1.0))]
    report.write_drive_evidence(unknown, page, names=["a", "b"])
    assert page.read_text().count('r="2.5"') == 1
    underflow = replace(frame(0.0), verdict="undecidable")
    report.write_drive_evidence([underflow], page, names=["a"])
    assert 'cy="158.00" r="2.5"' in page.read_text()  # lowest line of the plot, 1e-12 and below


def test_a_drive_page_shows_the_curve(tmp_path: Path) -> None:
    found = [frame(0.0025)] * 6
    page = tmp_path / "drive.html"
    report.write_drive_evidence(found, page, names=[str(k) for k in range(6)])
    text = page.read_text()
    assert "Evidence that adds up" in text
    assert "an alarm at frame 4" in text
    assert ">alarm: 10^" in text


def test_bad_rates_are_named() -> None:
    for name in ("alarms_per_hour", "frames_per_second"):
        with pytest.raises(InputError, match=name):
            drive_evidence([], **{name: 0.0})
    for rate in (36000.0, 1e6):  # each frame was an alarm, also those that nobody judged
        with pytest.raises(InputError, match="fewer than the 36000 frames of an hour, got"):
            drive_evidence([None], alarms_per_hour=rate)
    assert drive_evidence([None], alarms_per_hour=35999.0).alarms == ()
    with pytest.raises(InputError, match="p_value"):
        likelihood_ratio(2.0)


def accused(p_value: float, name: str = "turns", score: float = 1.0) -> Inspection:
    model = 12.0 * 10.0**-score if name == "generic" else None  # twelve tests in a scan
    report = DetectorReport(name, "tampered", "odd", score, p_value, model_p_value=model)
    return replace(NOTHING, verdict="tampered", detectors=(report,))


CLEAN = frame(1.0)
ODD = accused(0.007)


def test_a_drive_is_not_tampered_for_what_chance_explains() -> None:
    verdict, reason = authenticate.verdict_of_drive([CLEAN] * 50 + [ODD] + [CLEAN] * 49)
    assert verdict == "undecidable"
    assert reason.startswith("1 of 100 scans accused (number 50), which chance explains")
    assert "1.0 of the 100 that were judged" in reason
    assert authenticate.verdict_of_drive([CLEAN, ODD])[0] == "undecidable"
    assert authenticate.verdict_of_drive([ODD])[0] == "tampered"  # as the scan alone is
    processed = replace(NOTHING, verdict="processed")
    assert authenticate.verdict_of_drive([CLEAN] * 50 + [ODD, processed])[0] == "processed"


def test_more_episodes_than_chance_has_are_tampered() -> None:
    """Among 100 clean scans 5 episodes have a probability of 0.34 %, 4 of 1.8 %."""
    for episodes, verdict in ((4, "undecidable"), (5, "tampered")):
        drive = ([ODD] + [CLEAN] * 9) * episodes
        drive += [CLEAN] * (100 - len(drive))
        assert authenticate.verdict_of_drive(drive)[0] == verdict
    beside = [CLEAN] * 60 + [accused(0.01)] * 5 + [CLEAN] * 35  # one place, seen five times
    assert authenticate.verdict_of_drive(beside)[0] == "undecidable"
    assert binomial_tail(5, 100, 0.01) == pytest.approx(0.003432, abs=1e-6)


@pytest.mark.parametrize(
    ("least", "frames", "rate"),
    [(0, 5, 0.3), (2, 5, 0.3), (3, 400, 0.01), (12, 20, 1e-3), (0, 10, 0.5), (11, 10, 0.5)],
)
def test_the_tail_of_the_binomial_law(least: int, frames: int, rate: float) -> None:
    share = sum(
        math.comb(frames, n) * rate**n * (1.0 - rate) ** (frames - n)
        for n in range(least, frames + 1)
    )
    assert binomial_tail(least, frames, rate) == pytest.approx(share, rel=1e-9)


@pytest.mark.parametrize("name", ["density", "occlusion", "generic"])
def test_detectors_of_one_scan_accuse_each_scan_on_its_own(name: str) -> None:
    """Detectors I and II state no p-value: successive scans that they accuse add up here alone."""
    scan = replace(accused(0.01, name), detectors=(DetectorReport(name, "tampered", "", 1.0),))
    verdict, reason = authenticate.verdict_of_drive([scan] * 10)
    assert (verdict, "10 episodes are more than chance has" in reason) == ("tampered", True)
    both = replace(scan, detectors=(*scan.detectors, *ODD.detectors))
    assert authenticate.verdict_of_drive([CLEAN] * 60 + [both] * 5 + [CLEAN] * 35)[0] == "tampered"


@pytest.mark.parametrize("name", ["turns", "reflectance"])
def test_scans_of_other_places_are_episodes_of_their_own(name: str) -> None:
    drive = [CLEAN] * 60 + [accused(0.01, name)] * 5 + [CLEAN] * 35
    for step, verdict in ((1, "undecidable"), (2, "tampered")):
        numbers = range(7, 7 + 100 * step, step)
        assert authenticate.verdict_of_drive(drive, numbers)[0] == verdict
        assert authenticate.verdict_of_drive(drive, np.array(numbers))[0] == verdict
    with pytest.raises(InputError, match="numbers: expected 100, one for each scan, got 2"):
        authenticate.verdict_of_drive(drive, [1, 2])
    with pytest.raises(InputError, match="numbers: expected ints, got str"):
        authenticate.verdict_of_drive(drive, ["1"] * 100)


def test_the_page_of_a_drive_has_its_verdict(tmp_path: Path) -> None:
    drive, page = [accused(0.01)] * 5 + [CLEAN] * 95, tmp_path / "drive.html"
    names = [str(k) for k in range(100)]
    report.write_drive_evidence(drive, page, names=names)
    assert_accessible(page.read_text())
    assert "<h1 class=undecidable>" in page.read_text()
    report.write_drive_evidence(drive, page, names=names, numbers=range(0, 200, 2))
    assert "<h1 class=tampered>" in page.read_text()


def test_the_share_of_clean_drives_does_not_grow_with_their_length() -> None:
    drive = [accused(0.002, "generic", 12.0)] + [CLEAN] * 39_999
    assert "of clean drives as long 2.1% at most" in authenticate.verdict_of_drive(drive)[1]
    drive = [accused(1.0, "watermark")]
    assert "of clean drives" not in authenticate.verdict_of_drive(drive)[1]


def test_alarms_that_an_hour_has_by_chance_accuse_no_drive() -> None:
    """Five within an hour have a probability of 1 / 5! at most, six of 1 / 6!."""
    for alarms, verdict in ((4, "undecidable"), (5, "tampered")):
        drive = ([CLEAN] * 7000 + [accused(0.0011)] * 4) * alarms
        drive += [CLEAN] * (36_000 - len(drive))
        assert len(authenticate.drive_evidence(drive).alarms) == alarms
        assert authenticate.verdict_of_drive(drive)[0] == verdict


def test_the_law_of_alarms() -> None:
    """Times to an alarm that are even over an hour, drawn."""
    times = np.random.default_rng(0).uniform(0.0, 36_000.0, (200_000, 3)).cumsum(axis=1)
    for alarms, judged in ((1, 400), (2, 9_000), (3, 30_000)):
        share = float(np.mean(times[:, alarms - 1] < judged))
        assert share_with_alarms(alarms, judged) == pytest.approx(share, rel=0.1)
    assert share_with_alarms(0, 100) == share_with_alarms(1, 72_000) == 1.0


def test_a_single_strong_scan_makes_a_drive_tampered() -> None:
    rest = [CLEAN] * 9999
    for strong, words in (
        (accused(0.002, "generic", 9.0), "in number 5000, odd; of clean drives"),
        (accused(1.0, "watermark"), "the watermark of number 5000 does not hold"),
    ):
        drive = [*rest[:5000], strong, *rest[5000:]]
        verdict, reason = authenticate.verdict_of_drive(drive)
        assert (verdict, words in reason) == ("tampered", True)
    drive[5000] = accused(0.002, "generic", 7.0)  # one clean drive in 100 has one
    assert authenticate.verdict_of_drive(drive)[0] == "undecidable"


def test_evidence_that_adds_up_makes_a_drive_tampered() -> None:
    drive = [CLEAN] * 300 + [accused(0.0011)] * 4
    verdict, reason = authenticate.verdict_of_drive(drive)
    assert verdict == "tampered"
    assert "adds up to an alarm at number 303" in reason
    assert "of clean drives as long 1.9% at most" in reason


PROCESSED = replace(NOTHING, verdict="processed")


def test_scans_that_nobody_judged_excuse_no_accused_ones() -> None:
    """Four of seven are more than chance has (the binomial tail is 3.4e-7), whatever is beside."""
    odd = [accused(0.007), CLEAN] * 3 + [accused(0.007)]
    signed = replace(NOTHING, detectors=(DetectorReport("watermark", "no_trace", ""),))
    for junk in ([], [NOTHING] * 500 + [PROCESSED] * 496, [signed] * 993, [None] * 993):
        verdict, reason = authenticate.verdict_of_drive([*odd, *junk])
        assert (verdict, "4 episodes are more than chance has" in reason) == ("tampered", True)
        assert "of clean drives as long 1.1% at most" in reason
    clean = [CLEAN] * 400
    assert authenticate.verdict_of_drive([*odd, *clean])[0] == "undecidable"
    reason = authenticate.verdict_of_drive([*odd, *clean, *[NOTHING] * 500])[1]
    assert "4.1 of the 407 that were judged" in reason


def test_points_off_the_lattice_are_as_strong_in_a_drive_with_junk() -> None:
    """1e-7 times the kinds of evidence and 100 scans is below 0.1 %; times 10 000 it is not."""
    strong = accused(0.002, "generic", 7.0)
    drive = [strong] + [CLEAN] * 99
    assert authenticate.verdict_of_drive(drive)[0] == "tampered"
    assert authenticate.verdict_of_drive([*drive, *[NOTHING] * 10_000])[0] == "tampered"


@pytest.mark.parametrize("name", ["density", "occlusion"])
def test_detectors_without_a_p_value_have_the_stated_rate(name: str) -> None:
    """One of two judged scans is what 2 % of clean drives have; one of one is 1 %."""
    odd = replace(accused(0.01, name), detectors=(DetectorReport(name, "tampered", "", 1.0),))
    quiet = replace(NOTHING, verdict="no_trace", detectors=(DetectorReport(name, "no_trace", ""),))
    assert authenticate.verdict_of_drive([odd, quiet])[0] == "undecidable"
    assert authenticate.verdict_of_drive([odd, NOTHING])[0] == "tampered"
    assert authenticate.verdict_of_drive([odd, odd, quiet])[0] == "tampered"


def test_long_lists_of_accused_scans_are_cut() -> None:
    reason = authenticate.verdict_of_drive([ODD, CLEAN] * 15)[1]
    assert "15 of 30 scans accused (numbers 0, 2, 4, 6, 8, 10, 12, 14, 16, 18 and 5 more)" in reason


def test_no_scan_of_a_drive_is_left_out_for_want_of_a_number() -> None:
    """The last scans were not judged where there were fewer numbers than scans."""
    empty = LidarFrame(np.empty((0, 3), np.float32))
    found = authenticate.inspect_drive([empty] * 3, numbers=[7, 8])
    with pytest.raises(InputError, match="numbers: expected one for each frame, got 2"):
        list(found)
    assert len(list(authenticate.inspect_drive([empty] * 3, numbers=itertools.count()))) == 3


def test_no_scan_of_a_drive_is_left_out_for_want_of_a_record(tmp_path: Path) -> None:
    """The watermark of the last scans was not verified, and nobody said so."""
    empty = LidarFrame(np.empty((0, 3), np.float32))
    with authenticate.KeyFile.create(tmp_path / "sensor.key") as key:
        found = authenticate.inspect_drive([empty] * 3, records=[None, None], key=key)
        with pytest.raises(InputError, match="records: expected one for each frame, got 2"):
            list(found)
        assert len(list(authenticate.inspect_drive([empty] * 2, records=[None] * 2, key=key))) == 2


@pytest.mark.parametrize("source", ["a" * 300, "folder:" + "a" * 300, "bag:" + "a" * 300 + "#b"])
def test_a_source_too_long_for_a_path_is_no_file(tmp_path: Path, source: str) -> None:
    report.write_evidence(NOTHING, tmp_path / "page.html", source=source)
    assert "SHA-256" not in (tmp_path / "page.html").read_text()
    assert sha256_of_source(source) == ("", "")


@pytest.mark.parametrize("rate", [0.01, 0.001, 0.007, 0.002])
def test_the_last_bits_of_a_logarithm_do_not_decide_a_verdict(rate: float) -> None:
    """A p-value that equals the rate is an alarm on every processor."""
    log = math.log10(rate)
    for last_bits in (-1e-15, 0.0, 1e-15, 1e-12):
        assert is_alarm(log + last_bits, rate)
    assert not is_alarm(log + 1e-8, rate)

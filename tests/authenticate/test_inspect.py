"""`authenticate.inspect`: one result of all detectors, and how their verdicts combine."""

from __future__ import annotations

import json
import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from cave_scans import CAVE, ball
from manip3d import InputError, LidarFrame, authenticate, report
from manip3d.authenticate import DetectorReport, combined_verdict

FORGED = np.concatenate([CAVE, ball(0.6, 20_000) + np.float32([3, 1, 0])])


def test_every_combination_of_verdicts() -> None:
    words = ("authentic", "tampered", "undecidable")
    for density, occlusion, generic in product(words, repeat=3):
        reports = [
            DetectorReport(name, verdict, "")  # type: ignore[arg-type]
            for name, verdict in (
                ("density", density), ("occlusion", occlusion), ("generic", generic),
            )
        ]  # fmt: skip
        if occlusion == "undecidable":
            expected = "tampered" if generic == "tampered" else "undecidable"
        else:
            expected = "tampered" if "tampered" in (density, occlusion, generic) else "authentic"
        assert combined_verdict(reports) == expected


def test_a_clean_and_a_forged_scan() -> None:
    told: list[float] = []
    clean = authenticate.inspect(
        LidarFrame(CAVE), origin=(0, 0, 0), progress=lambda fraction, message: told.append(fraction)
    )
    assert clean.verdict == "authentic"
    assert clean.origin == (0.0, 0.0, 0.0)
    assert clean.origin_from == "argument"
    assert told == sorted(told)
    assert told[-1] == 1.0
    found = authenticate.inspect(FORGED, origin=(0, 0, 0))
    assert found.verdict == "tampered"
    assert found.num_points == len(FORGED)
    assert [report.name for report in found.detectors] == ["density", "occlusion", "generic"]
    occlusion = found.detectors[1]
    assert found.occlusion is not None
    assert occlusion.verdict == found.occlusion.verdict == "tampered"
    np.testing.assert_allclose(occlusion.boxes[0].center, (3, 1, 0), atol=0.1)
    assert (occlusion.suspected >= len(CAVE)).mean() > 0.95
    assert json.loads(json.dumps(found.record()))["detectors"]["occlusion"]["verdict"] == "tampered"


def test_a_scan_without_a_position_is_undecidable() -> None:
    found = authenticate.inspect(np.zeros((0, 3), np.float32))
    assert found.verdict == "undecidable"
    assert found.origin is None
    assert found.density is None
    assert {report.verdict for report in found.detectors} == {"undecidable"}
    assert found.detectors[0].reason == found.origin_from != ""


def test_a_bad_position_is_named() -> None:
    with pytest.raises(InputError, match="origin: expected three finite numbers"):
        authenticate.inspect(CAVE, origin=(0, 0))


def test_the_evidence_is_one_page_or_json(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    found = authenticate.inspect(FORGED, origin=(0, 0, 0))
    page, numbers = tmp_path / "evidence.html", tmp_path / "evidence.json"
    report.write_evidence(found, page, source="<b>cave</b>")
    text = page.read_text()
    assert text.count("data:image/png;base64,") == 2
    assert "&lt;b&gt;cave" in text
    assert "<b>cave" not in text
    loads = re.compile(r"""(src|href)\s*=\s*(["']|&quot;|&#x27;)?https?:""")
    assert not loads.search(text)  # it loads nothing
    report.write_evidence(found, numbers, source="cave")
    record = json.loads(numbers.read_text())
    assert record["source"] == "cave"
    assert record["verdict"] == "tampered"
    with pytest.raises(InputError, match="output: expected a name that ends in"):
        report.write_evidence(found, tmp_path / "evidence.pdf")

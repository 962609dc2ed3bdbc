"""Options and fixtures that every test may ask for."""

from __future__ import annotations

import gc
import json
import logging
import os
import re
import signal
from collections.abc import Callable, Generator, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

import real_data
from manip3d import Mesh, RenderError, datasets

# Seconds depend on what else runs; the same examples in every run.
settings.register_profile("ci", max_examples=200, deadline=None, derandomize=True)
settings.register_profile("nightly", max_examples=10_000, deadline=None)
settings.load_profile("ci")  # --hypothesis-profile=nightly chooses the other

# A shell that starts the tests in the background ignores Ctrl-C on behalf of all that they start.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Reasons for which a test may be skipped with CI=true: absent real data, extras that cannot be
# installed beside the others (pyproject.toml), makers' SDKs, and limits of the machine. All else
# is installed there.
MAY_BE_SKIPPED = re.compile(
    r"^(Skipped: )?MANIP3D_DATA |the extra '(ouster|pose)' is not installed|"
    r"\(peers\)|librealsense2 is absent|no maker's SDK is built in|strace may not trace here|"
    r"no mount namespaces here|no FFmpeg .* that stands alone"
)

NAMES_REAL_DATA = re.compile(r"\breal(data|_mesh)\b")
"""Pattern by which ``.ci/run`` selects files with tests of real data without loading them."""

GOLDEN = Path(__file__).parent / "golden" / "golden.json"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--update-golden",
        action="store_true",
        help="rewrite tests/golden/golden.json from this run, for review with git diff",
    )


@pytest.hookimpl(tryfirst=True)  # before -m chooses among the marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests that ask for real data ``realdata``, and those of a browser ``browser``.

    Tests of real data are skipped without MANIP3D_DATA. Files with slow tests come first, so that
    several workers end at about the same time.
    """
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)
    for item in items:
        if "realdata" in getattr(item, "fixturenames", ()):
            item.add_marker("realdata")
        if "chromium" in getattr(item, "fixturenames", ()):
            item.add_marker("browser")
        if real_data.ROOT is None and item.get_closest_marker("realdata"):
            item.add_marker(pytest.mark.skip(reason="MANIP3D_DATA is not set"))
    for path in {item.path for item in items if item.get_closest_marker("realdata")}:
        if not NAMES_REAL_DATA.search(path.read_text()):
            raise pytest.UsageError(f"{path}: .ci/run looks for {NAMES_REAL_DATA.pattern} in it")


def pytest_collection_finish() -> None:
    """Exempt the collected tests, which stay to the end, from garbage collection."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Hide real data from tests without the mark, which must pass on a machine without data.

    The log is as in a new process: commands and other libraries in tests before may have set it.
    """
    with pytest.MonkeyPatch.context() as patch:
        logger = logging.getLogger("manip3d")
        patch.setattr(logger, "handlers", [])
        patch.setattr(logger, "disabled", False)
        logger.setLevel(logging.NOTSET)
        logging.root.setLevel(logging.WARNING)
        logging.disable(logging.NOTSET)
        if not item.get_closest_marker("realdata"):
            patch.delenv("MANIP3D_DATA", raising=False)
        return (yield)


@pytest.fixture(scope="session")
def realdata() -> real_data.RealData:
    """Give ``realdata("lidar/tls/x.ply.xz") -> Path``; the test is skipped if it is absent."""
    return real_data.RealData()


@pytest.fixture(scope="session")
def bundle() -> None:
    """Skip where the viewer is not built."""
    from manip3d.viewer.page import BUNDLE

    if not BUNDLE.exists():
        pytest.skip("the viewer is not built: make setup")


@pytest.fixture(scope="session")
def live_page() -> None:
    """Skip where the page of live sessions is not built."""
    from manip3d.viewer.page import BUNDLE

    if not (BUNDLE.parent / "live.js").exists():
        pytest.skip("the page is not built: make setup")


@pytest.fixture(scope="session")
def chromium(bundle: None) -> None:
    """Skip where there is no browser or no page to show in it; ``-m browser`` chooses its tests."""
    from manip3d.viewer import _chromium

    pytest.importorskip("PIL.Image")
    try:
        _chromium.program()
    except RenderError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def real_mesh(realdata: real_data.RealData) -> Callable[[str], Mesh]:
    """Give ``real_mesh("rockerArm") -> Mesh`` of the registry; the test is skipped if absent."""

    def load(name: str) -> Mesh:
        realdata.needs(name)
        return datasets.load_mesh(name)

    return load


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    report = yield
    _fail_if_skipped_in_ci(report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if not hasattr(report, "wasxfail"):  # an expected failure is reported as skipped, too
        _fail_if_skipped_in_ci(report)
    return report


def _fail_if_skipped_in_ci(report: pytest.TestReport | pytest.CollectReport) -> None:
    """Fail a test that is skipped with CI=true for a reason that `MAY_BE_SKIPPED` lacks."""
    if os.environ.get("CI") != "true" or not isinstance(report.longrepr, tuple):
        return
    path, line, reason = report.longrepr
    if report.skipped and not MAY_BE_SKIPPED.search(reason):
        report.outcome = "failed"
        report.longrepr = f"{path}:{line}: {reason}: CI skips no such test"


@pytest.fixture
def golden(request: pytest.FixtureRequest) -> Callable[..., None]:
    """Compare a value with the one kept under its name; ``--update-golden`` keeps it instead."""

    def check(name: str, value: object, *, rel: float = 0.0) -> None:
        kept = json.loads(GOLDEN.read_text()) if GOLDEN.exists() else {}
        if request.config.getoption("--update-golden"):
            kept[name] = value
            GOLDEN.write_text(json.dumps(dict(sorted(kept.items())), indent=1) + "\n")
        assert value == (pytest.approx(kept[name], rel=rel, abs=0.0) if rel else kept[name])

    return check

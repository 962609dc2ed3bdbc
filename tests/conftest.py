"""Options and fixtures that every test may ask for."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

# Seconds depend on what else runs; the same examples in every run.
settings.register_profile("ci", max_examples=200, deadline=None, derandomize=True)
settings.register_profile("nightly", max_examples=10_000, deadline=None)
settings.load_profile("ci")  # --hypothesis-profile=nightly chooses the other

# A shell that starts the tests in the background ignores Ctrl-C on behalf of all that they start.
signal.signal(signal.SIGINT, signal.default_int_handler)

GOLDEN = Path(__file__).parent / "golden" / "golden.json"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--update-golden",
        action="store_true",
        help="rewrite tests/golden/golden.json from this run, for review with git diff",
    )


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

"""Modules of optional packages: absent, broken, or interrupted while they are imported."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import pytest

from manip3d._util import extras
from manip3d._util.extras import imported, require
from manip3d.errors import BrokenExtraError, MissingExtraError


def package_with(code: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Make a package with ``code`` importable, and return its name."""
    (folder / "imported_by_a_test.py").write_text(code, encoding="utf-8")
    monkeypatch.syspath_prepend(folder)
    sys.modules.pop("imported_by_a_test", None)  # of another test
    return "imported_by_a_test"


def test_an_absent_package_is_told_by_the_name_under_which_it_is_installed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(MissingExtraError, match=r"^opencv-python-headless is needed here: .*alert"):
        imported("cv2", "alert")


def test_several_extras_are_asked_for_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "_is_installed", lambda module: module == "PIL")
    with pytest.raises(MissingExtraError, match=r"^av, open3d-cpu are needed here") as told:
        require("video", "simulate")
    assert told.value.extra == "video,simulate"
    monkeypatch.setattr(extras, "_is_installed", lambda module: module != "av")
    with pytest.raises(MissingExtraError, match=r"^av is needed here: .*'manip3d\[video\]'"):
        require("video", "simulate")


def test_an_extra_that_no_package_serves_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.version_info", (3, 13, 0))
    assert "with Python 3.11 or 3.12" in str(MissingExtraError("mediapipe", "pose"))
    assert "3.12" not in str(MissingExtraError("pyvista", "viz"))


def test_a_package_whose_system_library_is_missing_is_not_called_absent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lacks = 'raise ImportError("libGL.so.1: cannot open shared object file")'
    name = package_with(lacks, tmp_path, monkeypatch)
    why = r"is installed but cannot be imported: libGL\.so\.1"
    with pytest.raises(BrokenExtraError, match=why) as told:
        imported(name, "viz")
    assert (told.value.package, told.value.extra) == (name, "viz")


def test_a_package_that_lacks_another_package_names_that_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = package_with("import nobody_has_this", tmp_path, monkeypatch)
    with pytest.raises(
        BrokenExtraError, match=r"cannot be imported: No module named 'nobody_has_this'"
    ):
        imported(name, "viz")


@pytest.mark.parametrize(
    "code",
    [
        "raise KeyboardInterrupt",
        "raise ImportError('initialization failed') from KeyboardInterrupt()",
        "try:\n    raise KeyboardInterrupt\nexcept BaseException:\n    raise ImportError('failed')",
        "raise ModuleNotFoundError(name='imported_by_a_test') from KeyboardInterrupt()",
    ],
)
def test_ctrl_c_during_an_import_stays_ctrl_c(
    code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = package_with(code, tmp_path, monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        imported(name, "simulate")


PRESS = "os.kill(os.getpid(), signal.SIGINT)"


def test_a_module_is_whole_when_ctrl_c_takes_effect(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Open3D that is imported in part cannot be imported again."""
    code = f"import os, signal\n{PRESS}\nis_whole = True"
    name = package_with(code, tmp_path, monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        imported(name, "simulate")
    assert imported(name, "simulate").is_whole
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_second_ctrl_c_during_an_import_takes_effect_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = f"import os, signal\n{PRESS}\n{PRESS}\nis_whole = True"
    name = package_with(code, tmp_path, monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        imported(name, "simulate")
    assert name not in sys.modules
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_signals_that_end_a_process_are_not_held(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = "import signal\nhandler = signal.getsignal(signal.SIGTERM)"
    name = package_with(code, tmp_path, monkeypatch)
    assert imported(name, "simulate").handler == signal.SIG_DFL

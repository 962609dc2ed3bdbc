"""Locks of folders that several threads create, lock and remove."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest

from manip3d._util import locks
from manip3d._util.locks import new_folder_locked


def test_a_new_folder_is_locked_and_removed(tmp_path: Path) -> None:
    place = tmp_path / "place"
    with new_folder_locked(place) as is_ours:
        assert is_ours
        with new_folder_locked(place) as is_second:
            assert not is_second
        assert place.is_dir()
    assert not place.exists()
    place.mkdir()
    (place / "kept").touch()
    with new_folder_locked(place) as is_ours:
        assert is_ours
    assert (place / "kept").exists()


def test_a_folder_that_its_holder_removes_before_it_is_locked_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place, lock_of = tmp_path / "place", locks._is_free
    removals = iter([True, True, False])

    def locked_late(descriptor: int) -> bool:
        if next(removals):
            place.rmdir()
        return lock_of(descriptor)

    monkeypatch.setattr(locks, "_is_free", locked_late)
    with new_folder_locked(place) as is_ours:
        assert is_ours
        assert place.is_dir()
        assert not list(removals)


def test_a_folder_has_one_holder_at_a_time(tmp_path: Path) -> None:
    place, holders, errors = tmp_path / "place", [0], []

    def lock_often() -> None:
        try:
            for _ in range(300):
                with new_folder_locked(place) as is_ours:
                    if is_ours:
                        os.close(os.open(place / "alone", os.O_CREAT | os.O_EXCL))
                        holders[0] += 1
                        (place / "alone").unlink()
        except OSError as error:
            errors.append(error)

    threads = [threading.Thread(target=lock_often) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not errors
    assert holders[0] > 0
    assert not place.exists()


def test_what_is_no_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    for name in ("file", "link", "missing/place"):
        with pytest.raises(OSError, match=name), new_folder_locked(tmp_path / name):
            pass

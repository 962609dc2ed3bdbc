"""The registry of data sets: found, checked, fetched; never a wrong byte, never silence."""

from __future__ import annotations

import hashlib
import http.server
import lzma
import os
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from manip3d import InputError, datasets
from manip3d.datasets import DataFile, DataSet

CONTENT = b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"


def digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def data_set(url: str = "", text: str = "") -> DataSet:
    packed = lzma.compress(CONTENT)
    file = DataFile(
        "toys/triangle.off.xz", len(packed), digest(packed), digest(CONTENT), url=url, text=text
    )
    return DataSet(
        "triangle", "A triangle", "mesh", (file,), "CC0", "nobody", "https://example.org"
    )


@pytest.fixture(autouse=True)
def _own_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MANIP3D_DATA", str(tmp_path / "data"))
    monkeypatch.setenv("MANIP3D_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("MANIP3D_OFFLINE", raising=False)
    (tmp_path / "data" / "toys").mkdir(parents=True)


@pytest.fixture
def server(tmp_path: Path) -> Iterator[str]:
    """An official home on this machine, serving the folder ``home``."""
    home = tmp_path / "home"
    home.mkdir()
    (home / "triangle.off").write_bytes(CONTENT)

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            pass

    handler = partial(Quiet, directory=str(home))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as httpd:
        threading.Thread(target=httpd.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{httpd.server_address[1]}"
        httpd.shutdown()


def test_the_registry_knows_the_24_meshes() -> None:
    known = datasets.registry()
    assert sum(one.kind == "mesh" for one in known.values()) == 24
    assert known["rockerArm"].facts["faces"] == 80354
    assert known["LeePerrySmith"].facts["vertices"] == 8844
    for one in known.values():
        assert one.licence
        assert one.page.startswith("https://")
        for file in one.files:
            assert len(file.sha256) == len(file.content_sha256) == 64
            assert not Path(file.path).is_absolute()
            assert ".." not in file.path


def test_every_stand_in_is_registered_and_names_itself() -> None:
    for stand_in in datasets.STAND_INS:
        datasets.get(datasets.source_of(stand_in.mesh))
        assert stand_in.cleaning in datasets.CLEANINGS
        if not stand_in.same_file:
            assert stand_in.role.startswith(("stand-in for", "beside"))
    labels = [stand_in.label for stand_in in datasets.STAND_INS]
    assert len(labels) == len(set(labels))


def test_names_are_found_in_any_case_and_similar_ones_are_named() -> None:
    assert datasets.get("ROCKERARM").name == "rockerArm"
    with pytest.raises(InputError, match=r"got 'rockerAm' .*rockerArm"):
        datasets.get("rockerAm")


def test_missing_data_says_how_to_get_it() -> None:
    with pytest.raises(datasets.DataMissingError, match="manip3d data get rockerArm"):
        datasets.load_mesh("rockerArm")
    assert not datasets.is_here(datasets.get("rockerArm"))


def test_unknown_cleaning_is_refused() -> None:
    from manip3d import Mesh

    mesh = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    with pytest.raises(InputError, match="cleaning: expected 'stored', 'welded'"):
        datasets.apply_cleaning(mesh, "washed")  # type: ignore[arg-type]


def test_wrong_bytes_are_refused(tmp_path: Path) -> None:
    file = data_set().files[0]
    path = tmp_path / "data" / file.path
    path.write_bytes(b"something else")
    with pytest.raises(datasets.ChecksumError, match="expected sha256"):
        datasets.require(file, "triangle")
    path.write_bytes(lzma.compress(CONTENT))
    assert datasets.require(file, "triangle") == path


def test_files_of_one_name_in_two_folders_have_their_own_checksums(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, content in (("x", b"aaaa"), ("y", b"bbbb")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "f").write_bytes(content)
        os.utime(tmp_path / name / "f", (0, 0))
        monkeypatch.chdir(tmp_path / name)
        assert datasets.file_sha256(Path("f")) == digest(content)
    (tmp_path / "y" / "f").write_bytes(b"cccc")
    os.utime(tmp_path / "y" / "f", (0, 0))
    assert datasets.file_sha256(Path("f")) == digest(b"cccc")


def test_a_plain_file_stands_for_the_compressed_one(tmp_path: Path) -> None:
    file = data_set().files[0]
    path = tmp_path / "data" / "toys" / "triangle.off"
    path.write_bytes(CONTENT)
    assert datasets.require(file, "triangle") == path
    path.write_bytes(CONTENT + b"\n")
    with pytest.raises(datasets.ChecksumError):
        datasets.require(file, "triangle")


def test_fetching_fills_the_cache(server: str, tmp_path: Path) -> None:
    one = data_set(url=f"{server}/triangle.off")
    seen: list[tuple[float, str]] = []
    paths = datasets.fetch(one, progress=lambda f, m: seen.append((f, m)))
    assert paths == [tmp_path / "cache" / "data" / "toys" / "triangle.off"]
    assert paths[0].read_bytes() == CONTENT
    assert seen == [(0.0, "toys/triangle.off")]
    assert datasets.is_here(one)
    assert datasets.fetch(one) == paths


def test_fetched_bytes_are_checked(server: str, tmp_path: Path) -> None:
    (tmp_path / "home" / "triangle.off").write_bytes(b"tampered")
    with pytest.raises(datasets.FetchError, match="could not be fetched"):
        datasets.fetch(data_set(url=f"{server}/triangle.off"))
    assert not datasets.is_here(data_set())


def test_a_home_that_does_not_answer_names_the_page() -> None:
    with pytest.raises(datasets.FetchError, match=r"https://example\.org"):
        datasets.fetch(data_set(url="http://127.0.0.1:9/triangle.off"))


def test_a_file_without_official_address_names_its_source() -> None:
    with pytest.raises(datasets.FetchError, match=r"no stable official address.*example.org"):
        datasets.fetch(data_set())


def test_offline_is_honoured(server: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MANIP3D_OFFLINE", "1")
    with pytest.raises(datasets.FetchError, match="MANIP3D_OFFLINE"):
        datasets.fetch(data_set(url=f"{server}/triangle.off"))


def test_files_that_exist_nowhere_else_are_written(tmp_path: Path) -> None:
    mtl = next(f for f in datasets.get("LeePerrySmith").files if f.text)
    assert digest(mtl.text.encode()) == mtl.sha256
    one = DataSet("mtl", "", "mesh", (mtl,), "", "", "")
    assert datasets.fetch(one)[0].read_text() == mtl.text


def test_provenance_names_licence_and_origin() -> None:
    record = datasets.provenance("BAe-125-uv")
    assert record["name"] == "BAe-125"
    assert "GPL" in record["licence"]
    assert record["files"] == {}

"""Outputs that a command cannot write are refused in one line, before anything is read or made."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import rgbd_frames
from command_line import error_line, manip3d
from manip3d import InputError, capture
from manip3d._util.paths import refuse_existing
from manip3d.capture._rgbd_record import is_file_of_recording
from manip3d.cli.terminal import check_place, naming_options, with_force


def folder_of_others(place: Path, *names: str) -> Path:
    place.mkdir()
    for name in names:
        (place / name).write_text("mine")
    return place


def test_files_of_others_are_told_before_force_is_offered(tmp_path: Path) -> None:
    place = folder_of_others(tmp_path / "frames", "d.glb", "a.glb", "c.glb", "b.glb", "ours")
    for force in (False, True):
        with pytest.raises(InputError) as told:
            check_place(place, force=force, is_ours=lambda name: name == "ours")
        assert str(told.value) == (
            f"-o {place}: holds other files (a.glb, b.glb, c.glb, ...); give another folder"
        )
    with pytest.raises(InputError, match=r"-o .*frames: exists already; --force replaces it"):
        check_place(place, force=False, is_ours=lambda name: True)
    with pytest.raises(InputError, match=r"KEY .*frames: exists already; give another name"):
        check_place(place, force=None, option="KEY")


@pytest.mark.parametrize("force", [(), ("--force",)])
def test_a_folder_in_the_place_of_a_file_is_told_and_no_force_offered(
    force: tuple[str, ...], tmp_path: Path
) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (place := tmp_path / "folder.ply").mkdir()
    done = manip3d("simplify", tmp_path / "a.obj", "--ratio", "0.5", "-o", place, *force)
    assert f"-o {place}: expected the name of a file, got a folder" in error_line(done)


@pytest.mark.parametrize(
    "words",
    [
        ("lod", "a.obj"),
        ("simulate", "sim:street", "--no-pictures"),
        ("phantom", "render", "sim:body?frames=2", "--limb", "left-arm"),
        ("study", "results", "answers"),
        ("diary", "export", "study.diary"),
        ("diary", "export", "study.diary", "--pages"),
        ("diary", "clips", "study.diary", "P01"),
    ],
    ids=lambda words: "-".join(words[:2]),
)
def test_the_current_folder_is_not_replaced_as_a_whole(
    words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    monkeypatch.chdir(folder_of_others(tmp_path / "here"))
    given = [f"../{word}" if word == "a.obj" else word for word in words]
    for force in ([], ["--force"]):
        told = error_line(manip3d(*given, "-o", ".", *force))
        assert "-o .: expected another folder than the current one or one above it" in told
    assert (tmp_path / "here").samefile(".")


def test_a_recording_may_be_made_in_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    capture.record(list(rgbd_frames.frames(2)), tmp_path / "walk.mkv")
    monkeypatch.chdir(folder_of_others(tmp_path / "here"))
    done = manip3d("capture", "record", "../walk.mkv", "-o", ".", "--force")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "here" / "frames.jsonl").samefile("frames.jsonl")


@pytest.mark.parametrize(
    "words",
    [
        ("lod", "a.obj"),
        ("simulate", "sim:street"),
        ("convert", "a.xyz"),
        ("phantom", "render", "sim:body?frames=2", "--limb", "left-arm"),
        ("capture", "record", "sim:body?frames=2"),
        ("capture", "play", "sim:body?frames=2"),
        ("simplify", "meshes", "--ratio", "0.5"),
        ("study", "results", "answers"),
        ("study", "simulate", "study.toml"),
        ("diary", "export", "study.diary"),
        ("watermark", "embed", "meshes", "--key", "sensor.key"),
    ],
    ids=lambda words: "-".join(words[:2]),
)
def test_a_file_in_the_place_of_a_folder_is_told_and_no_force_offered(
    words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    mesh = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    folder_of_others(tmp_path / "meshes")
    for name in ("a.obj", "meshes/a.obj", "meshes/b.obj"):
        (tmp_path / name).write_text(mesh)
    for name in ("a.xyz", "meshes/a.xyz"):
        (tmp_path / name).write_text("1 2 3\n4 5 6\n")
    manip3d("study", "define", "display", "-o", "study.toml", "--example")
    (tmp_path / "file").write_text("mine")
    assert "-o file: expected a folder, got a file" in error_line(manip3d(*words, "-o", "file"))
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize("scheme", ["", "folder:", "tum:"])
def test_what_a_recorder_replaces_is_judged_as_the_recorder_does(
    scheme: str, tmp_path: Path
) -> None:
    place, frames = tmp_path / "walk", list(rgbd_frames.frames(2))
    is_tum = scheme == "tum:"
    capture.record(frames, f"{scheme}{place}")
    names = sorted(path.name for path in place.iterdir())
    assert all(is_file_of_recording(place, name, is_tum=is_tum) for name in names), names
    (place / "notes.txt").write_text("mine")
    assert not is_file_of_recording(place, "notes.txt", is_tum=is_tum)
    assert not is_file_of_recording(place, "notes.txt", is_tum=not is_tum)
    with pytest.raises(InputError, match="which holds more than a recording"):
        capture.record(frames, f"{scheme}{place}", overwrite=True)
    (place / "notes.txt").unlink()
    assert capture.record(frames, f"{scheme}{place}", overwrite=True).frames == 2
    (place / "calibration.json").unlink()  # images without it are another program's
    assert not is_file_of_recording(place, "depth", is_tum=is_tum)
    with pytest.raises(InputError, match="which holds files"):
        capture.record(frames, f"{scheme}{place}", overwrite=True)


@pytest.mark.parametrize("force", [[], ["--force"]])
@pytest.mark.parametrize("verb", [["capture", "record"], ["forge", "stream", "--type", "1"]])
def test_a_folder_that_is_no_recording_is_told_before_the_source_is_opened(
    verb: list[str], force: list[str], tmp_path: Path
) -> None:
    place = folder_of_others(tmp_path / "frames", "000000.glb")
    done = manip3d(*verb, tmp_path / "absent.mkv", "-o", place, *force)
    assert f"-o {place}: holds other files (000000.glb); give another" in error_line(done)


def test_a_drive_replaces_only_drives(tmp_path: Path) -> None:
    place = folder_of_others(tmp_path / "mine", "notes.txt")
    words = ("simulate", "sim:street", "--frames", "1", "--no-pictures", "-o", place)
    for force in ([], ["--force"]):
        told = error_line(manip3d(*words, *force))
        assert f"-o {place}: holds other files (notes.txt); give another folder" in told
    (place / "notes.txt").unlink()
    (place / "2000_01_01").mkdir()
    assert error_line(manip3d(*words)).endswith(f"-o {place}: exists already; --force replaces it")


def test_pictures_of_frames_replace_no_folder_with_other_files(tmp_path: Path) -> None:
    place = folder_of_others(tmp_path / "mine", "000007.png", "notes.txt")
    play = ("capture", "play", "sim:body?frames=2", "--speed", "0", "-o", place)
    for force in ([], ["--force"]):
        told = error_line(manip3d(*play, *force))
        assert f"-o {place}: holds other files (notes.txt); give another folder" in told
    assert sorted(path.name for path in place.iterdir()) == ["000007.png", "notes.txt"]
    (place / "notes.txt").unlink()
    done = manip3d(*play, "--force")
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in place.iterdir()) == ["000000.png", "000001.png"]


def test_only_an_empty_folder_or_that_of_a_study_gets_answers(tmp_path: Path) -> None:
    definition = tmp_path / "study.toml"
    manip3d("study", "define", "display", "-o", definition, "--example")
    place = folder_of_others(tmp_path / "frames", "000000.glb")
    for verb in (["simulate"], ["display", "--no-open", "--seconds", "1"]):
        told = error_line(manip3d("study", *verb, definition, "-o", place))
        assert "holds other files (000000.glb); give another folder" in told
        told = error_line(manip3d("study", *verb, definition, "-o", tmp_path / "no" / "answers"))
        assert f"there is no folder {tmp_path / 'no'}" in told
    assert [path.name for path in place.iterdir()] == ["000000.glb"]
    (place / "000000.glb").unlink()
    simulate = ("study", "simulate", definition, "-o", place, "--participants", "1", "-q")
    assert manip3d(*simulate).returncode == 0
    (place / "notes.txt").write_text("of the study")
    assert manip3d(*simulate).returncode == 0


@pytest.mark.parametrize(
    "words",
    [
        ("simplify", "SCANS", "--ratio", "0.5", "-o", "no/such/out"),
        ("info", "SCANS", "--table", "no/such/table.csv"),
        ("simulate", "sim:airplane", "-o", "no/such/plane.obj"),
        ("study", "define", "rating", "-o", "no/such/study.toml"),
        ("watermark", "keygen", "no/such/sensor.key"),
    ],
)
def test_a_missing_parent_is_told_and_not_made(words: tuple[str, ...], tmp_path: Path) -> None:
    mesh = folder_of_others(tmp_path / "meshes") / "a.obj"
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    places = {"SCANS": str(mesh.parent)}
    given = [places.get(word, word.replace("no/", f"{tmp_path}/no/")) for word in words]
    assert f"there is no folder {tmp_path / 'no' / 'such'}" in error_line(manip3d(*given))
    assert not (tmp_path / "no").exists()


def test_several_files_are_written_to_a_url(tmp_path: Path) -> None:
    meshes = folder_of_others(tmp_path / "meshes")
    for name in ("a.obj", "b.obj"):
        (meshes / name).write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    done = manip3d("convert", meshes, "--to", ".ply", "-o", f"file://{tmp_path}/new/out")
    assert done.returncode == 0, done.stderr
    assert {path.name for path in (tmp_path / "new" / "out").glob("*.ply")} == {"a.ply", "b.ply"}
    done = manip3d("convert", meshes, "-o", f"file://{tmp_path}/all.ply")
    assert "/all.ply: expected a folder for the files of" in error_line(done)


def test_a_table_may_be_in_the_folder_that_the_outputs_make(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    meshes = folder_of_others(tmp_path / "meshes")
    (meshes / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    monkeypatch.chdir(tmp_path)
    table = tmp_path / "new" / "rows.csv"
    done = manip3d("convert", meshes, "--to", ".ply", "-o", "new", "--table", table)
    assert done.returncode == 0, done.stderr
    assert table.is_file()


def test_errors_of_the_library_name_options_of_the_command_only(tmp_path: Path) -> None:
    for told in ("overwrite=True", "replace=True", "--force (overwrite=True)"):
        assert with_force(f"{told} replaces it") == "--force replaces it"
    new = tmp_path / "new.csv"
    refuse_existing(new, overwrite=False)
    new.touch()
    refuse_existing(new, overwrite=True)
    for option in ("overwrite", "replace"):
        with pytest.raises(InputError) as refused:
            refuse_existing(new, overwrite=False, name="output", option=option)
        assert str(refused.value) == f"output: {new} exists already; {option}=True replaces it"
    with (
        pytest.raises(InputError, match=r"^-o: expected another file"),
        naming_options("output", path="output"),
    ):
        raise InputError("path: expected another file")
    table = tmp_path / "t.csv"
    table.write_text("mine")
    mesh = tmp_path / "a.obj"
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    done = manip3d("info", mesh, "--table", table, "--json")
    assert error_line(done).endswith("t.csv: exists already; --force replaces it")
    assert json.loads(done.stdout)["error"]["message"].endswith("--force replaces it")


def test_an_empty_source_is_told_by_the_verb_that_was_called(tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    empty.touch()
    done = manip3d("forge", "stream", empty, "--type", "1", "-o", tmp_path / "out")
    assert "forge stream takes an RGB-D recording" in error_line(done)

"""Writers: attributes come back, and a stopped or refused write leaves the old file whole."""

from __future__ import annotations

import errno
import os
import resource
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from concurrent.futures import ThreadPoolExecutor
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import manip3d
from manip3d import InputError, io
from manip3d.io._files import atomic_folder, atomic_pair, atomic_path, atomic_write, write_new

SUFFIXES = ["obj", "ply", "off", "stl"]


def grid(n: int, value: float = 0.0) -> manip3d.Mesh:
    """A square of 2 (n - 1)^2 triangles, all at height ``value``."""
    x, y = np.meshgrid(np.arange(n), np.arange(n))
    vertices = np.column_stack([x.ravel(), y.ravel(), np.full(n * n, value)])
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate(
        [np.column_stack([a, a + 1, a + n + 1]), np.column_stack([a, a + n + 1, a + n])]
    )
    return manip3d.Mesh(vertices, faces)


@st.composite
def meshes(draw: st.DrawFn) -> manip3d.Mesh:
    """Small meshes with any of the attributes."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    num_vertices, num_faces = draw(st.integers(1, 8)), draw(st.integers(0, 6))
    scale = draw(st.sampled_from([1.0, 1e-300, 1e9, 1e-9]))
    single = draw(st.booleans())
    vertices = rng.normal(size=(num_vertices, 3)) * scale
    if single:
        vertices = vertices.astype(np.float32).astype(float)
    faces = rng.integers(0, num_vertices, (num_faces, 3))
    more: dict[str, object] = {}
    if draw(st.booleans()):
        more["texcoords"] = rng.normal(size=(5, 2)).astype(np.float32)
        more["face_texcoords"] = np.where(
            rng.random((num_faces, 1)) < 0.3, -1, rng.integers(0, 5, (num_faces, 3))
        )
    if draw(st.booleans()):
        more["colors"] = rng.integers(0, 256, (num_vertices, 3), dtype=np.uint8)
    if draw(st.booleans()):
        more["normals"] = rng.normal(size=(num_vertices, 3))
        more["face_normals"] = faces
    if draw(st.booleans()):
        more["materials"] = [manip3d.Material(n, (0.1, 0.2, 0.3, 0.4)) for n in ("a", "b c", "a")]
        more["face_material"] = rng.integers(-1, 3, num_faces)
    return manip3d.Mesh(vertices, faces, **more)  # type: ignore[arg-type]


def corners(table: np.ndarray | None, index: np.ndarray | None) -> list[object]:
    """Attribute values of each corner; None where there is none."""
    if table is None or index is None:
        return []
    return [[tuple(table[i]) if i >= 0 else None for i in row] for row in index]


def same_corners(a: list[object], b: list[object]) -> bool:
    """Equal, where no attribute at all is as good as none on every corner."""
    empty = [None, None, None]
    return a == b or all(row == empty for row in [*a, *b])


@given(mesh=meshes(), suffix=st.sampled_from(["obj", "ply", "obj.gz", "ply.xz"]))
def test_round_trip(
    tmp_path_factory: pytest.TempPathFactory, mesh: manip3d.Mesh, suffix: str
) -> None:
    path = tmp_path_factory.mktemp("m") / f"m.{suffix}"
    mesh.write(path)
    back = manip3d.read_mesh(path)
    np.testing.assert_array_equal(back.vertices, mesh.vertices)
    np.testing.assert_array_equal(back.faces, mesh.faces)
    assert same_corners(
        corners(back.texcoords, back.face_texcoords), corners(mesh.texcoords, mesh.face_texcoords)
    )
    assert same_corners(
        corners(back.normals, back.face_normals), corners(mesh.normals, mesh.face_normals)
    )
    assert (back.colors is None) == (mesh.colors is None)
    if mesh.colors is not None:
        np.testing.assert_array_equal(back.colors, mesh.colors)
    names = ["a", "b c", "a_2" if "obj" in suffix else "a"]
    if mesh.face_material is not None:
        indices = [-1] * mesh.num_faces if back.face_material is None else back.face_material
        got = [back.materials[i].name if i >= 0 else None for i in indices]
        assert got == [names[i] if i >= 0 else None for i in mesh.face_material]
        if "obj" in suffix:
            # The alpha of an opaque material is ignored, and an OBJ file would show it.
            assert {m.base_color for m in back.materials} <= {(0.1, 0.2, 0.3, 1.0)}


@given(mesh=meshes(), suffix=st.sampled_from(["off", "stl", "stl.gz"]))
def test_round_trip_of_positions(
    tmp_path_factory: pytest.TempPathFactory, mesh: manip3d.Mesh, suffix: str
) -> None:
    path = tmp_path_factory.mktemp("m") / f"m.{suffix}"
    mesh.write(path)
    back = manip3d.read_mesh(path)
    expected = mesh.vertices[mesh.faces]
    if "stl" in suffix:
        expected = expected.astype(np.float32).astype(float)
        assert len(np.unique(back.vertices, axis=0)) == back.num_vertices
    else:
        np.testing.assert_array_equal(back.faces, mesh.faces)
    np.testing.assert_array_equal(back.vertices[back.faces], expected)


@pytest.mark.parametrize("suffix", [*SUFFIXES, "obj.gz", "ply.xz"])
def test_writing_twice_gives_the_same_bytes(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"m.{suffix}"
    grid(5, 0.1).write(path)
    first = path.read_bytes()
    time.sleep(0.01)
    grid(5, 0.1).write(path)
    assert path.read_bytes() == first
    assert os.listdir(tmp_path) == [path.name]


def textured(folder: Path, content: bytes) -> manip3d.Mesh:
    folder.mkdir()
    (folder / "t.png").write_bytes(content)
    (folder / "m.mtl").write_text("newmtl a\nmap_Kd t.png\n")
    (folder / "m.obj").write_text(
        "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl a\nf 1/1 2/1 3/1\n"
    )
    return manip3d.read_mesh(folder / "m.obj")


@pytest.mark.parametrize("name", ["Stra\u00dfe", "\u65e5\u672c 100%", "50%", "a%41", "tab\there"])
def test_the_header_of_a_ply_is_ascii_whatever_its_materials_are_called(
    tmp_path: Path, name: str
) -> None:
    picture = manip3d.Texture("pictures/Stra\u00dfe.png", b"\x89PNG\r\n\x1a\n")
    materials = [manip3d.Material(name, textures={"base_color": picture}), manip3d.Material("b")]
    mesh = grid(2)
    mesh = mesh.replace(face_material=np.array([0, 1], np.int32), materials=materials)
    mesh.write(tmp_path / "m.ply")
    header = (tmp_path / "m.ply").read_bytes().split(b"end_header")[0]
    assert header.isascii()
    back = manip3d.read_mesh(tmp_path / "m.ply")
    assert [m.name for m in back.materials] == [name.replace("\t", "_"), "b"]
    assert back.materials[0].textures["base_color"].path == "Stra_e.png"
    assert (tmp_path / "Stra_e.png").read_bytes() == picture.data


@pytest.mark.parametrize("suffix", ["obj", "ply"])
def test_textures_are_copied_and_never_replace_another_file(tmp_path: Path, suffix: str) -> None:
    out = tmp_path / "out"
    out.mkdir()
    for name, content in (("a", b"one"), ("b", b"two"), ("c", b"one")):
        mesh = textured(tmp_path / name, content)
        mesh.write(out / f"{name}.{suffix}")
    for name, content in (("a", b"one"), ("b", b"two"), ("c", b"one")):
        mesh = manip3d.read_mesh(out / f"{name}.{suffix}")
        found = io.texture_path(mesh, mesh.materials[0].textures["base_color"])
        assert found is not None
        assert found.read_bytes() == content
    assert len(list(out.glob("*.png"))) == 2


def test_old_obj_stays_valid_when_a_new_one_is_not_finished(tmp_path: Path) -> None:
    mesh = textured(tmp_path / "a", b"one")
    (tmp_path / "out").mkdir()
    path = tmp_path / "out" / "m.obj"
    mesh.write(path)
    old = path.read_bytes()
    textured(tmp_path / "b", b"two").replace(materials=[manip3d.Material("other")]).write(path)
    path.write_bytes(old)  # as if the last rename had not happened
    back = manip3d.read_mesh(path)
    found = io.texture_path(back, back.materials[0].textures["base_color"])
    assert found is not None
    assert found.read_bytes() == b"one"


def test_embedded_and_missing_textures(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    material = manip3d.Material("a/b", textures={"base_color": manip3d.Texture(None, b"\x89PNG")})
    mesh = grid(2).replace(face_material=[0, 0], materials=[material])
    mesh.write(tmp_path / "m.obj")
    back = manip3d.read_mesh(tmp_path / "m.obj")
    found = io.texture_path(back, back.materials[0].textures["base_color"])
    assert found is not None
    assert found.read_bytes() == b"\x89PNG"
    gone = manip3d.Material("g", textures={"base_color": manip3d.Texture("gone.png")})
    mesh.replace(materials=[gone], source=str(tmp_path / "m.obj")).write(tmp_path / "n.obj")
    assert "texture 'gone.png' not found" in caplog.text


def test_refusals_are_os_errors_with_the_name(tmp_path: Path) -> None:
    path = tmp_path / "none" / "m.ply"
    with pytest.raises(FileNotFoundError) as caught:
        grid(2).write(path)
    assert caught.value.filename == str(path)
    with pytest.raises(FileNotFoundError) as caught:
        atomic_write(path, b"")
    assert caught.value.filename == str(path)
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(IsADirectoryError):
        grid(2).write(tmp_path / "folder.ply")
    assert os.listdir(tmp_path / "folder.ply") == []


def test_links_modes_and_pipes(tmp_path: Path) -> None:
    (tmp_path / "real.ply").write_bytes(b"old")
    (tmp_path / "real.ply").chmod(0o640)
    (tmp_path / "link.ply").symlink_to("real.ply")
    grid(2).write(tmp_path / "link.ply")
    assert (tmp_path / "link.ply").is_symlink()
    assert manip3d.read_mesh(tmp_path / "real.ply").num_faces == 2
    assert (tmp_path / "real.ply").stat().st_mode & 0o777 == 0o640
    atomic_write(tmp_path / "link.ply", "text")
    assert (tmp_path / "link.ply").is_symlink()
    assert (tmp_path / "real.ply").read_text() == "text"
    mask = os.umask(0o027)
    try:
        grid(2).write(tmp_path / "new.ply")
        atomic_write(tmp_path / "new.txt", "x")
    finally:
        os.umask(mask)
    assert (tmp_path / "new.ply").stat().st_mode & 0o777 == 0o640
    assert (tmp_path / "new.txt").stat().st_mode & 0o777 == 0o640
    os.mkfifo(tmp_path / "pipe.off")
    with subprocess.Popen(["cat", tmp_path / "pipe.off"], stdout=subprocess.PIPE) as reader:
        grid(2).write(tmp_path / "pipe.off")
        data, _ = reader.communicate()
    assert io.read_mesh_bytes(data).num_faces == 2


def test_atomic_path_leaves_nothing_when_the_block_raises(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(UnicodeEncodeError), atomic_path(target) as temporary:
        temporary.write_text("\udc80 cannot be encoded", encoding="utf-8")
    assert target.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]


def start_writer(meshes: list[manip3d.Mesh], path: Path) -> int:
    """Write meshes in turn in a child until it is killed; return its number."""
    child = os.fork()
    if child == 0:
        try:
            while True:
                for mesh in meshes:
                    mesh.write(path)
        finally:
            os._exit(1)
    return child


def test_kill_leaves_the_old_or_the_new_file(tmp_path: Path) -> None:
    meshes = [grid(60, 1.0), grid(90, 2.0)]
    out = tmp_path / "out"
    out.mkdir()
    rng = np.random.default_rng(0)
    wanted = {mesh.num_faces for mesh in meshes}
    for kill in range(30):  # tests/reliability/killed_writers.py kills more of them
        path = out / f"m.{[*SUFFIXES, 'obj.gz'][kill % 5]}"
        meshes[0].write(path)
        writer = start_writer(meshes, path)
        time.sleep(rng.uniform(0.0, 0.05))
        os.kill(writer, signal.SIGKILL)
        _, status = os.waitpid(writer, 0)
        assert os.WIFSIGNALED(status), "the writer ended by itself"
        assert manip3d.read_mesh(path).num_faces in wanted


def limited_write(path: Path, limit: int) -> OSError | None:
    """Write a mesh in a child that may write files of at most ``limit`` bytes."""
    child = os.fork()
    if child == 0:
        code = 0
        try:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
            grid(60, 2.0).write(path)
        except OSError as error:
            code = error.errno or 255
        except BaseException:
            code = 255
        os._exit(code)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return OSError(code, os.strerror(code)) if code else None


@pytest.mark.parametrize("suffix", [*SUFFIXES, "obj.gz", "ply.xz"])
def test_a_refused_write_leaves_the_old_file_and_no_litter(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"m.{suffix}"
    old = grid(3, 1.0)
    old.write(path)
    content = path.read_bytes()
    for limit in (0, 1, 100, 1000):
        error = limited_write(path, limit)
        assert error is not None
        assert error.errno == errno.EFBIG
        assert path.read_bytes() == content
        assert os.listdir(tmp_path) == [path.name]
    assert limited_write(path, 1 << 24) is None
    assert manip3d.read_mesh(path).num_faces == 2 * 59 * 59


FULL_DISK = textwrap.dedent(
    """
    import errno, os, sys
    import numpy as np
    import manip3d
    small = manip3d.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    large = manip3d.Mesh(np.random.default_rng(0).random((9000, 3)), [[0, 1, 2]] * 9000)
    folder = sys.argv[1]
    for suffix in ("obj", "ply", "off", "stl", "obj.gz", "ply.xz"):
        path = os.path.join(folder, "m." + suffix)
        small.write(path)
        before = open(path, "rb").read()
        try:
            large.write(path)
        except OSError as error:
            assert (error.errno, error.filename) == (errno.ENOSPC, path), error
        else:
            raise AssertionError("the disk should be full")
        assert open(path, "rb").read() == before
        assert os.listdir(folder) == ["m." + suffix]
        os.unlink(path)
    image = b"\\x89PNG\\r\\n\\x1a\\n" + bytes(8000)
    corners = [[0, 0], [1, 0], [0, 1]]
    textured = manip3d.Mesh(
        large.vertices, large.faces, texcoords=corners, face_texcoords=[[0, 1, 2]] * 9000,
        face_material=[0] * 9000,
        materials=[manip3d.Material(
            name="skin", textures={"base_color": manip3d.Texture(path="skin.png", data=image)})],
    )
    for suffix in ("obj", "ply", "gltf"):
        try:
            textured.write(os.path.join(folder, "m." + suffix))
        except OSError as error:
            assert error.errno == errno.ENOSPC, error
        else:
            raise AssertionError("the disk should be full")
        assert os.listdir(folder) == [], os.listdir(folder)
    print("done")
    """
)


def test_full_disk(tmp_path: Path) -> None:
    mount = f"mount -t tmpfs -o size=64k none {tmp_path} && exec "
    namespace = ["unshare", "-rm", "sh", "-c"]
    if subprocess.run([*namespace, mount + "true"], capture_output=True).returncode:
        pytest.skip("no mount namespaces here")
    script = mount + f'{sys.executable} -c "$0" {tmp_path}'
    done = subprocess.run([*namespace, script, FULL_DISK], capture_output=True, text=True)
    assert (done.stdout, done.returncode) == ("done\n", 0), done.stderr


@pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed")
@pytest.mark.parametrize("suffix", ["ply", pytest.param("obj", marks=pytest.mark.slow)])
def test_every_failing_system_call_leaves_old_or_new(suffix: str, tmp_path: Path) -> None:
    grid(40, 2.0).write(tmp_path / "new.ply")
    out = tmp_path / "out"
    out.mkdir()
    code = "import sys, manip3d\nmesh = manip3d.read_mesh(sys.argv[1])\n"
    code += "try:\n    mesh.write(sys.argv[2])\nexcept OSError as error:\n"
    code += "    sys.exit(error.errno)\n"
    probe = ["strace", "-f", "-qq", "-e", "trace=none", "true"]
    if subprocess.run(probe, capture_output=True).returncode:
        pytest.skip("strace may not trace here")
    failures = 0
    path = out / f"m.{suffix}"
    for call, calls in (("write", 3), ("fsync", 2), ("rename", 1)):
        for k in range(1, calls + 1):
            grid(3, 1.0).write(path)
            old = path.read_bytes()
            command = ["strace", "-f", "-qq", "-o", os.devnull, "-e", f"trace={call}"]
            command += ["-P", str(out)] if call == "fsync" and k == 2 else []
            command += ["-e", f"inject={call}:error=EIO:when={1 if '-P' in command else k}"]
            command += [sys.executable, "-c", code, str(tmp_path / "new.ply"), str(path)]
            done = subprocess.run(command, capture_output=True, text=True)
            now = path.read_bytes()
            failed_after_rename = call == "fsync" and k == 2
            if done.returncode == errno.EIO and not failed_after_rename:
                assert now == old
            else:
                assert manip3d.read_mesh(path).num_faces == 2 * 39 * 39
            assert done.returncode in (0, errno.EIO), done.stderr
            assert os.listdir(out) == [path.name]
            failures += done.returncode == errno.EIO
    assert failures >= 3


def test_atomic_pair_replaces_both_or_neither(tmp_path: Path) -> None:
    scan, record = tmp_path / "a.bin", tmp_path / "a.bin.wm"
    with atomic_pair(scan, record) as new:
        for file in new:
            file.write_text("first")
    with pytest.raises(UnicodeEncodeError), atomic_pair(scan, record) as new:
        new[0].write_text("second\ud800")
    assert [each.read_text() for each in (scan, record)] == ["first", "first"]
    scan.unlink()
    (scan / "folder").mkdir(parents=True)  # a file cannot take its place
    with pytest.raises(OSError), atomic_pair(scan, record) as new:  # noqa: PT011
        new[0].write_text("second")
    assert record.read_text() == "first"
    assert {each.name for each in tmp_path.iterdir()} == {"a.bin", "a.bin.wm"}


@pytest.mark.parametrize("is_there", [False, True])
@pytest.mark.parametrize("name", ["a.bin", "old"])
def test_atomic_pair_takes_the_first_back_when_the_second_cannot_be_renamed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, is_there: bool
) -> None:
    scan, record = tmp_path / name, tmp_path / "a.bin.wm"
    if is_there:
        scan.write_text("first")
        record.write_text("first")
    replace = Path.replace

    def failing(source: Path, target: Path) -> Path:
        if target == record:
            raise OSError(errno.EIO, "Input/output error", str(target))
        return replace(source, target)

    monkeypatch.setattr(Path, "replace", failing)
    with pytest.raises(OSError, match="Input/output"), atomic_pair(scan, record) as new:
        new[0].write_text("second")
    here = {each.name: each.read_text() for each in tmp_path.iterdir()}
    assert here == ({name: "first", "a.bin.wm": "first"} if is_there else {})


@pytest.mark.parametrize("failing_call", [1, 2])
def test_atomic_pair_keeps_the_companion_when_a_folder_cannot_be_synced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing_call: int
) -> None:
    scan, record = tmp_path / "a.bin", tmp_path / "a.bin.wm"
    scan.write_text("first")
    record.write_text("first")
    num_calls = 0

    def failing(folder: Path) -> None:
        nonlocal num_calls
        num_calls += 1
        if num_calls == failing_call:
            raise OSError(errno.EIO, "Input/output error", str(folder))

    monkeypatch.setattr("manip3d.io._files.sync_folder", failing)
    with pytest.raises(OSError, match="Input/output"), atomic_pair(scan, record) as new:
        new[0].write_text("second")
    here = {each.name: each.read_text() for each in tmp_path.iterdir()}
    assert here == {"a.bin": "first", "a.bin.wm": "first"}


@pytest.mark.parametrize("suffix", ["obj", "ply"])
def test_a_mesh_that_cannot_be_renamed_leaves_no_texture(tmp_path: Path, suffix: str) -> None:
    if shutil.which("strace") is None:
        pytest.skip("strace is not installed")
    out = tmp_path / "out"
    out.mkdir()
    code = textwrap.dedent(
        """
        import sys
        from manip3d import Material, Mesh, Texture
        picture = bytes.fromhex("89504e470d0a1a0a")
        Mesh(
            [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
            [[0, 1, 2]],
            texcoords=[[0, 0], [1, 0], [0, 1]],
            face_material=[0],
            materials=[Material("m", textures={"base_color": Texture("a.png", picture)})],
        ).write(sys.argv[1])
        """
    )
    # The picture and the material library never replace a file; the mesh may.
    calls = [("renameat2", 1), *([("renameat2", 2)] if suffix == "obj" else []), ("rename", 1)]
    for call, k in calls:
        command = ["strace", "-f", "-qq", "-o", os.devnull, "-e", f"trace={call}"]
        command += ["-e", f"inject={call}:error=EIO:when={k}"]
        command += [sys.executable, "-c", code, str(out / f"a.{suffix}")]
        done = subprocess.run(command, capture_output=True, text=True)
        assert "Input/output error" in done.stderr
        assert os.listdir(out) == []


def colored(value: int) -> manip3d.Mesh:
    """A triangle with a picture of one name, whose content has this value."""
    picture = manip3d.Texture("a.png", bytes.fromhex("89504e470d0a1a0a") + bytes([value]))
    return manip3d.Mesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
        [[0, 1, 2]],
        texcoords=[[0, 0], [1, 0], [0, 1]],
        face_material=[0],
        materials=[manip3d.Material("m", textures={"base_color": picture})],
    )


def shown(path: Path) -> int:
    """The value of the picture that a file of `colored` shows."""
    mesh = manip3d.read_mesh(path)
    texture = mesh.materials[0].textures["base_color"]
    found = io.texture_path(mesh, texture)
    return (texture.data if found is None else found.read_bytes())[-1]


def write_colored(path: Path, value: int) -> None:
    colored(value).write(path)


class StoppedWriter:
    """Another process that writes `colored` and stops in a system call until `end`."""

    def __init__(self, path: Path, value: int, inject: str, *more: str) -> None:
        log = path.parent.parent / f"{path.name}.log"
        calls = "fsync,rename,renameat2"
        command = ["strace", "-f", "-qq", "-o", log, "-e", f"trace={calls}", "-e"]
        for each in (f"inject={inject}:signal=SIGSTOP", *more):
            command += [each, "-e"]
        code = "import os, pathlib, sys; print(os.getpid(), flush=True);"
        code += "from test_io_writing import write_colored;"
        code += "write_colored(pathlib.Path(sys.argv[1]), int(sys.argv[2]))"
        environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent.parent)}
        environment["PYTHONPATH"] += os.pathsep + str(Path(__file__).parent)
        self._process = subprocess.Popen(
            [*command[:-1], sys.executable, "-c", code, str(path), str(value)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=environment,
            text=True,
        )
        assert self._process.stdout is not None
        self._pid = int(self._process.stdout.readline())
        while self._process.poll() is None and "stopped by SIGSTOP" not in log.read_text():
            time.sleep(0.01)

    def end(self) -> int:
        os.kill(self._pid, signal.SIGCONT)
        self._process.communicate(timeout=60)
        return self._process.returncode


@pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed")
@pytest.mark.parametrize("suffix", ["obj", "ply", "gltf"])
@pytest.mark.parametrize("renames", ["exclusive", "plain"])
def test_two_processes_do_not_take_each_others_pictures(
    tmp_path: Path, suffix: str, renames: str
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    # The first process has chosen its names when it syncs its first file.
    more = ["inject=renameat2:error=EINVAL"] if renames == "plain" else []
    first = StoppedWriter(out / f"a.{suffix}", 1, "fsync:when=1", *more)
    write_colored(out / f"b.{suffix}", 2)
    write_colored(out / f"c.{suffix}", 1)
    assert first.end() == 0
    assert [shown(out / f"{name}.{suffix}") for name in "abc"] == [1, 2, 1]
    if suffix != "gltf":  # which stores pictures in its buffer
        assert len(list(out.glob("*.png"))) == 2
    assert not list(out.glob(".*"))


@pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed")
def test_a_picture_that_another_process_takes_back_is_written_again(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    # The picture has its name already when the mesh cannot be renamed.
    first = StoppedWriter(out / "a.ply", 1, "rename:error=EIO:when=1")
    assert [path.name for path in out.glob("*.png")] == ["a.png"]
    with ThreadPoolExecutor() as pool:
        second = pool.submit(write_colored, out / "b.ply", 1)
        time.sleep(0.3)
        is_early = second.done()
        assert first.end() != 0
        second.result(timeout=60)
    assert not is_early
    assert shown(out / "b.ply") == 1
    assert sorted(path.suffix for path in out.iterdir()) == [".ply", ".png"]


def test_many_writers_at_once_keep_their_pictures(tmp_path: Path) -> None:
    values = list(range(8))
    for suffix in ("obj", "ply"):
        for number in range(10):
            out = tmp_path / f"{suffix}{number}"
            out.mkdir()
            paths = [out / f"{value}.{suffix}" for value in values]
            with ThreadPoolExecutor(len(values)) as pool:
                list(pool.map(write_colored, paths, values))
            assert [shown(path) for path in paths] == values
            assert len(list(out.glob("*.png"))) == len(values)
            assert not list(out.glob(".*"))


def test_pictures_at_a_url_do_not_replace_each_other() -> None:
    memory = pytest.importorskip("fsspec").filesystem("memory")
    place = f"memory://pictures-{os.getpid()}"
    for suffix in ("obj", "ply"):
        for value in range(3):
            write_colored(f"{place}/{value}.{suffix}", value)  # type: ignore[arg-type]
        for value in range(3):
            with io.local_copy(f"{place}/{value}.{suffix}") as copy:
                assert shown(copy) == value
    assert len(memory.glob(f"{place}/*.png")) == 3
    memory.rm(place, recursive=True)


REPLACE = """
import pathlib, sys
from manip3d.io._files import atomic_folder
with atomic_folder(sys.argv[1]) as folder:
    pathlib.Path(folder, "text").write_text("new")
"""


@pytest.mark.parametrize("call", [2, 3])
@pytest.mark.parametrize("outcome", ["error=EIO", "signal=KILL"])
def test_a_folder_is_old_or_new_where_names_cannot_be_exchanged(
    tmp_path: Path, call: int, outcome: str
) -> None:
    if shutil.which("strace") is None:
        pytest.skip("strace is not installed")
    target = tmp_path / "target"
    target.mkdir()
    (target / "text").write_text("old")
    command = ["strace", "-f", "-qq", "-o", os.devnull, "-e", "trace=rename,renameat,renameat2"]
    command += ["-e", "inject=renameat2:error=EINVAL", "-e"]
    command += [f"inject=rename,renameat:{outcome}:when={call - 1}"]
    done = subprocess.run([*command, sys.executable, "-c", REPLACE, str(target)])
    assert done.returncode != 0
    assert target.exists() == (outcome != "signal=KILL" or call == 2)
    (tmp_path / "other").mkdir()
    atomic_write(tmp_path / "beside", "any write restores the folder")
    assert (target / "text").read_text() == "old"
    assert sorted(os.listdir(tmp_path)) == ["beside", "other", "target"]
    with atomic_folder(target) as new:
        (new / "text").write_text("newer")
    assert os.listdir(target) == ["text"]
    assert (target / "text").read_text() == "newer"


@pytest.mark.parametrize("name", [".", "..", "../inner", "../../outer"])
def test_the_current_folder_is_not_replaced(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inner = tmp_path / "outer" / "inner"
    inner.mkdir(parents=True)
    monkeypatch.chdir(inner)
    with (
        pytest.raises(InputError, match="expected another folder than the current one"),
        atomic_folder(name),
    ):
        pass
    with atomic_folder("../other") as new:
        (new / "text").touch()
    assert sorted(os.listdir("..")) == ["inner", "other"]


def test_a_folder_is_replaced_by_a_process_whose_current_folder_was_deleted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "deleted").mkdir()
    monkeypatch.chdir(tmp_path / "deleted")
    (tmp_path / "deleted").rmdir()
    with atomic_folder(tmp_path / "made") as new:
        (new / "text").touch()
    assert os.listdir(tmp_path / "made") == ["text"]


def test_atomic_pair_leaves_a_folder_that_has_the_companions_name(tmp_path: Path) -> None:
    scan, record = tmp_path / "a.bin", tmp_path / "a.bin.wm"
    record.mkdir()
    (record / "kept").touch()
    with pytest.raises(IsADirectoryError) as caught, atomic_pair(scan, record):
        pass
    assert caught.value.filename == str(record)
    assert sorted(each.name for each in tmp_path.rglob("*")) == ["a.bin.wm", "kept"]


def test_a_full_disk_is_told_of_the_file_and_not_of_its_companion(tmp_path: Path) -> None:
    scan, record = tmp_path / "a.bin", tmp_path / "a.bin.wm"

    def fill(new: tuple[Path, Path], *named: str) -> None:
        assert [each.name for each in new] == ["a.bin", "a.bin.wm"]
        raise OSError(errno.ENOSPC, "No space left on device", *named)

    with pytest.raises(OSError, match="No space") as caught, atomic_pair(scan, record) as new:
        fill(new)
    assert caught.value.filename == str(scan)
    with pytest.raises(OSError, match="No space") as caught, atomic_pair(scan, record) as new:
        fill(new, str(new[1]))
    assert caught.value.filename == str(record)


def test_write_new_is_whole_and_never_replaces(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "a.key"

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", killed)
        with pytest.raises(KeyboardInterrupt):
            write_new(target, b"first")
    assert list(tmp_path.iterdir()) == []
    write_new(target, b"second")
    assert target.stat().st_mode & 0o777 == 0o600
    for place in (target, tmp_path / "dangling"):
        if place != target:
            place.symlink_to(tmp_path / "nowhere")
        with pytest.raises(FileExistsError) as caught:
            write_new(place, b"third")
        assert caught.value.filename == str(place)
    monkeypatch.setattr("os.path.lexists", lambda _: False)  # somebody is quicker
    with pytest.raises(FileExistsError):
        write_new(target, b"fourth")
    assert target.read_bytes() == b"second"

    def no_links(*_: object) -> None:
        raise PermissionError(errno.EPERM, "no links here")

    monkeypatch.setattr("os.link", no_links)
    with pytest.raises(FileExistsError) as caught:
        write_new(target, b"fifth")
    assert caught.value.filename == str(target)
    assert target.read_bytes() == b"second"
    write_new(tmp_path / "b.key", b"sixth")
    assert (tmp_path / "b.key").read_bytes() == b"sixth"
    assert (tmp_path / "b.key").stat().st_mode & 0o777 == 0o600
    assert {each.name for each in tmp_path.iterdir()} == {"a.key", "b.key", "dangling"}


@pytest.mark.parametrize("path", ["", ".", "skin.bmp"])
def test_an_image_that_becomes_png_needs_no_name(path: str, tmp_path: Path) -> None:
    stream = BytesIO()
    pytest.importorskip("PIL.Image").new("RGB", (2, 2)).save(stream, "BMP")
    skin = manip3d.Material(textures={"base_color": manip3d.Texture(path, stream.getvalue())})
    manip3d.Mesh(
        np.eye(3), [[0, 1, 2]], texcoords=np.eye(3)[:, :2], face_texcoords=[[0, 1, 2]],
        face_material=[0], materials=[skin],
    ).write(tmp_path / "a.glb")  # fmt: skip
    (material,) = io.read_mesh(tmp_path / "a.glb").materials
    assert material.textures["base_color"].data[:4] == b"\x89PNG"

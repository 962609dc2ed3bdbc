"""Hostile files for every reader that Python offers: valid ones, damaged where it hurts.

``python tests/fuzz/hostile_files.py --cases 1000000`` is the long run, of the night; the test
beside this file is the short one. A case is a kind of file and a seed, so each finding can be
repeated: ``--kind pcd --first 4711 --cases 1``.

A finding is any exception but manip3d's own and `OSError`, a message that a terminal would obey, a
signal, more than five seconds of processor time, more than 2 GiB of memory.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import multiprocessing
import os
import resource
import shutil
import struct
import sys
import tempfile
import time
import warnings
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import manip3d
from manip3d import (
    LidarFrame,
    authenticate,
    camera,
    capture,
    datasets,
    diary,
    forge,
    serve,
    simplify,
    study,
)
from manip3d import io as files

TESTS = Path(__file__).parents[1]
CORPUS = TESTS.parent / "cpp" / "fuzz" / "corpus"
SECONDS = 5.0
"""Processor time a case may take."""
HANG_S = 60.0
"""Wall time after which a silent worker is taken for hung."""
MEMORY = 2 << 30
"""Bytes that a case may map beyond what the process has."""

Files = dict[str, bytes]


@dataclass(frozen=True)
class Kind:
    """A kind of input: valid examples as files by name, and what reads them from a folder."""

    name: str
    examples: Callable[[], list[Files]]
    read: Callable[[Path, str], object]
    """Takes the folder and the name of the file that was damaged."""


# --- examples ------------------------------------------------------------------------------------


def corpus(folder: str, suffix: str, most: int = 12) -> list[Files]:
    """The smallest files of a corpus of the C++ fuzz targets."""
    paths = sorted((CORPUS / folder).iterdir(), key=lambda path: (path.stat().st_size, path.name))
    step = max(1, len(paths) // most)
    return [{f"a{suffix}": path.read_bytes()} for path in paths[::step]]


def written(write: Callable[[Path], object], name: str) -> Files:
    """Return the files that ``write`` leaves if it is given this name."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder) / name)
        return {p.name: p.read_bytes() for p in sorted(Path(folder).iterdir())}


def folder_of(write: Callable[[Path], object]) -> Files:
    """Return all files below a folder that ``write`` fills."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder) / "x")
        root = Path(folder)
        return {
            str(p.relative_to(root)): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()
        }


def small_scan(seed: int = 0) -> LidarFrame:
    rng = np.random.default_rng(seed)
    return LidarFrame(
        rng.normal(size=(30, 3)) * 5,
        rng.random(30).astype(np.float32),
        ring=rng.integers(0, 64, 30).astype(np.uint8),
    )


def quad() -> manip3d.Mesh:
    return manip3d.Mesh(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.5]],
        [[0, 1, 2], [0, 2, 3]],
        texcoords=[[0, 0], [1, 0], [1, 1], [0, 1]],
        face_texcoords=[[0, 1, 2], [0, 2, 3]],
        colors=np.arange(12).reshape(4, 3),
    )


def meshes(suffix: str, folder: str) -> list[Files]:
    found = corpus(folder, suffix)
    with contextlib.suppress(manip3d.InputError):
        found.append(written(quad().write, f"a{suffix}"))
        found.append(written(quad().write, f"a{suffix}.gz"))
    return found


def nuscenes() -> list[Files]:
    rows = np.arange(100, dtype="<f4").reshape(20, 5)
    return [{"a.pcd.bin": rows.tobytes()}, {"a.pcd.bin": b""}]


def scans(suffix: str, folder: str) -> list[Files]:
    return [*corpus(folder, suffix), written(small_scan().write, f"a{suffix}")]


def las_files(suffix: str) -> list[Files]:
    import laspy

    def write(path: Path, point_format: int, version: str) -> None:
        header = laspy.LasHeader(point_format=point_format, version=version)
        header.add_extra_dim(laspy.ExtraBytesParams("amplitude", np.int16))
        las = laspy.LasData(header)
        las.points = laspy.ScaleAwarePointRecord.zeros(40, header=header)
        las.x, las.y, las.z = np.random.default_rng(0).normal(size=(3, 40))
        las.write(str(path))

    forms = [(1, "1.2"), (3, "1.3"), (6, "1.4"), (8, "1.4")]
    return [written(lambda p, f=f, v=v: write(p, f, v), f"a{suffix}") for f, v in forms]


def arrays() -> list[Files]:
    rows = np.random.default_rng(0).normal(size=(20, 5))
    named = np.zeros(
        9, [("x", ">f4"), ("y", "<f8"), ("z", "<f4"), ("ring", "u1"), ("rgb", "u1", 3)]
    )
    found = []
    for array in (rows[:, :3].astype(np.float32), rows, np.asfortranarray(rows), named):
        stream = io.BytesIO()
        np.save(stream, array)
        found.append({"a.npy": stream.getvalue()})
    return found


def e57_files() -> list[Files]:
    return [written(lambda p: files.write_scans([small_scan(0), small_scan(1)], p), "a.e57")]


def ptx_files() -> list[Files]:
    return [written(lambda p: files.write_scans([small_scan(0), small_scan(1)], p), "a.ptx")]


COLLADA = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<library_images><image id="i"><init_from>a.png</init_from></image></library_images>
<library_effects><effect id="e"><profile_COMMON><newparam sid="f"><surface type="2D">
<init_from>i</init_from></surface></newparam><newparam sid="t"><sampler2D><source>f</source>
</sampler2D></newparam><technique sid="c"><lambert><diffuse><texture texture="t" texcoord="u"/>
</diffuse></lambert></technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="12">0 0 0 1 0 0 1 1 0 0 1 0.5</float_array>
<technique_common><accessor source="#pa" count="4" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<source id="t"><float_array id="ta" count="8">0 0 1 0 1 1 0 1</float_array><technique_common>
<accessor source="#ta" count="4" stride="2"><param name="S" type="float"/>
<param name="T" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<polylist material="s" count="1"><input semantic="VERTEX" source="#v" offset="0"/>
<input semantic="TEXCOORD" source="#t" offset="1" set="0"/><vcount>4</vcount>
<p>0 0 1 1 2 2 3 3</p></polylist>
<tristrips count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2 3</p></tristrips>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="w"><node id="n"><translate>1 2 3</translate>
<rotate>0 0 1 90</rotate><scale>1 2 1</scale><instance_geometry url="#g"><bind_material>
<technique_common><instance_material symbol="s" target="#m"/></technique_common></bind_material>
</instance_geometry></node><node><matrix>1 0 0 0 0 1 0 0 0 0 1 5 0 0 0 1</matrix>
<instance_node url="#n"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#w"/></scene></COLLADA>
"""
THREE_MF = """<?xml version="1.0" encoding="UTF-8"?>
<model unit="millimeter" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
 xmlns:m="http://schemas.microsoft.com/3dmanufacturing/material/2015/02"><resources>
<basematerials id="7"><base name="a" displaycolor="#FF0000"/></basematerials>
<m:colorgroup id="8"><m:color color="#00FF00FF"/></m:colorgroup>
<object id="1" pid="7" pindex="0"><mesh><vertices><vertex x="0" y="0" z="0"/>
<vertex x="1" y="0" z="0"/><vertex x="0" y="1" z="0"/><vertex x="0" y="0" z="1"/></vertices>
<triangles><triangle v1="0" v2="2" v3="1"/><triangle v1="0" v2="1" v3="3" pid="8" p1="0"/>
<triangle v1="1" v2="2" v3="3"/></triangles></mesh></object>
<object id="2"><components><component objectid="1" transform="1 0 0 0 1 0 0 0 1 5 0 0"/>
<component objectid="1"/></components></object></resources>
<build><item objectid="2" transform="0 1 0 -1 0 0 0 0 2 0 0 1"/></build></model>
"""


def read_three_mf(folder: Path, name: str) -> None:
    """Read an archive with a damaged model, as checksums would reveal a damaged archive."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr("3D/3dmodel.model", (folder / name).read_bytes())
    files.read_mesh_bytes(content.getvalue(), "3mf")


def clouds() -> list[Files]:
    """Return organised clouds in a camera's axes and in others, with and without colours."""
    v, u = np.mgrid[:6, :8]
    z = 2.0 + 0.1 * np.sin(u) + 0.2 * (v > 2)
    points = np.stack([(u - 3.5) * z / 7, (v - 2.5) * z / 7, z], axis=-1)
    points[0, 0] = np.nan
    found = []
    for turned, kind in ((points, ""), (points[..., [2, 0, 1]], "F"), (points, "U")):
        names, size = ("x y z rgb", "4 4 4 4") if kind else ("x y z", "4 4 4")
        header = (
            f"VERSION 0.7\nFIELDS {names}\nSIZE {size}\nTYPE F F F {kind}\n"
            f"COUNT {size.replace('4', '1')}\nWIDTH 8\nHEIGHT 6\nPOINTS 48\nDATA binary\n"
        )
        rows = turned.reshape(48, 3).astype("<f4")
        colors = np.arange(48, dtype="<u4").reshape(48, 1).view("<f4")
        table = np.hstack([rows, colors]) if kind else rows
        found.append({"a.pcd": header.encode() + table.tobytes()})
    return found


def simplify_cloud(folder: Path, name: str) -> object:
    options = simplify.DepthOptions(20)
    return simplify.simplify_depth_file(folder / name, folder / "out.ply", options)


def archives() -> list[Files]:
    rows = np.random.default_rng(0).random(size=(20, 3))
    members = {"colors": rows, "normals": rows, "intensity": rows[:, :1].astype(np.float32)}
    found = []
    for save in (np.savez, np.savez_compressed):
        for more in ({}, members):
            stream = io.BytesIO()
            save(stream, positions=rows.astype(np.float32), **more)
            found.append({"a.npz": stream.getvalue()})
    return found


def depth_images() -> list[Files]:
    import OpenEXR
    from PIL import Image

    values = np.arange(12 * 16, dtype=np.uint16).reshape(12, 16) * 100
    stream = io.BytesIO()
    np.save(stream, values.astype(np.float32) / 1000)
    found = [
        {"a.npy": stream.getvalue()},
        {"a.pgm": b"P5 16 12 65535\n" + values.astype(">u2").tobytes()},
    ]
    floats = (values / 1000).astype("<f4")[::-1].tobytes()
    found.append({"a.pfm": b"Pf\n16 12\n-1.0\n" + floats})
    for save in (np.savez, np.savez_compressed):
        stream = io.BytesIO()
        save(stream, depth=values.astype(np.int32)[None], mask=values > 0)
        found.append({"a.npz": stream.getvalue()})
    for kind in (OpenEXR.ZIP_COMPRESSION, OpenEXR.PIZ_COMPRESSION, OpenEXR.NO_COMPRESSION):
        header = {"compression": kind, "type": OpenEXR.scanlineimage}
        with OpenEXR.File(header, {"Z": values.astype(np.float32)}) as image:
            found.append(written(lambda p, image=image: image.write(str(p)), "a.exr"))
    for suffix in (".png", ".tif"):
        found.append(written(lambda p: Image.fromarray(values).save(p), f"a{suffix}"))
    return found


@cache
def calibrations() -> list[Files]:
    lasers = "".join(
        f"<item><px><id_>{i}</id_><rotCorrection_>{i}</rotCorrection_><vertCorrection_>-{i}"
        f"</vertCorrection_><distCorrection_>1.5</distCorrection_></px></item>"
        for i in range(4)
    )
    xml = (
        '<?xml version="1.0" encoding="UTF-8"?><boost_serialization><DB><distLSB_>0.2</distLSB_>'
        f"<points_>{lasers}</points_></DB></boost_serialization>"
    )
    yaml = "num_lasers: 2\ndistance_resolution: 0.002\nlasers:\n" + "".join(
        f"- {{laser_id: {i}, rot_correction: 0.1, vert_correction: -0.{i}, dist_correction: 1.0}}\n"
        for i in range(2)
    )
    return [{"a.xml": xml.encode()}, {"a.yaml": yaml.encode()}]


def drives() -> list[Files]:
    sys.path[:0] = [str(TESTS), str(TESTS / "datasets")]
    import test_kitti as kitti

    return [folder_of(lambda p: kitti.write_raw(p.parent)), folder_of(kitti.write_object)]


def tum_folder() -> list[Files]:
    from PIL import Image

    size = (640, 480)  # as the benchmark's cameras
    gray = Image.fromarray(np.full(size[::-1], 5000, np.uint16))
    image = written(gray.save, "a.png")["a.png"]
    lists = "# time file\n1.0 depth/1.png\n1.1 depth/2.png\n"
    color = "# time file\n1.0 rgb/1.png\n1.1 rgb/2.png\n"
    png = written(Image.new("RGB", size).save, "a.png")
    return [
        {
            "freiburg1/depth.txt": lists.encode(),
            "freiburg1/rgb.txt": color.encode(),
            "freiburg1/depth/1.png": image,
            "freiburg1/depth/2.png": image,
            "freiburg1/rgb/1.png": png["a.png"],
            "freiburg1/rgb/2.png": png["a.png"],
        }
    ]


def joint_files() -> list[Files]:
    """Return joints of a person in each frame of a small recording."""
    import json

    folder = recordings("")[0]
    import rgbd_frames

    times = [frame.time_ns // 1000 for frame in rgbd_frames.frames(3)]
    joint = " ".join(["0.1", "-0.2", "2.0", *["3.5"] * 8, "2"])
    body = ["1", "72057594037931101 0 1 1 1 1 0 0.1 -0.2 2", "25", *[joint] * 25]
    keypoints = [float(i % 3) + 0.5 for i in range(75)]
    person = {"person_id": [-1], "pose_keypoints_2d": keypoints}
    results = [{"image_id": n, "keypoints": keypoints[:51], "score": 0.9} for n in range(3)]
    azure = {"body_id": 1, "joint_positions": [[1.0, -20.5, 2000.0]] * 32}
    told = [{"frame_id": n, "timestamp_usec": t, "bodies": [azure]} for n, t in enumerate(times)]
    rows = [f"{n},0,1,{j},x,0.1,0.2,2.0,2" for n in range(3) for j in range(25)]
    texts = {
        "z.skeleton": "\n".join(["3", *body * 3]),
        "z.csv": "\n".join(["frame,time_ns,id,joint,name,x,y,z,state", *rows]),
        "z.json": json.dumps(results),
    }
    folders = [{name: text.encode()} for name, text in texts.items()]
    folders.append({"z.json": json.dumps({"frames": told}).encode()})
    frame = json.dumps({"people": [person]}).encode()
    folders.append({f"z/a_{n}_keypoints.json": frame for n in range(3)})
    return [folder | joints for joints in folders]


def read_joints(folder: Path, _: str) -> None:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".* by time_ns, but", UserWarning)  # a damaged time
        read_frames(f"joints:{folder / 'x'}#{next(folder.glob('z*'))}")


def recordings(suffix: str) -> list[Files]:
    sys.path.insert(0, str(TESTS))
    import rgbd_frames

    def write(path: Path, calibration: Any) -> None:
        capture.record(rgbd_frames.frames(3, calibration), path)

    makers = [rgbd_frames.CALIBRATION, rgbd_frames.full_calibration()]
    name = "x" + suffix
    return [folder_of(lambda p, c=c: write(p.with_name(name), c)) for c in makers]


def trials() -> list[Files]:
    from scipy.io import savemat

    shapes = {"depth": (240, 320, 2), "skeleton": (20, 3, 2)}
    names = {"depth": "d_depth", "skeleton": "d_skel"}

    def write(path: Path, kind: str) -> None:
        # Images are packed, so that damage meets more than pixels; of joints each byte is open.
        dtype = np.uint16 if kind == "depth" else np.float64
        values = {names[kind]: np.full(shapes[kind], 2, dtype)}
        savemat(path, values, do_compression=kind == "depth")

    files: dict[str, bytes] = {}
    for kind in names:
        files |= written(lambda path, kind=kind: write(path, kind), f"a1_{kind}.mat")
    return [files]


def results() -> list[Files]:
    sys.path.insert(0, str(TESTS))
    from manip3d.experiments import run as run_experiments
    from toy_experiments import experiment

    def write(path: Path) -> None:
        run_experiments([experiment(1, 2)], path.parent, jobs=1)

    found = folder_of(write)
    return [{name: found[name] for name in ("results.json", "results.csv")}]


def lattices() -> list[Files]:
    sys.path.insert(0, str(TESTS))
    import lattice_scans

    return [written(lattice_scans.lattice(rings).save, "a.json") for rings in (4, 64)]


def rigs() -> list[Files]:
    rig = authenticate.StereoRig(700.0, (600.0, 180.0), 0.5, np.eye(4))
    pairs = {name: authenticate.CameraPair(rig, 2, 3) for name in ("front", "back")}
    return [written(lambda path: authenticate.write_rigs(pairs, path), "a.json")]


BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 0.0 0.0 0.0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Knee
  {
    OFFSET 0.0 -40.0 0.0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0.0 -40.0 0.0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.0333333
0 90 0 0 0 0 10 0 0
1 90 0 5 0 0 20 0 0
"""


@cache
def signed() -> tuple[bytes, authenticate.Watermarked, bytes, bytes]:
    """Return a key file, a scan with its record, a picture that carries it, and a state."""
    sys.path.insert(0, str(TESTS))
    from watermark_scans import grid_scan, key_file

    frames = [LidarFrame(grid_scan(1100, seed)) for seed in range(3)]
    with tempfile.TemporaryDirectory() as place:
        path = key_file(Path(place) / "a.key")
        key = authenticate.KeyFile(path)
        marker = authenticate.Watermarker(key)
        sent = [marker.embed(frame) for frame in frames]
        grey = np.random.default_rng(0).integers(0, 256, (128, 130)).astype(np.uint8)
        carried = authenticate.Watermarker(key).embed(frames[0], picture=grey).picture
        assert carried is not None
        authenticate.write_carrier(carried, Path(place) / "a.png")
        verifier = authenticate.Watermarker(key, state=Path(place) / "a.state")
        for each in sent:
            verifier.verify(each.frame, each.record)
        state = (Path(place) / "a.state").read_bytes()
        verifier.close()
        return path.read_bytes(), sent[0], (Path(place) / "a.png").read_bytes(), state


def studies() -> list[Files]:
    return [
        written(lambda path: study.write_template("display", path, example=True), "a.toml"),
        {"a.json": b'{"kind": "display", "title": "a", "order": "random", "conditions": []}'},
    ]


def study_folders() -> list[Files]:
    def write(path: Path) -> None:
        with study.StudyFolder(path, {"kind": "rating", "sha256": {"a": "0" * 64}}) as folder:
            for name in ("p1", "p2"):
                folder.begin(name)
                folder.store(name, study.Answer("about", {"a": 1}, {"age": 33}, 12.5))

    found = folder_of(write)
    return [{name: data for name, data in found.items() if not name.endswith(".lock")}]


def stream_truths() -> list[Files]:
    masks = np.random.default_rng(0).random((3, 6, 7)) < 0.5
    truth = forge.StreamTruth(1, masks, np.arange(3))
    return [written(truth.write, "a.npz")]


def certificates() -> list[Files]:
    return [written(lambda path: serve.kept_certificate(path, "127.0.0.1"), "a.pem")]


def cameras() -> list[Files]:
    numbers = b"50., 0., 31., 0., 50., 23., 0., 0., 1."
    xml = b"""<?xml version="1.0"?><opencv_storage><image_width>64</image_width>
<image_height>48</image_height><camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols>
<dt>d</dt><data>%s</data></camera_matrix></opencv_storage>""" % numbers.replace(b",", b"")
    yaml = (
        b"""%%YAML:1.0
---
image_width: 64
image_height: 48
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ %s ]
distortion_coefficients: !!opencv-matrix { rows: 1, cols: 5, dt: d, data: [ .1, 0, 0, 0, 0 ] }
"""
        % numbers
    )
    matrix = b'{"width": 64, "height": 48, "intrinsic_matrix": [50, 0, 0, 0, 50, 0, 31, 23, 1]}'
    return [
        {"a.json": b'{"width": 64, "height": 48, "fx": 50, "fy": 50.5, "cx": 31, "cy": 23}'},
        {"a.json": matrix},
        {"a.xml": xml},
        {"a.yaml": yaml},
        {"a.txt": b"1 PINHOLE 64 48 50 50.5 31 23\n2 RADIAL 64 47 50 31 23 .1 .1\n"},
        {"a.txt": b"50 0 31\n0 50.5 23\n0 0 1\n"},
        {"a.txt": b"cam0=[50 0 31; 0 50 23; 0 0 1]\ndoffs=3.5\nbaseline=190.1\nwidth=64\n"},
    ]


# --- reading -------------------------------------------------------------------------------------


def read_drive(folder: Path, _: str) -> None:
    root = next(p for p in (*folder.rglob("*_sync"), folder / "x") if p.is_dir())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # lines that are no times
        drive = datasets.open_kitti(root)
    for frame in drive:
        frame.scan()
        frame.boxes()
        frame.calibration()


def read_frames(uri: str) -> None:
    with capture.open_rgbd(uri) as source:
        for _ in source:
            pass


def read_packets(folder: Path, name: str) -> None:
    with capture.open(f"pcap:{folder / name}") as source:
        for _ in source:
            pass


def report(folder: Path, _: str) -> None:
    from manip3d.report import write_report

    for kind in ("html", "md", "csv"):
        write_report(folder, folder / f"report.{kind}")


def mesh(folder: Path, name: str) -> object:
    return files.read_report(folder / name)


def scan(folder: Path, name: str) -> object:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # columns that are left out
        return files.read_scans(folder / name)


def verify_record(folder: Path, name: str) -> None:
    key, sent, _, _ = signed()
    record = (folder / name).read_bytes()
    with key_of(folder, key) as opened:
        found = authenticate.Watermarker(opened).verify(sent.frame, record)
    assert found.verdict != "authentic" or record == sent.record, "authentic, with another record"


def verify_picture(folder: Path, name: str) -> None:
    key, sent, _, _ = signed()
    with key_of(folder, key) as opened:
        seen = authenticate.read_carrier(folder / name)
        authenticate.Watermarker(opened).verify(sent.frame, None, picture=seen)


def go_on(folder: Path, name: str) -> None:
    """Verify a frame that the state lists as seen: damage after its checkpoint must not hide it."""
    key, sent, _, _ = signed()
    with (
        key_of(folder, key) as opened,
        authenticate.Watermarker(opened, state=folder / name) as verifier,
    ):
        found = verifier.verify(sent.frame, sent.record)
    assert found.verdict != "authentic", "authentic, though it was seen before"


def key_of(folder: Path, content: bytes) -> authenticate.KeyFile:
    path = folder / "own.key"
    path.write_bytes(content)
    path.chmod(0o600)
    return authenticate.KeyFile(path)


def read_study_folder(folder: Path, _: str) -> None:
    study.StudyFolder(folder / "x", read_only=True).close()
    study.StudyFolder(folder / "x").close()


def read_camera(folder: Path, name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # fields that are left out
        camera.read_intrinsics(folder / name, width=64, height=48)
    camera.camera_depth_unit(folder / name)


def questionnaires() -> list[Files]:
    own = diary.Questionnaire(
        "Mood",
        (
            diary.QuestionnaireItem("I feel well.", 0, 2, ("no", "a little", "very")),
            diary.QuestionnaireItem("I am sad.", -1, 1),
        ),
        (diary.QuestionnaireScale("mood", (1, 2), (2,), "mean"),),
    )
    return [
        written(lambda path, one=one: diary.write_questionnaire(one, path), "a.json")
        for one in (own, diary.MCGILL)
    ]


def read_diary_key(folder: Path, name: str) -> None:
    from manip3d.diary._sealing import read_key

    read_key(folder / name)


KINDS = {
    kind.name: kind
    for kind in [
        *(
            Kind(f"mesh{suffix}", lambda s=suffix, f=folder: meshes(s, f), mesh)
            for suffix, folder in (
                (".obj", "obj"),
                (".mtl", "mtl"),
                (".ply", "ply"),
                (".off", "off"),
                (".stl", "stl"),
                (".gltf", "gltf"),
                (".glb", "gltf"),
            )
            if suffix != ".mtl"
        ),
        Kind("mesh.dae", lambda: [{"a.dae": COLLADA.encode()}], mesh),
        Kind("mesh.3mf", lambda: [{"a.model": THREE_MF.encode()}], read_three_mf),
        *(
            Kind(f"scan{suffix}", lambda s=suffix, f=folder: scans(s, f), scan)
            for suffix, folder in (
                (".pcd", "pcd"),
                (".ply", "ply_points"),
                (".bin", "kitti"),
                (".3d", "three_dtk"),
                (".xyz", "text_points"),
                (".csv", "text_points"),
            )
        ),
        Kind("scan.pcd.bin", nuscenes, scan),
        Kind("scan.npy", arrays, scan),
        Kind("scan.npz", archives, scan),
        Kind("scan.las", lambda: las_files(".las"), scan),
        Kind("scan.laz", lambda: las_files(".laz"), scan),
        Kind("scan.e57", e57_files, scan),
        Kind("scan.ptx", ptx_files, scan),
        Kind("cloud", clouds, simplify_cloud),
        Kind("depth", depth_images, lambda d, n: files.read_depth(d / n)),
        Kind("velodyne", calibrations, lambda d, n: capture.read_velodyne_calibration(d / n)),
        Kind("pcap", lambda: corpus("pcap", ".pcap"), read_packets),
        Kind("drive", drives, read_drive),
        Kind("tum", tum_folder, lambda d, _: read_frames(f"tum:{d / 'freiburg1'}")),
        Kind("folder", lambda: recordings(""), lambda d, _: read_frames(f"folder:{d / 'x'}")),
        Kind("mkv", lambda: recordings(".mkv"), lambda d, _: read_frames(f"mkv:{d / 'x.mkv'}")),
        Kind("joints", joint_files, read_joints),
        Kind("trial", trials, lambda d, _: read_frames(f"utd-mhad:{d / 'a1_depth.mat'}")),
        Kind("results", results, report),
        Kind("bvh", lambda: [{"a.bvh": BVH.encode()}], lambda d, n: files.read_bvh(d / n)),
        Kind("lattice", lattices, lambda d, n: authenticate.SensorLattice.load(d / n)),
        Kind("rigs", rigs, lambda d, n: authenticate.read_rigs(d / n)),
        Kind("key", lambda: [{"a.key": signed()[0]}], lambda d, n: key_of(d, (d / n).read_bytes())),
        Kind("record", lambda: [{"a.wm": signed()[1].record}], verify_record),
        Kind("picture", lambda: [{"a.png": signed()[2]}], verify_picture),
        Kind("state", lambda: [{"a.state": signed()[3]}], go_on),
        Kind("stream truth", stream_truths, lambda d, n: forge.read_stream_truth(d / n)),
        Kind("study", studies, lambda d, n: study.read_study(d / n)),
        Kind("journal", study_folders, read_study_folder),
        Kind("diary key", lambda: [written(diary.make_key, "a.key")], read_diary_key),
        Kind("questionnaire", questionnaires, lambda d, n: diary.load_questionnaire(d / n)),
        Kind("camera", cameras, read_camera),
        Kind("certificate", certificates, lambda d, n: serve.kept_certificate(d / n, "127.0.0.1")),
    ]
}


NEEDS = {
    "mesh.glb": ("DracoPy",),
    "scan.las": ("laspy",),
    "scan.laz": ("laspy", "lazrs"),
    "scan.e57": ("pye57",),
    "depth": ("PIL", "OpenEXR"),
    "camera": ("yaml",),
    "velodyne": ("yaml",),
    "tum": ("PIL",),
    "trial": ("scipy",),
    "results": ("jinja2",),
    "picture": ("PIL",),
    "certificate": ("cryptography",),
}
"""Modules without which a kind cannot be made or read."""


# --- damage --------------------------------------------------------------------------------------

_NUMBERS = [0, 1, 2, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 2**63 - 1, 2**64 - 1]
_WORDS = [
    b"nan", b"inf", b"-inf", b"1e999", b"1e-400", b"-1", b"0", b"4294967295",
    b"9223372036854775808", b"\xff\xfe", b"\xc3(", b"\x1b[31m", b"\0", b"\x9b", b"",
    b"../../etc/passwd", b"/dev/zero", b"a" * 5000, b"1" * 5000,
    b"!!python/object/apply:os.system", b'encoding="UTF-7"', b'encoding="x"',
    b"<!DOCTYPE a [<!ENTITY b 'c'>]>", b"[" * 3000, b"{}", b"null", b"\r", b"\n\n", b"\t",
]  # fmt: skip


def damage(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage data in one to four places: header numbers, words of a text, bytes or length."""
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        hurt = _HURTS[int(rng.integers(len(_HURTS)))]
        hurt(changed, rng)
    return bytes(changed)


def _place(data: bytearray, rng: np.random.Generator) -> int:
    """Choose a random place, more often in the header than in the rest."""
    reach = len(data) if rng.random() < 0.4 else min(len(data), 400)
    return int(rng.integers(max(1, reach)))


def _number(data: bytearray, rng: np.random.Generator) -> None:
    width = int(rng.choice([1, 2, 4, 8]))
    place = _place(data, rng)
    value = int(_NUMBERS[rng.integers(len(_NUMBERS))]) & ((1 << 8 * width) - 1)
    order = "little" if rng.random() < 0.8 else "big"
    data[place : place + width] = value.to_bytes(width, order)


def _float(data: bytearray, rng: np.random.Generator) -> None:
    value = float(rng.choice([np.nan, np.inf, -np.inf, 1e38, 1e-45, -0.0]))
    place = _place(data, rng)
    form = "<f" if rng.random() < 0.5 else "<d"
    with contextlib.suppress(OverflowError):
        packed = struct.pack(form, value)
        data[place : place + len(packed)] = packed


def _word(data: bytearray, rng: np.random.Generator) -> None:
    """Replace the token around a place."""
    place = _place(data, rng)
    first = place
    while first > 0 and data[first - 1] not in _GAPS:
        first -= 1
    last = place
    while last < len(data) and data[last] not in _GAPS:
        last += 1
    data[first:last] = _WORDS[int(rng.integers(len(_WORDS)))]


_GAPS = frozenset(b" \t\r\n,:;<>[]{}\"'=")


def _bits(data: bytearray, rng: np.random.Generator) -> None:
    if data:
        data[_place(data, rng)] ^= 1 << int(rng.integers(8))


def _cut(data: bytearray, rng: np.random.Generator) -> None:
    del data[int(rng.integers(len(data) + 1)) :]


def _repeat(data: bytearray, rng: np.random.Generator) -> None:
    place = _place(data, rng)
    piece = data[place : place + int(rng.integers(1, 200))]
    data[place:place] = piece * int(rng.integers(1, 4))


def _insert(data: bytearray, rng: np.random.Generator) -> None:
    data[(place := _place(data, rng)) : place] = rng.bytes(int(rng.integers(1, 20)))


_HURTS: list[Callable[[bytearray, np.random.Generator], None]] = [
    _number, _number, _number, _float, _word, _word, _word, _bits, _cut, _repeat, _insert,
]  # fmt: skip


# --- running -------------------------------------------------------------------------------------


@cache
def examples_of(kind: str) -> list[Files]:
    return KINDS[kind].examples()


def run_case(kind: str, seed: int, folder: Path) -> str:
    """Read one damaged input; return a description of the fault of the reader, or ``""``."""
    rng = np.random.default_rng([seed, len(kind), sum(kind.encode())])
    shutil.rmtree(folder, ignore_errors=True)
    example = dict(examples_of(kind)[int(rng.integers(len(examples_of(kind))))])
    name = sorted(example)[int(rng.integers(len(example)))]
    example[name] = damage(example[name], rng)
    lay_out(example, folder)
    start = time.process_time()
    finding = ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            KINDS[kind].read(folder, name)
    except (manip3d.Error, OSError) as error:
        if isinstance(error, manip3d.Error) and not str(error).isprintable():
            finding = f"a message that a terminal would obey: {error!r:.200}"
    except BaseException as error:
        finding = f"{type(error).__module__}.{type(error).__name__}: {error!s:.200}"
    spent = time.process_time() - start
    if not finding and spent > SECONDS:
        finding = f"{spent:.1f} s of processor time"
    return finding


def _limit_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    mapped = pages * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (mapped + MEMORY, mapped + MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _work(kind: str, first: int, count: int, current: Any, pipe: Any) -> None:
    # In memory: on a busy disk, making and removing a folder takes a hundred times as long.
    memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(dir=memory) as root:
        folder = Path(root) / "case"
        examples_of(kind)
        lay_out(examples_of(kind)[0], folder)
        with contextlib.suppress(manip3d.Error):  # imports what is imported when it is used
            KINDS[kind].read(folder, min(examples_of(kind)[0]))
        devnull = os.open(os.devnull, os.O_WRONLY)
        os.dup2(devnull, 2)  # what libraries of others print
        _limit_memory()
        for seed in range(first, first + count):
            current.value = seed
            finding = run_case(kind, seed, folder)
            if finding:
                pipe.send((seed, finding))
    pipe.send(None)


def lay_out(example: Files, folder: Path) -> None:
    """Write the files of an example below a folder."""
    for path, data in example.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(data)


def run(kind: str, first: int, count: int) -> Iterator[tuple[int, str]]:
    """Yield findings as (seed, fault) from a worker process, which is restarted when it dies."""
    context = multiprocessing.get_context("fork")
    last = first + count
    while first < last:
        here, there = context.Pipe(duplex=False)
        current = context.Value("q", first)
        worker = context.Process(target=_work, args=(kind, first, last - first, current, there))
        worker.start()
        there.close()
        finished, told = False, current.value
        try:
            while not finished:
                if here.poll(HANG_S):
                    message = here.recv()
                    if message is None:
                        finished = True
                    else:
                        yield message
                elif current.value == told:
                    worker.kill()
                    yield told, f"no answer for {HANG_S:.0f} s"
                    break
                told = current.value
        except EOFError:
            worker.join()
            yield current.value, f"the process ended with {worker.exitcode}"
        worker.join()
        first = last if finished else current.value + 1


def main() -> int:
    """Run cases of one kind or of all; return exit code 1 if there are findings."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument(
        "--kind", choices=KINDS, action="append", help="Only this kind, or these; default: all."
    )
    parser.add_argument("--cases", type=int, default=10_000, help="Cases in all.")
    parser.add_argument("--first", type=int, default=0, help="First seed of each kind.")
    options = parser.parse_args()
    kinds = options.kind or list(KINDS)
    found = 0
    for kind in kinds:
        share = -(-options.cases // len(kinds))
        start = time.monotonic()
        for seed, what in run(kind, options.first, share):
            found += 1
            print(f"{kind} {seed}: {what}", flush=True)
        print(f"{kind}: {share} cases in {time.monotonic() - start:.1f} s", flush=True)
    print(f"{found} findings")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())

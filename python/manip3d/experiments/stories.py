"""Five stories for the demo page: commands of the package, their results, and pictures of these.

A story runs the same commands that the demo page prints, each in a process of its own, in an
initially empty folder. Its pictures are drawn from the files that the commands wrote, so that a
reader who runs the commands gets what the page shows. Stories are experiments without a published
table: the runner stores and resumes them like all others.
"""

from __future__ import annotations

import ctypes
import json
import os
import shlex
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import datasets
from manip3d._util.fingerprint import presentation_fingerprint
from manip3d.errors import Error
from manip3d.experiments import _phantom, _recorded
from manip3d.experiments._model import Case, Experiment, Plan, Row, counted
from manip3d.experiments._pictures import webp

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.mesh import Mesh

    Image = NDArray[np.uint8]

__all__ = ["STORIES", "command_line", "run_story"]

_VERDICTS = (0, 3, 4)
"""Exit codes that are verdicts: 0 authentic or nothing found, 3 tampered, 4 undecidable."""


@dataclass(frozen=True)
class Shown:
    """Content of a story.

    Attributes
    ----------
    pictures : list of (caption, image)
    facts : list of str
        Sentences with the numbers that the commands printed.
    """

    pictures: list[tuple[str, Image]]
    facts: list[str]


Tell = Callable[[Path, Sequence[Any]], Shown]
"""Function from the commands' folder and the JSON value that each printed to a story's content."""


# --- The runner's side ---------------------------------------------------------------------------


def run_story(case: Case) -> Row:
    """Run a story's commands in an empty folder and draw what they wrote."""
    options = case.options
    with tempfile.TemporaryDirectory(prefix="manip3d-story-") as folder:
        printed = [_run(command, Path(folder)) for command in options["commands"]]
        shown = _TELLERS[options["story"]](Path(folder), printed)
    row: Row = {"facts": shown.facts, "captions": [caption for caption, _ in shown.pictures]}
    return row | {
        f"picture_{number}": webp(image) for number, (_, image) in enumerate(shown.pictures)
    }


def command_line(command: str) -> list[str]:
    """Split a story's command into arguments like a shell, and run ``manip3d`` by this Python.

    Raises
    ------
    Error
        The program is not ``manip3d``, or a variable in the command is not set.
    """
    program, *arguments = shlex.split(os.path.expandvars(command))
    if program != "manip3d" or any("$" in word for word in arguments):
        raise Error(f"expected a command of manip3d whose variables are set, got {command!r}")
    return [sys.executable, "-m", "manip3d", *arguments]


_LIBC = ctypes.CDLL(None)
_PR_SET_PDEATHSIG = 1  # linux/prctl.h


def _end_with_parent() -> None:
    """Let the command end on Ctrl-C and with its parent; called between fork and exec.

    The runner's workers ignore Ctrl-C and are killed; without this call their children would
    continue to run.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def _run(command: str, folder: Path) -> Any:
    """Run a command and return the JSON value that it prints with ``--json``."""
    done = subprocess.run(
        [*command_line(command), "--json", "--quiet"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=_end_with_parent,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
    )
    if done.returncode not in _VERDICTS:
        lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        raise Error(f"{command}: {lines[-1]}")
    return json.loads(done.stdout)


@dataclass(frozen=True)
class _Recorded:
    """Recorded data in place of a story's simulated input, in the folder ``MANIP3D_DATA``.

    Attributes
    ----------
    files : tuple of str
        Paths relative to that folder.
    title : str
        Description for the page.
    data_set : str
        Registered name of the data set, by which the page names its authors; ``""``: none.
    kind : str
        One of `DATA_KINDS`.
    """

    files: tuple[str, ...]
    title: str
    data_set: str = ""
    kind: str = "recorded"

    def sums(self) -> dict[str, str]:
        """Return the files' hashes; an empty dict if a file is missing."""
        root = os.environ.get("MANIP3D_DATA")
        if root is None or not all(Path(root, file).is_file() for file in self.files):
            return {}
        return _recorded.sums(self.files)


def _experiment(
    name: str,
    title: str,
    commands: Callable[[bool], Sequence[str]],
    simulated: str,
    recorded: _Recorded | None = None,
) -> Experiment:
    """Return the experiment of a story.

    Parameters
    ----------
    commands : callable
        Function from whether the recorded data are present to the commands.
    simulated : str
        Description of the simulated input.
    recorded : _Recorded, optional
        Recorded data that are used instead if present.
    """

    def cases(plan: Plan) -> list[Case]:
        sums = recorded.sums() if recorded and plan.data != "simulated" else {}
        options = {
            "model": title,
            "story": name,
            "commands": list(commands(bool(sums))),
            "files": sums,
            "data": recorded.kind if recorded and sums else "simulated",
            "role": recorded.title if recorded and sums else simulated,
            "drawn_by": presentation_fingerprint(),
        }
        inputs = (recorded.data_set,) if recorded and recorded.data_set and sums else ()
        return [Case(run_story, options, inputs=inputs)]

    return Experiment(
        id=f"story-{name}",
        title=title,
        published="",
        data=(recorded.data_set,) if recorded and recorded.data_set else (),
        cases=cases,
        columns=(),
    )


# --- A lighter model -----------------------------------------------------------------------------

_BIPLANE = "$MANIP3D_DATA/meshes/flightgear/G-164A/G-164A.obj.xz"


def _model_commands(recorded: bool) -> list[str]:
    source = _BIPLANE if recorded else "airplane.glb"
    return [
        *([] if recorded else ["manip3d simulate sim:airplane -o airplane.glb"]),
        f"manip3d simplify {source} --ratio 0.1 -o light.glb",
        f"manip3d simplify {source} --ratio 0.1 --method qem-orig -o plain.glb",
        f"manip3d compare {source} light.glb",
        f"manip3d compare {source} plain.glb",
    ]


def _tell_model(folder: Path, printed: Sequence[Any]) -> Shown:
    from manip3d import read_mesh
    from manip3d.experiments._pictures import draw_alike

    *_, light, plain = printed
    source = os.path.expandvars(light["original"])
    meshes = [read_mesh(folder / source), *(read_mesh(folder / f"{n}.glb") for n in _LIGHT)]
    view: dict[str, Any] = {"azimuth": 35.0, "elevation": 18.0, "size": (640, 380)}
    looks = draw_alike(meshes, texture=True, shading="smooth", **view)
    shapes = draw_alike(meshes, texture=False, shading="flat", wireframe=True, **view)
    labels = ["the model", *_LIGHT.values()]
    captions = [
        f"{label}: {counted(mesh.num_faces, 'face')}"
        for label, mesh in zip(labels, meshes, strict=True)
    ]
    pictures = list(zip(captions, looks, strict=True))
    pictures += [(f"{label}, its triangles", image)
                 for label, image in zip(labels, shapes, strict=True)]  # fmt: skip
    return Shown(pictures, [_compared(light, plain)])


_LIGHT = {"light": "the default mode", "plain": "plain quadric collapse"}


def _compared(light: Mapping[str, Any], plain: Mapping[str, Any]) -> str:
    """Return a sentence that compares the errors of both methods."""
    diagonal = light["boundary_gap"]["diagonal"]
    sentences = []
    for record, name in ((light, "the default mode"), (plain, "plain collapse")):
        forward = record["metro"]["area"]["forward"]["mean"] / diagonal
        texture = record.get("texture_error", {}).get("mean")
        moved = (
            ""
            if texture is None
            else f", and its texture moves by {100 * texture:.2f}\N{NO-BREAK SPACE}% of an image"
        )
        sentences.append(
            f"{name} is {forward * 1e3:.3f} thousandths of the model's diagonal off{moved}"
        )
    return f"On average {'; '.join(sentences)}."


# --- A depth image as a few points ---------------------------------------------------------------

_DESK_FOLDER = "rgbd/scene_tum_fr2_desk"
_DESK = f"$MANIP3D_DATA/{_DESK_FOLDER}/frame1"
_POINTS = 5000


def _depth_commands(recorded: bool) -> list[str]:
    if recorded:
        return [
            f"manip3d depth {_DESK}_depth.png --color {_DESK}_color.png --intrinsics tum-fr2 "
            f"--points {_POINTS} -o scene.glb"
        ]
    return [
        "manip3d capture record 'sim:body?motion=wave&rate=8' --frames 8 --lossless-color "
        "-o recording",
        "manip3d depth recording/depth/000007.png --color recording/colour/000007.png "
        f"--intrinsics 365,365,255.5,211.5 --points {_POINTS} -o scene.glb",
    ]


def _tell_depth(folder: Path, printed: Sequence[Any]) -> Shown:
    from manip3d import read_mesh
    from manip3d.io import read_depth
    from manip3d.viewer import people, picture

    record = printed[-1]
    depth = read_depth(folder / record["input"])
    mesh = _near(read_mesh(folder / "scene.glb"))
    view: dict[str, Any] = {"azimuth": 20.0, "elevation": 8.0, "size": (640, 480)}
    pictures = [
        ("the depth image: near is light", people.depth_picture(depth)),
        (
            f"{counted(record['points'], 'point')}, textured, from a little aside",
            picture(mesh, **view),
        ),
        (
            f"its {counted(record['faces'], 'triangle')}",
            picture(mesh, texture=False, shading="flat", wireframe=True, **view),
        ),
    ]
    share = record["points"] / record["points_before"]
    fact = (
        f"{counted(record['points_before'], 'measured pixel')} became "
        f"{counted(record['points'], 'point')} ({100 * share:.1f} %) in "
        f"{record['seconds'] * 1e3:.0f} ms; every point is a pixel of the image, with its "
        "own colour."
    )
    return Shown(pictures, [fact])


def _near(mesh: Mesh) -> Mesh:
    """Remove faces far behind the middle distance of the image, so that the rest fills a picture.

    The middle distance is the median over the image's area. The median over vertices would be
    biased, because a rough wall far away has many vertices.
    """
    distance = -mesh.vertices[:, 2]  # cameras look along -z in glTF
    first, second, third = np.swapaxes((mesh.vertices[:, :2] / distance[:, None])[mesh.faces], 0, 1)
    (a, b), (c, d) = (second - first).T, (third - first).T
    share = np.abs(a * d - b * c)  # twice the area of each face in the image
    farthest = distance[mesh.faces].max(axis=1)
    order = np.argsort(farthest)
    covered = np.cumsum(share[order])
    middle = farthest[order[np.searchsorted(covered, covered[-1] / 2.0)]]
    kept = farthest < 1.6 * middle
    names = ("faces", "face_texcoords", "face_normals", "face_material")
    per_face = {name: getattr(mesh, name) for name in names}
    return mesh.replace(**{n: values[kept] for n, values in per_face.items() if values is not None})


# --- The phantom limb ----------------------------------------------------------------------------

_FILM = (1, 4, 7, 10)
"""Numbers of the frames in the film strip."""


def _phantom_commands(_: bool) -> list[str]:
    return [
        "manip3d phantom render 'sim:body?motion=arm-raise&amputated=right-arm&side=both&rate=8' "
        "--frames 12 -o phantom"
    ]


def _tell_phantom(folder: Path, printed: Sequence[Any]) -> Shown:
    from manip3d.experiments._pictures import read_picture

    (record,) = printed
    frames = [read_picture(folder / "phantom" / f"{number:06d}.png") for number in _FILM]
    width = frames[0].shape[1] // 3
    people = [frame[:, width : 2 * width] for frame in frames]
    drawn = np.any([(picture < 250).any(axis=2) for picture in people], axis=0)  # not white
    box = _phantom.box_of(drawn, margin=8)
    panels = ("what the camera sees", "with the phantom limb", "the same as a mesh, from the side")
    strips = [
        np.hstack([frame[box[0], k * width + box[1].start : k * width + box[1].stop]
                   for frame in frames])
        for k in range(len(panels))
    ]  # fmt: skip
    tracked = record["states"].get("tracking", 0)
    fact = (
        f"The missing {record['limb'].replace('_', ' ')} mirrors the other in {tracked} of "
        f"{counted(record['frames'], 'frame')}; table 4.1 below says how long that takes."
    )
    return Shown(list(zip(panels, strips, strict=True)), [fact])


# --- A forged scan -------------------------------------------------------------------------------

_STREET = "drives/2000_01_01/2000_01_01_drive_0000_sync/velodyne_points/data/0000000000.bin"
_KITTI_FILE = "lidar/kitti_object/velodyne/demo.bin.xz"
_PLACE = "14 -4 -1"


_DETECTORS = {
    "density": "Spacing of the points",
    "occlusion": "What hides what",
    "generic": "The scanner's lattice",
}


def _scan_commands(recorded: bool) -> list[str]:
    source = f"$MANIP3D_DATA/{_KITTI_FILE}" if recorded else _STREET
    return [
        *([] if recorded else ["manip3d simulate sim:street -o drives --frames 1 --no-pictures"]),
        "manip3d simulate sim:car -o car.glb",
        f"manip3d forge lidar ctp {source} --hoax car.glb --up y --position {_PLACE} -o forged.bin",
        f"manip3d inspect {source}",
        "manip3d inspect forged.bin",
    ]


def _tell_scan(folder: Path, printed: Sequence[Any]) -> Shown:
    """Return pictures and facts of a scan before and after a car was added."""
    from manip3d.experiments._scan_pictures import Eye, draw_scan
    from manip3d.io import read_scan

    *_, clean, found = printed
    truth = json.loads((folder / "forged.bin.truth.json").read_text(encoding="utf-8"))
    forged = read_scan(folder / "forged.bin").points
    added = np.zeros(len(forged), bool)
    added[truth["added"]] = True
    target = np.asarray(truth["box"]["center"])
    eye = Eye(position=target + np.array([-15.0, 9.0, 8.5]), target=target, size=(960, 540))
    boxes = [
        (box["center"], box["size"])
        for detector in found["detectors"].values()
        for box in detector["boxes"]
    ]
    pictures = [
        ("the scan as it was", draw_scan(forged[~added], eye)),
        (
            "with a car that was never there, in violet, and the boxes that the detectors drew",
            draw_scan(forged, eye, marked=added, boxes=boxes),
        ),
    ]
    facts = [
        f"The scan as it was: {clean['verdict'].replace('_', ' ')}. The forged one: "
        f"{found['verdict'].replace('_', ' ')}.",
        *(
            f"{_DETECTORS[name]}: {detector['reason']}."
            for name, detector in found["detectors"].items()
            if detector["verdict"] == "tampered"
        ),
    ]
    return Shown(pictures, facts)


# --- A watermarked scan --------------------------------------------------------------------------


_PARKED_CAR = "--box 9.97 -2.7 -0.77 3.9 1.9 1.4 0"


def _proof_commands(recorded: bool) -> list[str]:
    source = f"$MANIP3D_DATA/{_KITTI_FILE}" if recorded else _STREET
    car = f" {_PARKED_CAR}" if recorded else ""  # without a box the nearest object is taken
    return [
        *([] if recorded else ["manip3d simulate sim:street -o drives --frames 1 --no-pictures"]),
        "manip3d watermark keygen sensor.key",
        f"manip3d watermark embed {source} --key sensor.key -o signed.bin",
        "manip3d watermark verify signed.bin --key sensor.key",
        f"manip3d forge lidar translation signed.bin{car} --allow-collision -o moved.bin",
        "manip3d watermark verify moved.bin --key sensor.key --record signed.bin.wm",
    ]


def _tell_proof(folder: Path, printed: Sequence[Any]) -> Shown:
    """Return pictures and facts of a watermarked scan before and after an object was moved."""
    from manip3d.experiments._scan_pictures import Eye, draw_scan
    from manip3d.io import read_scan

    embedded, clean, _, found = printed[-4:]
    truth = json.loads((folder / "moved.bin.truth.json").read_text(encoding="utf-8"))
    signed, moved = (read_scan(folder / name).points for name in ("signed.bin", "moved.bin"))
    touched = np.zeros(len(signed), bool)
    touched[truth["moved_from"]] = True
    (frame,) = found["frames"]
    spans = [span for tile in frame["changed_tiles"] for span in tile["azimuths_deg"]]
    azimuth = np.degrees(np.arctan2(moved[:, 1], moved[:, 0])) % 360.0
    suspected = np.any([(azimuth >= low) & (azimuth < high) for low, high in spans], axis=0)
    target = np.asarray(truth["box"]["center"])
    away = target / np.hypot(target[0], target[1])
    eye = Eye(position=target - 13.0 * away * [1, 1, 0] + [0, 0, 9.0], target=target,
              size=(960, 540))  # fmt: skip
    pictures = [
        ("the watermarked scan, with the object that will be moved in violet",
         draw_scan(signed, eye, marked=touched)),
        ("the object moved, and the sectors that no longer hold in violet",
         draw_scan(moved, eye, marked=suspected)),
    ]  # fmt: skip
    sectors = " and ".join(f"{low:.0f} to {high:.0f}" for low, high in _joined(spans))
    (sent,) = embedded["frames"]
    facts = [
        f"As it was embedded: {clean['verdict']}. With {counted(len(truth['moved']), 'point')} "
        f"moved: {found['verdict']}, at azimuths from {sectors} degrees; the other "
        f"{sent['tiles'] - len(frame['changed_tiles'])} of {sent['tiles']} sectors are proved to "
        "be as they were.",
        "Embedding moved no point by more than 1.8 mm. Without the key nobody can write bits that "
        "verify.",
    ]
    return Shown(pictures, facts)


def _joined(spans: Sequence[Sequence[float]]) -> list[list[float]]:
    """Merge spans that directly follow one another."""
    joined: list[list[float]] = []
    for low, high in sorted(spans, key=lambda span: span[0]):
        if joined and joined[-1][1] == low:
            joined[-1][1] = high
        else:
            joined.append([low, high])
    return joined


_TELLERS: Mapping[str, Tell] = {
    "model": _tell_model,
    "depth": _tell_depth,
    "phantom": _tell_phantom,
    "scan": _tell_scan,
    "proof": _tell_proof,
}

STORIES: tuple[Experiment, ...] = (
    _experiment(
        "model",
        "A textured model at a tenth of its faces",
        _model_commands,
        "a simulated biplane",
        _Recorded(
            tuple(file.path for file in datasets.get("G-164A").files),
            "a biplane of FlightGear's",
            "G-164A",
            "stand-in",
        ),
    ),
    _experiment(
        "depth",
        "A depth image as about 5\u202f000 textured points",
        _depth_commands,
        "a simulated person before a simulated Kinect",
        _Recorded(
            (f"{_DESK_FOLDER}/frame1_depth.png", f"{_DESK_FOLDER}/frame1_color.png"),
            "a desk, recorded by a Kinect (TUM)",
            "scene_tum_desk",
        ),
    ),
    _experiment(
        "phantom",
        "A phantom limb that moves with the other one",
        _phantom_commands,
        "a simulated patient before a simulated Kinect",
    ),
    _experiment(
        "scan",
        "A forged street scan, and who notices",
        _scan_commands,
        "a simulated street",
        _Recorded((_KITTI_FILE,), "a street, recorded by an HDL-64E (KITTI)"),
    ),
    _experiment(
        "proof",
        "A watermarked scan, and where it was changed",
        _proof_commands,
        "a simulated street",
        _Recorded((_KITTI_FILE,), "a street, recorded by an HDL-64E (KITTI)"),
    ),
)
"""The stories in the order of the demo page."""

"""``manip3d phantom``: a missing limb, rendered by mirroring the intact one; and live."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from manip3d.cli import kinds
from manip3d.cli.capture import camera_of_images, open_source
from manip3d.cli.kinds import expect_kind
from manip3d.cli.many import over_files
from manip3d.cli.options import (
    FolderIntrinsics,
    FolderRate,
    FolderUnits,
    Force,
    Jobs,
    Json,
    MostFrames,
    Output,
    Quiet,
)
from manip3d.cli.signals import ended_like_ctrl_c
from manip3d.cli.terminal import Terminal, check_output, counted, left_out, naming_options
from manip3d.errors import InputError

if TYPE_CHECKING:
    from manip3d.capture import RgbdSource
    from manip3d.phantom import LiveReport
    from manip3d.serve import Certificate
    from manip3d.viewer.phantom import PhantomFilm

app = typer.Typer(
    name="phantom",
    help="Render a missing limb by mirroring the intact one.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


class LimbName(StrEnum):
    """The person's own left and right."""

    left_arm = "left-arm"
    right_arm = "right-arm"
    left_leg = "left-leg"
    right_leg = "right-leg"


class Mirroring(StrEnum):
    """At the person's plane of symmetry, as printed, or in the image."""

    reflection = "reflection"
    paper = "paper"
    image = "2d"


class Segmenting(StrEnum):
    """By the nearest skin, or by the nearest bone as printed."""

    skin = "skin"
    paper = "paper"


class Plane(StrEnum):
    """The plane of symmetry: the trunk's, followed from frame to frame, or that of four joints."""

    trunk = "trunk"
    joints = "joints"


class Smoothing(StrEnum):
    """Presets of the filter of joints."""

    default = "default"
    seated = "seated"
    none = "none"


_FILTERS: Mapping[Smoothing, Literal["default", "seated"] | None] = {
    Smoothing.default: "default",
    Smoothing.seated: "seated",
    Smoothing.none: None,
}


def _why_no_skeleton(film: PhantomFilm, *, pose: bool) -> str:
    """Say why there is no phantom limb in any frame, and what would give one."""
    if pose and film.frames_with_color:
        return "nobody was found in the colour images, so there is no phantom limb"
    told = "no frame of the source has a skeleton, so there is no phantom limb "
    other = "joints:SOURCE#FILE takes those of another tracker"
    if not film.frames_with_color:
        return told + (
            "(nor a colour image, in which --pose would find the joints: add those of each depth "
            f"image, in color/ of a folder or in rgb.txt of a TUM sequence; {other})"
        )
    extra = "" if find_spec("mediapipe") else ", with pip install 'manip3d[pose]'"
    return told + f"(--pose finds the joints in colour images{extra}; {other})"


@app.command("render")
@over_files(
    kinds.recording_suffixes,
    whole=kinds.RECORDING,
    writable=lambda: (".mp4", ".png"),
    otherwise=".mp4",
)
def phantom_render(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="An RGB-D recording (a file or folder, such as walk.mkv, a TUM sequence, or a "
            "depth file of UTD-MHAD with its joints beside it) or a simulated person "
            "(sim:body?...).",
        ),
    ],
    output: Output,
    limb: Annotated[
        LimbName | None,
        typer.Option(
            help="Limb to replace; by default the one that a simulated person has lost, else the "
            "right arm."
        ),
    ] = None,
    mode: Annotated[
        Mirroring,
        typer.Option(
            help="Mirroring at the person's plane of symmetry (reflection), as printed (paper), or "
            "in the image (2d)."
        ),
    ] = Mirroring.reflection,
    segmentation: Annotated[
        Segmenting,
        typer.Option(help="Body parts by the nearest skin, or by the nearest bone (paper)."),
    ] = Segmenting.skin,
    smoothing: Annotated[
        Smoothing, typer.Option(help="Smoothing filter of the joints.")
    ] = Smoothing.default,
    plane: Annotated[
        Plane | None,
        typer.Option(
            help="Plane of symmetry: fitted to the trunk, which does not shake with the joints, or "
            "to four joints of each frame. Default: trunk; with --smoothing none, joints."
        ),
    ] = None,
    pose: Annotated[
        bool, typer.Option("--pose", help="Find the joints in the colour image with MediaPipe.")
    ] = False,
    azimuth: Annotated[
        float, typer.Option(help="Direction from which the mesh is drawn, degrees.")
    ] = 35.0,
    frames: MostFrames = None,
    intrinsics: FolderIntrinsics = "",
    units_per_metre: FolderUnits = 0.0,
    rate: FolderRate = 0.0,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Jobs = 0,
) -> None:
    """Draw people with a phantom limb. Each picture shows the camera's image, the phantom limb in
    it, and the mesh from the side.

    The output is a film (.mp4), a contact sheet of the 40 worst frames by the pipeline's own score
    (.png), or a folder of PNG pictures (a name without a suffix). Frames that cannot be read are
    reported and passed over; the exit code is then 1. It is also 1 if no frame shows a phantom
    limb. Frames whose times are no later than those before are left out, which is reported, too.

    Example: manip3d phantom render 'sim:body?amputated=right-arm&frames=30' -o phantom
    """
    from manip3d.viewer.phantom import is_picture_of_phantom, render_phantom

    expect_kind(source, "recording", verb="phantom render")
    suffixes = (".mp4", ".png")
    check_output(output, suffixes, force=force, folder=True, is_ours=is_picture_of_phantom)
    shell = Terminal(as_json=as_json, quiet=quiet)
    with ExitStack() as opened, shell.progress("render") as progress:
        opened.enter_context(naming_options("output", "azimuth", uri="SOURCE"))
        place: str | RgbdSource = source
        if intrinsics or units_per_metre or rate:
            place = opened.enter_context(
                open_source(
                    source, shell, intrinsics=intrinsics, units_per_metre=units_per_metre, rate=rate
                )
            )
        film = render_phantom(
            place,
            output,
            affected=limb.value.replace("-", "_") if limb else None,
            mode=mode.value,
            segmentation=segmentation.value,
            smoothing=_FILTERS[smoothing],
            plane=plane.value if plane else None,
            pose=pose,
            azimuth=azimuth,
            frames=frames,
            overwrite=force,
            threads=jobs,
            progress=progress,
        )
    is_shown = any(film.states.get(state) for state in ("tracking", "degraded", "holding"))
    damaged = film.counters.get("damaged", 0) if not film.errors else 0
    _tell_film(shell, film, output, damaged, is_shown=is_shown, pose=pose)
    shell.result(
        {
            "source": source,
            "output": str(output),
            "limb": film.affected,
            "frames": film.frames,
            "frames_with_skeleton": film.frames_with_skeleton,
            "states": dict(film.states),
            "messages": _messages(film),
            "stage_ms": dict(film.stage_ms),
            "errors": {str(frame): reason for frame, reason in film.errors.items()},
            "counters": dict(film.counters),
        }
    )
    if film.errors or damaged or not is_shown:
        raise typer.Exit(1)


def _messages(film: PhantomFilm) -> dict[str, int]:
    """Return the numbers of frames by message, which names the option that finds joints."""
    from manip3d.modify import PhantomReason
    from manip3d.phantom._session import NO_SKELETON

    own = {PhantomReason.NO_SKELETON.message: NO_SKELETON}
    return {own.get(message, message): number for message, number in film.messages.items()}


def _tell_film(
    shell: Terminal,
    film: PhantomFilm,
    output: Path,
    damaged: int,
    *,
    is_shown: bool,
    pose: bool,
) -> None:
    """Print what was written, implausible frames, and frames that could not be read."""
    told = film.affected.replace("_", " ")
    if not film.frames_with_skeleton:
        told += f"; {_why_no_skeleton(film, pose=pose)}"
    elif not is_shown:
        told += "; no frame shows a phantom limb"
    shell.say(f"wrote {output}: {counted(film.frames, 'frame')}, {told}")
    for message, number in _messages(film).items() if film.frames_with_skeleton else ():
        shell.warn(f"{counted(number, 'frame')}: {message}")
    for frame, reason in film.errors.items():
        shell.warn(f"frame {frame}: {reason}")
    if film.errors:
        shell.warn(f"{counted(len(film.errors), 'frame')} cannot be read")
    for line in left_out({**film.counters, "damaged": damaged}):
        shell.warn(line)


class GameName(StrEnum):
    """The games."""

    bubbles = "bubbles"
    bubbles_legs = "bubbles-legs"
    pedal = "pedal"
    piano = "piano"


def _tell_session(shell: Terminal, report: LiveReport) -> None:
    """Tell what came of a live session, as text and as JSON."""
    shell.say(
        f"{counted(report.frames, 'frame')} in {report.seconds:.1f} s, "
        f"{report.affected.replace('_', ' ')}; {counted(len(report.clients), 'client')}"
    )
    for client in report.clients:
        if client["latency_ms"]:
            middle, high = client["latency_ms"]
            shell.say(
                f"client: {client['acknowledged']} frames, {client['dropped']} dropped; "
                f"latency {middle:.0f} ms, 95 %: {high:.0f} ms"
            )
    for reason, number in report.refused.items():
        shell.say(f"refused {counted(number, 'time')}: {reason}")
    shell.result(
        {
            "limb": report.affected,
            "frames": report.frames,
            "seconds": round(report.seconds, 3),
            "first_frame_s": report.first_frame_s,
            "states": dict(report.states),
            "stage_ms": dict(report.stage_ms),
            "clients": [dict(client) for client in report.clients],
            "refused": dict(report.refused),
            "games": [
                {**vars(summary), "anomalies": [vars(one) for one in summary.anomalies]}
                for summary in report.games
            ],
            "unkept": list(report.unkept),
            "lost_log_lines": report.lost_log_lines,
        }
    )


@app.command("live")
def phantom_live(
    source: Annotated[
        str | None,
        typer.Option(
            metavar="SOURCE",
            help="A camera (openni2:), a recording (a file or folder), which is played over and "
            "over, or a simulated person (sim:body?...); by default a simulated person who has "
            "lost the limb.",
        ),
    ] = None,
    limb: Annotated[
        LimbName | None,
        typer.Option(
            help="Limb to replace; by default that of the participant's enrolment, else the one "
            "that a simulated person has lost, else the right arm."
        ),
    ] = None,
    game: Annotated[
        GameName | None, typer.Option(help="First game; by default one for that limb.")
    ] = None,
    difficulty: Annotated[
        int, typer.Option(min=1, max=3, help="Difficulty of the first game.")
    ] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first game.")] = 0,
    gain: Annotated[
        float,
        typer.Option(
            min=1.0,
            max=2.0,
            help="Virtual enhancement: factor on the angles of the patient's joints.",
        ),
    ] = 1.0,
    pose: Annotated[
        bool,
        typer.Option(
            "--pose",
            help="Find the joints in the colour image with MediaPipe, for sources without any.",
        ),
    ] = False,
    intrinsics: FolderIntrinsics = "",
    units_per_metre: FolderUnits = 0.0,
    rate: FolderRate = 0.0,
    host: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS",
            help="Address of this machine to serve at. At another address than 127.0.0.1, other "
            "machines on its network, such as a headset, can open the page (encrypted, HTTPS).",
        ),
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port on this machine; 0: a free one.")
    ] = 0,
    certificate: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Keep the certificate of the encrypted connection in this file, so that a headset "
            "asks about it only once. A file that does not exist is made.",
        ),
    ] = None,
    is_opened: Annotated[
        bool, typer.Option("--open/--no-open", help="Open the page in the browser.")
    ] = True,
    seconds: Annotated[
        float | None, typer.Option(help="Stop after this many seconds; by default at Ctrl-C.")
    ] = None,
    diary: Annotated[
        Path | None, typer.Option(help="Keep games and ratings of pain in this diary.")
    ] = None,
    participant: Annotated[
        str | None,
        typer.Option(help="Participant who plays; 'manip3d diary enrol' adds one."),
    ] = None,
    diary_key: Annotated[Path | None, typer.Option(help="Key file of an encrypted diary.")] = None,
    log: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write frames, latency and memory into this file every 10 s (JSON lines).",
        ),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Show a phantom limb live in the browser, with a game. Research software.

    The page is served to this machine only (see --host), at the address that is printed. Ctrl-C,
    SIGTERM or closing the terminal ends the session. With a diary, no game starts before the
    patient has rated the pain; if the pain rises by 2 points or the patient feels sick, no further
    game starts that day. A participant can have one session at a time. What could not be kept in
    the diary is printed at the end, and the exit code is then 1.

    Example: manip3d phantom live --no-open --seconds 2
    """
    import webbrowser

    from manip3d.capture import rgbd_address
    from manip3d.phantom import run_live

    if source is not None:
        expect_kind(source, "recording", verb="phantom live")
        source = rgbd_address(source) or source
    if source is None and (intrinsics or units_per_metre or rate):
        raise InputError("--intrinsics, --units-per-metre, --rate: can only be given with --source")
    shell = Terminal(as_json=as_json, quiet=quiet)

    def on_start(url: str, made: Certificate | None) -> None:
        shell.say(f"open {url}")
        if made is not None:
            shell.say("the browser warns that nobody has signed the certificate; compare SHA-256:")
            shell.say(made.fingerprint)

    options = ("seconds", "host", "port", "certificate", "diary", "participant", "log", "gain",
               "units-per-metre", "rate")  # fmt: skip
    with ended_like_ctrl_c(), naming_options(*options, uri="source", key="diary-key"):
        report = run_live(
            source,
            camera=camera_of_images(intrinsics, source) if intrinsics and source else None,
            units_per_metre=units_per_metre or None,
            rate=rate or None,
            affected=limb.value.replace("-", "_") if limb else None,  # type: ignore[arg-type]
            game=game.value if game else None,
            difficulty=difficulty,
            seed=seed,
            gain=gain,
            pose=pose,
            host=host,
            port=port,
            certificate=certificate,
            seconds=seconds,
            diary=diary,
            participant=participant,
            diary_key=diary_key,
            log=log,
            on_start=on_start,
            open_page=webbrowser.open if is_opened else None,
        )
    _tell_session(shell, report)
    if report.lost_log_lines:
        typer.echo(f"lines of the log that could not be written: {report.lost_log_lines}", err=True)
    for one in report.unkept:
        typer.echo(f"not kept in the diary: {one}", err=True)
    if report.unkept:
        raise typer.Exit(1)

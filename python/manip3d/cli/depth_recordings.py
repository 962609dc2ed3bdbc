"""``manip3d depth`` on an RGB-D recording: a mesh of each of its frames."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

from manip3d.cli.depth_options import OPTIONS, DepthMethod, expect_budget, options_of
from manip3d.cli.depth_words import OVERRIDE, has_missed, record, recording_sentence
from manip3d.cli.kinds import kind_of, path_in
from manip3d.cli.options import MISSED
from manip3d.cli.terminal import Terminal, check_output, named_as_options, naming_options
from manip3d.errors import InputError

_NOT_FOR_RECORDINGS = ("unit", "ray_depth", "color", "mask", "confidence", "confidence_max",
                       "bandwidth", "rate")  # fmt: skip
"""Options that are refused for a recording, because its frames state them."""


def simplify_frames(sources: list[str], given: dict[str, Any]) -> bool:
    """Write a mesh of each frame of an RGB-D recording and return True; else return False."""
    if len(sources) != 1 or not _is_recording(sources[0], given["intrinsics"]):
        if given["frames"] is not None:
            raise InputError("--frames: can only be given with an RGB-D recording or --poses")
        return False
    from manip3d import capture, simplify
    from manip3d.capture._folder_camera import images_alone
    from manip3d.cli.capture import open_source

    expect_budget(given["points"], given["ratio"], wanted="--points or --ratio")
    output: Path = given["output"]
    shell = Terminal(as_json=given["as_json"], quiet=given["quiet"])
    folder = Path(sources[0].removeprefix("folder:"))
    images = folder / "depth" if images_alone(folder) else None
    with naming_options(*OPTIONS, *given["shared"]):
        _refuse_for_recordings(images, given)
        check_output(output, (), force=given["force"], folder=True)
        if given["stable"] and given["method"] != DepthMethod.relief:
            raise InputError(f"stable: expected method relief, got {given['method']}")
        options = options_of({**given, "intrinsics": "", "unit": "guess"})
        depth = None
        if folder.is_dir():
            depth = capture.folder_depth(folder, intrinsics=given["intrinsics"], unit=given["unit"])
        per_metre = 0.0 if depth is None else depth.units_per_metre
    if depth is not None:
        shell.say(f"read {depth.sentence}{OVERRIDE if depth.is_guess else ''}")
    with (
        open_source(
            sources[0], shell, intrinsics=given["intrinsics"], units_per_metre=per_metre
        ) as frames,
        shell.progress("simplify") as progress,
    ):
        made = simplify.simplify_recording(
            frames,
            output,
            options,
            stable=given["stable"],
            num_frames=given["frames"],
            replace=given["force"],
            progress=progress,
        )
    shell.say(recording_sentence(made, output))
    failed = {str(n): named_as_options(reason, OPTIONS) for n, reason in made.failed.items()}
    unit = {} if depth is None else {"unit": depth.unit, "unit_guessed": depth.is_guess}
    shell.result({"output": str(output), **unit, "frames": [record(r) for r in made.frames],
                  "failed": failed})  # fmt: skip
    if given["strict"] and (failed or any(map(has_missed, made.frames))):
        raise typer.Exit(MISSED)
    return True


def _refuse_for_recordings(images: Path | None, given: Mapping[str, Any]) -> None:
    """Raise InputError if an option does not go with a recording, or with a folder of images.

    ``images`` is the folder of the depth images whose unit no file of a recording states, if any.
    """
    asked = [
        name
        for name in _NOT_FOR_RECORDINGS
        if given[name] is not False
        and given[name] not in (None, "", "guess")
        and not (images is not None and name == "unit")
    ]
    if refused := [*given["shared"], *asked]:
        taker = "" if images is None else f"; {images}, its depth images alone, takes it"
        raise InputError(f"{refused[0]}: cannot be given with an RGB-D recording{taker}")


def _is_recording(source: str, intrinsics: str) -> bool:
    """Return whether a source is a recording whose camera is known, also by ``--intrinsics``."""
    from manip3d.capture._folder_camera import knows_camera
    from manip3d.io import is_url

    if source == "-" or is_url(source):
        return False
    try:
        kind = kind_of(source)
    except OSError:  # a pattern, or a file that is missed later on
        return False
    if kind != "stream":
        path = path_in(source)
        return kind == "recording" and (
            path.is_file() or knows_camera(path, is_given=bool(intrinsics))
        )
    from manip3d.capture import rgbd_address

    return rgbd_address(source) is not None

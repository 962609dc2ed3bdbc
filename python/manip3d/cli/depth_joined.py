"""``manip3d depth --poses``: several depth images that become one mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from manip3d.cli.depth_frames import SCANS, expect_image, maps_in_folders
from manip3d.cli.depth_options import OPTIONS, expect_budget, options_of
from manip3d.cli.depth_words import (
    OVERRIDE,
    has_missed,
    joint_record,
    joint_sentence,
    warn_if_sparse,
)
from manip3d.cli.kinds import expect_kind, is_picture
from manip3d.cli.options import MISSED
from manip3d.cli.terminal import (
    Terminal,
    check_output,
    counted,
    named_as_options,
    naming_options,
)
from manip3d.errors import InputError
from manip3d.io import DEPTH_SUFFIXES, WRITABLE

_NOT_JOINED = ("mask", "confidence", "confidence_max", "bandwidth", "rate", "by_distance",
               "move_points", "stable")  # fmt: skip


def join(sources: list[str], given: dict[str, Any]) -> bool:
    """With ``--poses``, write one mesh of all files and return True; else return False."""
    if not given["poses"]:
        return False
    from manip3d import simplify
    from manip3d.batch import find_files
    from manip3d.capture._folder_camera import camera_file_of
    from manip3d.simplify._depth_inputs import may_have_8_bits

    expect_budget(given["points"], given["ratio"], wanted="--points or --ratio")
    output: Path = given["output"]
    shell = Terminal(as_json=given["as_json"], quiet=given["quiet"])
    if len(sources) == 1 and not given["intrinsics"]:
        given = {**given, "intrinsics": str(camera_file_of(Path(sources[0])) or "")}
    with naming_options(*OPTIONS, "poses", *given["shared"]):
        refused = [*given["shared"], *(name for name in _NOT_JOINED if given[name])]
        if refused:
            raise InputError(f"{refused[0]}: cannot be given with poses")
        check_output(output, WRITABLE, force=given["force"])
        found = find_files(sources, suffixes=(*DEPTH_SUFFIXES, *SCANS))
        may_be_8_bits = may_have_8_bits(given["unit"], given["intrinsics"])
        maps = maps_in_folders(found)
        others = [f for f in found if f.name not in maps]
        pictures = [f for f in others if is_picture(f.name, may_be_8_bits)]
        for file in pictures:
            if file.is_named or len(pictures) == len(others):
                expect_kind(file.name, "depth", "range grid", verb="depth")
        for file in others:
            if file.is_named and file not in pictures:
                expect_image(file.name, given)
        files = [file.name for file in others if file not in pictures]
        if pictures:
            shell.say(f"{counted(len(pictures), 'file')} skipped, of another kind (picture)")
        if maps:
            words = "(mask or confidences)"
            shell.say(f"{counted(len(maps), 'file')} skipped, of another kind {words}")
        colors = simplify.colors_of_frames(files, given["color"]) if given["color"] else {}
        options = options_of(given)
        with shell.progress("join") as progress:
            result = simplify.simplify_camera_files(
                files,
                given["poses"],
                output,
                options,
                colors=[colors[f] for f in files if colors],
                num_frames=given["frames"],
                progress=progress,
            )
    if result.depth:
        override = OVERRIDE if result.unit_guessed else ""
        shell.say(f"read {named_as_options(result.depth, OPTIONS)}{override}")
    shell.say(joint_sentence(result))
    warn_if_sparse(shell, result)
    shell.result(joint_record(result))
    if given["strict"] and has_missed(result):
        raise typer.Exit(MISSED)
    return True

"""``manip3d simulate``: write simulated drives, scans and meshes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from manip3d.cli.options import Force, Jobs, Json, Output, Quiet, Seed
from manip3d.cli.terminal import Terminal, check_output, check_place, counted, naming_options
from manip3d.errors import InputError


def write_simulated(
    source: str,
    output: Path,
    terminal: Terminal,
    *,
    frames: int,
    resolution: float,
    pictures: bool,
    surround: bool,
    force: bool,
    threads: int,
    seed: int,
) -> dict[str, Any]:
    """Write the drive (a folder), scan or mesh (a file) that ``source`` names.

    Raises
    ------
    InputError
        There is no such source, or an option is out of range.
    """
    from manip3d.simulate import models, scenes

    name = source.removeprefix("sim:")
    if name == "street":
        return _street(
            output, terminal, frames=frames, pictures=pictures, surround=surround, force=force,
            threads=threads, seed=seed,
        )  # fmt: skip
    if name in {**scenes.SCENES, **scenes.CALIBRATION}:
        return _scan(name, output, terminal, resolution, threads, seed)
    if name in models.MODELS:
        return _model(name, output, terminal, seed)
    plain, question, _ = name.partition("?")
    if question and (plain == "street" or plain in scenes.SCENES or plain in models.MODELS):
        raise InputError(
            f"{source}: expected sim:{plain}; give --seed and --frames as options, not after a "
            "question mark"
        )
    raise InputError(
        f"{source}: expected sim:street or a scene: sim:indoor-00 to -16, sim:outdoor-00 to -26, "
        "sim:calibration-indoor-00 to -11, sim:calibration-outdoor-00 to -11; or a model: "
        f"{', '.join(f'sim:{known}' for known in models.MODELS)}"
    )


def _refuse_unused(source: str, **given: bool) -> None:
    """Refuse an option that is ``given`` although it has no effect on this source.

    Nothing is refused for an unknown source, about which another error is raised later.
    """
    import inspect

    from manip3d.simulate import models, scenes

    name = source.removeprefix("sim:")
    noisy = [n for n, make in models.MODELS.items() if "rng" in inspect.signature(make).parameters]
    if name == "street":
        uses, kind = {"frames", "no_pictures", "surround", "seed"}, "a drive"
    elif name in {**scenes.SCENES, **scenes.CALIBRATION}:
        uses, kind = {"resolution", "seed"}, "a scene"
    elif name in models.MODELS:
        uses, kind = ({"seed"} if name in noisy else set()), f"sim:{name}"
    else:
        return
    takers = {"resolution": "a scene"}
    takers["seed"] = f"a drive, a scene, {', '.join(f'sim:{known}' for known in noisy)}"
    for option, is_given in given.items():
        if is_given and option not in uses:
            raise InputError(
                f"--{option.replace('_', '-')}: can only be given with "
                f"{takers.get(option, 'a drive')}, got {kind}"
            )


def _rule_of_folders(source: str) -> Callable[[str], bool] | None:
    """Return which files a folder of drives holds, or None if the source gives a single file."""
    from manip3d.simulate.drives import is_part_of_drives

    return is_part_of_drives if source.removeprefix("sim:") == "street" else None


def _model(name: str, output: Path, terminal: Terminal, seed: int) -> dict[str, Any]:
    import inspect

    from manip3d.io import WRITABLE
    from manip3d.simulate import models

    check_output(output, WRITABLE, force=True)  # before the simulation
    make = models.MODELS[name]
    seeds = {"rng": seed} if "rng" in inspect.signature(make).parameters else {}
    mesh = make(**seeds)
    mesh.write(output)
    terminal.say(f"wrote {output}: {counted(mesh.num_faces, 'face')}")
    return {
        "source": f"sim:{name}",
        "seed": seeds.get("rng"),
        "output": str(output),
        "faces": mesh.num_faces,
    }


def _street(
    output: Path,
    terminal: Terminal,
    *,
    frames: int,
    pictures: bool,
    surround: bool,
    force: bool,
    threads: int,
    seed: int,
) -> dict[str, Any]:
    from manip3d.simulate import street, write_drive

    with terminal.progress("simulate") as progress:
        drive = write_drive(
            street(seed),
            output,
            frames,
            number=seed % 10_000,
            pictures=pictures,
            surround=surround,
            rng=seed,
            threads=threads,
            overwrite=force,
            progress=progress,
        )
    terminal.say(f"wrote {drive}: {counted(frames, 'frame')}")
    return {"source": "sim:street", "seed": seed, "drive": str(drive), "frames": frames}


def _scan(
    name: str, output: Path, terminal: Terminal, resolution: float, threads: int, seed: int
) -> dict[str, Any]:
    from manip3d.io import SCAN_SUFFIXES
    from manip3d.simulate import scenes, terrestrial_scan

    check_output(output, SCAN_SUFFIXES, force=True)  # before the simulation
    named = naming_options("resolution", resolution_deg="resolution")
    with terminal.progress("simulate") as progress, named:
        scan = terrestrial_scan(
            scenes.make(name),
            resolution_deg=resolution,
            rng=seed,
            threads=threads,
            progress=progress,
        )
        scan.frame.write(output)
    terminal.say(f"wrote {output}: {counted(len(scan.points), 'point')}")
    return {
        "source": f"sim:{name}",
        "seed": seed,
        "output": str(output),
        "points": len(scan.points),
        "rows": scan.shape[0],
        "columns": scan.shape[1],
        "mixed": int(scan.mixed.sum()),
    }


_FRAMES, _RESOLUTION = 10, 0.06


def simulate(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="A drive (sim:street), a scene (sim:indoor-00 to -16, sim:outdoor-00 to -26) or a "
            "mesh (sim:airplane, ...).",
        ),
    ],
    output: Output,
    frames: Annotated[int, typer.Option(min=1, help="Number of LiDAR turns of a drive.")] = _FRAMES,
    resolution: Annotated[
        float, typer.Option(help="Angle between neighbouring rays in a scene, degrees.")
    ] = _RESOLUTION,
    no_pictures: Annotated[
        bool, typer.Option("--no-pictures", help="Leave out the cameras of a drive: LiDAR only.")
    ] = False,
    surround: Annotated[
        bool, typer.Option("--surround", help="Give a drive five pairs of cameras, all around.")
    ] = False,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Jobs = 0,
    seed: Seed = 0,
) -> None:
    """Make drives, scans and meshes with known truth.

    A drive is written in KITTI's layout; a scene gives a terrestrial scan, a model a mesh. The seed
    decides the street of a drive, and the noise of scenes, sim:lifeboat and sim:rocker. An option
    without effect on the source is refused.

    Example: manip3d simulate sim:indoor-00 -o scan.pcd
    """
    if surround and no_pictures:
        raise InputError("--surround: cannot be given with --no-pictures")
    _refuse_unused(
        source, frames=frames != _FRAMES, resolution=resolution != _RESOLUTION,
        no_pictures=no_pictures, surround=surround, seed=seed != 0,
    )  # fmt: skip
    check_place(output, force=force, is_ours=_rule_of_folders(source))
    shell = Terminal(as_json=as_json, quiet=quiet)
    record = write_simulated(
        source,
        output,
        shell,
        frames=frames,
        resolution=resolution,
        pictures=not no_pictures,
        surround=surround,
        force=force,
        threads=jobs,
        seed=seed,
    )
    shell.result(record)

"""What simulated frames and scans cost.

``python benchmarks/bench_simulate.py [--rounds N] [--full]`` writes the section `simulate` of
RESULTS.md; ``--full`` scans at 0.04 degrees too.
"""

from __future__ import annotations

import argparse
import functools
from collections.abc import Callable

import tables
from manip3d.simulate import hdl64e, scenes, stereo_pair, street, terrestrial_scan
from measuring import Cost, measure


def best(call: Callable[[], object], rounds: int) -> Cost:
    """The cheapest of several calls."""
    return min((measure(call)[1] for _ in range(rounds)), key=lambda cost: cost.cpu_s)


def main() -> None:
    """Measure and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--full", action="store_true")
    options = parser.parse_args()
    place = street(0)
    body = []

    def row(name: str, cost: Cost) -> None:
        body.append([name, f"{cost.cpu_s:.2f}", f"{cost.peak_bytes / 2**20:.0f}"])

    row("street, world and search structure", best(lambda: street(1).stage, 2))
    lidar = best(lambda: hdl64e(place, 1.0), options.rounds)
    row("HDL-64E, one turn", lidar)
    pictures = best(lambda: stereo_pair(place, 1.0), options.rounds)
    row("stereo pair, 2 x 1242 x 375", pictures)
    for name in ("indoor-00", "outdoor-00", "outdoor-03"):
        scene = scenes.make(name)
        for resolution in (0.06, 0.04) if options.full else (0.06,):
            scan = best(functools.partial(terrestrial_scan, scene, resolution_deg=resolution), 2)
            row(f"terrestrial scan, {name}, {resolution} degrees", scan)
    text = tables.table(["", "processor time, s", "peak, MiB"], body)
    rate = 2.0 / (lidar.cpu_s + pictures.cpu_s)
    text += f"\n\nLiDAR and stereo on two cores kept busy: {rate:.1f} frames/s.\n"
    tables.write_section("simulate", text)


if __name__ == "__main__":
    main()

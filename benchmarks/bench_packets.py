"""Decoding of Velodyne packets compared with the sensor's packet rate and with velodyne-decoder.

``python benchmarks/bench_packets.py [--rounds N]`` writes the section `packets` of the results. One
thread decodes recordings in memory-backed files to frames with all columns.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from measuring import measure, one_thread

sys.path.append(str(Path(__file__).parents[1] / "tests"))

# Packets per second in single-return mode, from the manuals (HDL-64E S2: 1.33 million points per
# second); in dual-return mode twice as many.
SENSORS = {
    "hdl64e": ("HDL-64E", 1_333_000 / 384),
    "hdl32e": ("HDL-32E", 1808.0),
    "vlp16": ("VLP-16", 754.0),
    "vlp32c": ("VLP-32C", 1507.0),
}


def recording(model: str, seconds: float) -> bytes:
    """Make packets of a sensor with 10 turns per second; one firing in eight has no return."""
    made = importlib.import_module("velodyne_packets")
    rate = SENSORS[model][1]
    rng = np.random.default_rng(0)
    columns = 6 if model == "hdl64e" else 12
    frames = []
    for index in range(round(seconds * rate)):
        azimuths = np.arange(columns) + index * columns
        azimuths = (azimuths * 36000 * 10 / (rate * columns)).astype(int)
        raw = rng.integers(500, 40000, (12, 32))
        raw[rng.random(raw.shape) < 1 / 8] = 0
        blocks = [
            made.block(
                int(azimuths[b // 2 if model == "hdl64e" else b]),
                raw[b].tolist(),
                flag=made.LOWER if model == "hdl64e" and b % 2 else made.UPPER,
            )
            for b in range(12)
        ]
        product = 0 if model == "hdl64e" else made.PRODUCT[model]
        frames.append(made.ethernet(made.udp_frame(made.packet(blocks, product=product))))
    data: bytes = made.pcap(frames, step=1.0 / rate)
    return data


def decoders(model: str) -> dict[str, Callable[[Path], int]]:
    """Return functions that decode a recording and return the number of points."""
    from manip3d import capture

    made = importlib.import_module("velodyne_packets")
    own = made.hdl64e_calibration(two_points=True) if model == "hdl64e" else None

    def ours(path: Path) -> int:
        return sum(f.num_points for f in capture.open_lidar(f"pcap:{path}", calibration=own))

    found: dict[str, Callable[[Path], int]] = {"manip3d": ours}
    if importlib.util.find_spec("velodyne_decoder") and model != "hdl64e":
        other = importlib.import_module("velodyne_decoder")
        found["velodyne-decoder"] = lambda path: sum(
            len(points) for _, points in other.read_pcap(str(path), other.Config())
        )
    return found


def main() -> None:
    """Measure and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=2.0, help="of recording")
    arguments = parser.parse_args()
    one_thread()
    import tables

    body = []
    for model, (name, rate) in SENSORS.items():
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "r.pcap"
            path.write_bytes(recording(model, arguments.seconds))
            known = decoders(model)
            best = dict.fromkeys(known, float("inf"))
            points = dict.fromkeys(known, 0)
            for _ in range(arguments.rounds):
                for decoder, decode in known.items():
                    points[decoder], cost = measure(decode, path)
                    best[decoder] = min(best[decoder], cost.cpu_s)
        cells = [
            f"{arguments.seconds / best[d]:.0f}" if d in best else "-"
            for d in ("manip3d", "velodyne-decoder")
        ]
        million = points["manip3d"] / best["manip3d"] / 1e6
        body.append([name, f"{rate:.0f}", *cells, f"{million:.0f}"])
    head = ["times real time", "packets/s", "manip3d", "velodyne-decoder", "million points/s"]
    tables.write_section("packets", tables.table(head, body))


if __name__ == "__main__":
    main()

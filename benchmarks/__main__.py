"""Run all benchmarks one after another: ``python -m benchmarks [TOPIC ...]`` (``make bench``)."""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent

TOPICS = (
    "startup",
    "io",
    "packets",
    "metrics",
    "forensics",
    "watermark",
    "alert",
    "scans",
    "simplify",
    "every_mesh",
    "depth",
    "relief",
    "every_depth",
    "cs3",
    "phantom",
)

parser = argparse.ArgumentParser(description="Write the tables of the results anew; takes hours.")
parser.add_argument(
    "topics", nargs="*", metavar="TOPIC", help=f"default: all of {', '.join(TOPICS)}"
)
topics = parser.parse_args().topics or list(TOPICS)
if unknown := [topic for topic in topics if topic not in TOPICS]:
    parser.error(f"TOPIC: expected some of {', '.join(TOPICS)}, got {unknown[0]}")
for topic in topics:
    subprocess.run([sys.executable, str(HERE / f"bench_{topic}.py")], check=True)

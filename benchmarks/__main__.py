"""All benchmarks, one after the other: ``python benchmarks`` (``make bench``)."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent

for topic in (
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
):
    subprocess.run([sys.executable, str(HERE / f"bench_{topic}.py")], check=True)

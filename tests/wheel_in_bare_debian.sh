#!/usr/bin/env bash
# wheel_in_bare_debian.sh WHEEL: installs the wheel in a Debian root that has Python and nothing
# else of ours (no compiler, no development package), simplifies a file there, reads it back, and
# records and replays frames.
# Needs root, debootstrap and the mirror that apt is configured with.
set -euo pipefail
wheel=$(realpath "$1")
codename=$(. /etc/os-release && echo "$VERSION_CODENAME")
mirror=$(apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' \
  "Codename: $codename" 'Component: main' | head -n 1)

root=$(mktemp -d)
trap 'rm -rf --one-file-system "$root"' EXIT
debootstrap --variant=minbase --include=python3-venv,ca-certificates "$codename" "$root" "$mirror" \
  >"$root.log" 2>&1 || { cat "$root.log" >&2; exit 1; }
rm -f "$root.log"
cp "$wheel" "$root/tmp/"
# The new system reaches the package index as this machine does: names, certificates and pip.conf.
cp -L /etc/resolv.conf /etc/hosts "$root/etc/"
cp -L /etc/ssl/certs/ca-certificates.crt "$root/etc/ssl/certs/"
[ ! -e /etc/pip.conf ] || cp /etc/pip.conf "$root/etc/"

# A flat 20 x 20 grid: at half its faces it is still the unit square.
cat >"$root/tmp/try.sh" <<'END'
set -euo pipefail
cd /tmp
python3 -m venv venv
venv/bin/pip install --quiet ./manip3d-*.whl
venv/bin/manip3d --version
venv/bin/python - <<'PYTHON'
from pathlib import Path
import numpy as np
corner = np.arange(400).reshape(20, 20)[:-1, :-1].ravel() + 1
quads = np.stack([corner, corner + 1, corner + 21, corner + 20], axis=1)
vertices = [f"v {x / 19} {y / 19} 0" for y in range(20) for x in range(20)]
Path("grid.obj").write_text("\n".join(vertices + ["f %d %d %d %d" % tuple(q) for q in quads]))
PYTHON
venv/bin/manip3d simplify grid.obj -o light.glb --ratio 0.5 --mode published --quiet
venv/bin/python - <<'PYTHON'
import numpy as np
import manip3d
mesh = manip3d.read_mesh("light.glb")
assert 0 < mesh.num_faces <= 361, mesh
corners = mesh.vertices[mesh.faces]
area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
assert abs(area - 1) < 1e-6, area
print(f"ok: {mesh.num_faces} faces")
PYTHON
# The wheel's own FFmpeg, with its licence; there is no other here.
venv/bin/manip3d capture list | grep -E "^ok +mkv:"
test -s venv/lib/python3.*/site-packages/manip3d-*.dist-info/licenses/NOTICE.FFmpeg
venv/bin/python - <<'PYTHON'
import numpy as np
from manip3d import Intrinsics, RgbdCalibration, RgbdFrame, capture
camera = RgbdCalibration(Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5))
depth = np.random.default_rng(0).integers(0, 65536, (5, 48, 64), dtype=np.uint16)
frames = [RgbdFrame(image, camera, time_ns=i, number=i) for i, image in enumerate(depth)]
capture.record(frames, "walk.mkv")
assert all((a.depth == b).all() for a, b in zip(capture.open("mkv:walk.mkv"), depth, strict=True))
with open("/proc/self/maps") as maps:
    libraries = {line.split()[-1] for line in maps if "libav" in line}
assert len(libraries) == 3 and all("/manip3d.libs/" in path for path in libraries), libraries
print("ok: recorded and replayed 5 frames")
PYTHON
END
unshare --mount bash -c 'mount -t proc proc "$0/proc" && exec chroot "$0" bash /tmp/try.sh' "$root"

#!/usr/bin/env bash
# build_wheel.sh BIN: dist/ gets the sdist and the wheel made of it, with the shared libraries
# that a bare machine lacks (oneTBB, liblzma) inside and the lowest platform tag it is granted.
# FFmpeg is not in it: it is loaded when a recording is opened. Drivers of cameras are left out.
set -euo pipefail
bin=$1
raw=build/wheel

rm -rf dist "$raw"
"$bin/python" -m build --no-isolation --sdist --outdir dist . >/dev/null
"$bin/pip" wheel --quiet --no-deps --no-build-isolation --wheel-dir "$raw" \
  --config-settings=cmake.define.MANIP3D_FFMPEG=ON \
  --config-settings=cmake.define.MANIP3D_OPENNI2=OFF \
  --config-settings=cmake.define.MANIP3D_FREENECT2=OFF \
  --config-settings=cmake.define.MANIP3D_REALSENSE=OFF \
  --config-settings=cmake.define.MANIP3D_ORBBEC=OFF dist/*.tar.gz
PATH="$PWD/$bin:$PATH" "$bin/auditwheel" repair --wheel-dir dist "$raw"/*.whl

limit=$((15 * 1024 * 1024))
for wheel in dist/*.whl; do
  size=$(stat -c %s "$wheel")
  echo "$wheel: $size bytes"
  [ "$size" -le "$limit" ] || { echo "larger than $limit bytes" >&2; exit 1; }
done

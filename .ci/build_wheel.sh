#!/usr/bin/env bash
# build_wheel.sh BIN: dist/ gets the sdist and the wheel made of it, with the shared libraries
# that a bare machine lacks (FFmpeg as .ci/build_ffmpeg.sh makes it, oneTBB, liblzma ...) inside and
# the lowest platform tag it is granted. Drivers of cameras are left out.
set -euo pipefail
bin=$1
raw=build/wheel
ffmpeg=$PWD/build/ffmpeg/install

.ci/build_ffmpeg.sh
rm -rf dist "$raw"
"$bin/python" -m build --no-isolation --sdist --outdir dist . >/dev/null
# Unpacked at one place, so that a compiler cache knows the files again.
rm -rf build/sdist && mkdir -p build/sdist
tar -xzf dist/*.tar.gz -C build/sdist --strip-components=1
CCACHE_BASEDIR=${CCACHE_BASEDIR:-$PWD} CMAKE_PREFIX_PATH=$ffmpeg "$bin/pip" wheel --quiet --no-deps --no-build-isolation --wheel-dir "$raw" \
  --config-settings=cmake.define.MANIP3D_FFMPEG=ON \
  --config-settings=cmake.define.MANIP3D_LICENSES="$ffmpeg/COPYING.LGPLv2.1.FFmpeg;$ffmpeg/NOTICE.FFmpeg" \
  --config-settings=cmake.define.SODIUM_LIBRARY="$(g++ -print-file-name=libsodium.a)" \
  --config-settings=cmake.define.MANIP3D_OPENNI2=OFF \
  --config-settings=cmake.define.MANIP3D_FREENECT2=OFF \
  --config-settings=cmake.define.MANIP3D_REALSENSE=OFF \
  --config-settings=cmake.define.MANIP3D_ORBBEC=OFF build/sdist
LD_LIBRARY_PATH=$ffmpeg/lib PATH="$PWD/$bin:$PATH" \
  "$bin/auditwheel" repair --wheel-dir dist "$raw"/*.whl

limit=$((15 * 1024 * 1024))
for wheel in dist/*.whl; do
  size=$(stat -c %s "$wheel")
  echo "$wheel: $size bytes"
  [ "$size" -le "$limit" ] || { echo "larger than $limit bytes" >&2; exit 1; }
done

#!/usr/bin/env bash
# build_ffmpeg.sh: FFmpeg as recordings need it (FFV1, Matroska), from Debian's source package, into
# build/ffmpeg/install. It is under the LGPL, hence shared libraries, which whoever gets the wheel
# can replace, and a note beside the licence that says how they were made.
set -euo pipefail
top=$PWD
work=$top/build/ffmpeg
prefix=$work/install
[ ! -e "$prefix/NOTICE.FFmpeg" ] || exit 0

.ci/install_packages.sh dpkg-dev
rm -rf "$work"
mkdir -p "$work/apt/lists/partial" "$work/apt/cache/archives/partial"
cd "$work"

# A list of its own: the mirrors that apt is configured with, sources instead of packages.
codename=$(. /etc/os-release && echo "$VERSION_CODENAME")
apt-get indextargets --format '$(REPO_URI) $(CODENAME)' 'Created-By: Packages' 'Component: main' |
  grep -E " $codename(-security|-updates)?$" | sort -u |
  while read -r mirror suite; do
    printf 'Types: deb-src\nURIs: %s\nSuites: %s\nComponents: main\nSigned-By: %s\n\n' \
      "$mirror" "$suite" /usr/share/keyrings/debian-archive-keyring.gpg
  done >sources.sources
apt=(apt-get -qq -o "Dir::Etc::SourceList=$work/sources.sources" -o Dir::Etc::SourceParts=/dev/null
  -o "Dir::State::Lists=$work/apt/lists" -o "Dir::Cache=$work/apt/cache" -o APT::Sandbox::User=root)
"${apt[@]}" update
"${apt[@]}" source ffmpeg >apt.log 2>&1 || { cat apt.log >&2; exit 1; }

flags=(--disable-everything --disable-autodetect --disable-programs --disable-doc --disable-network
  --disable-avdevice --disable-avfilter --disable-postproc --disable-swresample --disable-swscale
  --enable-encoder=ffv1 --enable-decoder=ffv1 --enable-muxer=matroska --enable-demuxer=matroska
  --enable-shared --disable-static --disable-x86asm)
cd ffmpeg-*/
./configure --prefix="$prefix" "${flags[@]}" >"$work/build.log"
make -j "$(nproc)" install >>"$work/build.log" 2>&1 || { tail -n 50 "$work/build.log" >&2; exit 1; }

cp COPYING.LGPLv2.1 "$prefix/COPYING.LGPLv2.1.FFmpeg"
cat >"$prefix/NOTICE.FFmpeg" <<END
libavformat, libavcodec and libavutil are parts of FFmpeg (https://ffmpeg.org), under the GNU Lesser
General Public License 2.1 or later. They are built, unchanged, from Debian's source package
ffmpeg $(dpkg-parsechangelog --show-field Version) with
  ./configure ${flags[*]}
They can be replaced by other builds of the same version: the shared libraries in manip3d.libs.
END

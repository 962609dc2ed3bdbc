#!/usr/bin/env bash
# make_in_bare_debian.sh TARGET [CORES]: what somebody new sees of `make TARGET` (demo, test): a
# fresh clone of this repository's last commit in a Debian root that has git and make and nothing
# else, without data, on the first CORES processors (default: all). Prints a transcript with times.
# Needs root, debootstrap and the mirror that apt is configured with. Where BARE_DEBIAN names a
# folder, the bare root is kept there for the next time.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
target=$1
cores=${2:-$(nproc)}
codename=$(. /etc/os-release && echo "$VERSION_CODENAME")
mirror=$(apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' \
  "Codename: $codename" 'Component: main' | head -n 1)

folder=$(mktemp -d)
root=$folder/root
trap 'rm -rf --one-file-system "$folder"' EXIT
bare=${BARE_DEBIAN:-$folder/bare}
[ -d "$bare" ] || {
  debootstrap --variant=minbase --include=git,make,ca-certificates "$codename" "$bare.part" \
    "$mirror" >"$folder/log" 2>&1 || { cat "$folder/log" >&2; exit 1; }
  mv "$bare.part" "$bare"
}
cp -a "$bare" "$root"
# The new system reaches the package index as this machine does: names, certificates and pip.conf.
cp -L /etc/resolv.conf /etc/hosts "$root/etc/"
cp -L /etc/ssl/certs/ca-certificates.crt "$root/etc/ssl/certs/"
[ ! -e /etc/pip.conf ] || cp /etc/pip.conf "$root/etc/"
git clone --quiet --no-local "$here/.." "$root/srv/manip3d"

# shellcheck disable=SC2016
inside='mount -t proc proc "$0/proc"; mount -t tmpfs shm "$0/dev/shm" || true
  exec chroot "$0" env -i HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8 TERM=xterm \
    COLUMNS=110 LINES=40 NODE_EXTRA_CA_CERTS=/etc/ssl/certs/ca-certificates.crt make -C /srv/manip3d "$1"'
taskset -c "0-$((cores - 1))" python3 "$here/timed_transcript.py" \
  unshare --mount bash -c "$inside" "$root" "$target"

#!/usr/bin/env bash
# install_packages.sh PACKAGE...: installs those of the Debian packages that are missing.
# Needs root or sudo only when something is missing; without them it says what to install.
set -euo pipefail
aloud=$(dirname "$0")/aloud.sh

is_installed() { dpkg-query -W -f='${db:Status-Status}\n' "$1" 2>/dev/null | grep -qx installed; }

if ! command -v dpkg-query >/dev/null; then
  echo "Not a Debian system; what corresponds to these packages must be there: $*" >&2
  exit 0
fi

missing=()
for package in "$@"; do
  is_installed "$package" || missing+=("$package")
done
[ ${#missing[@]} -gt 0 ] || exit 0

if [ "$(id -u)" -eq 0 ]; then
  as_root=(env)
elif command -v sudo >/dev/null && { sudo -n true 2>/dev/null || [ -t 0 ]; }; then
  as_root=(sudo)
  sudo true # asks for the password now: later nobody would see the question
else
  as_root=()
fi

apt() { DEBIAN_FRONTEND=noninteractive LC_ALL=C apt-get -q -o Dpkg::Use-Pty=0 "$@"; }
# "155 MB to download, 621 MB on disk", where apt knows the packages.
size() {
  apt install --assume-no --no-install-recommends "${missing[@]}" 2>/dev/null |
    sed -nE 's/^Need to get (.*B)(\/.*)? of archives.*/\1 to download,/p
      s/^After this operation, (.*B) of additional .*/\1 on disk/p' | paste -sd' '
}

if [ ${#as_root[@]} -eq 0 ]; then
  printf 'Missing system packages (%s). As root:\n  apt-get install --no-install-recommends %s\n' \
    "$(size)" "${missing[*]}" >&2
  exit 1
fi
# A list that cannot be refreshed (a third-party source that is down) matters only if a package
# of ours is then not found.
"$aloud" "reading which system packages there are" \
  "${as_root[@]}" bash -c 'apt-get -q update || true'
echo "system packages to install: ${missing[*]}"
"$aloud" "installing them ($(size))" "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive LC_ALL=C \
  apt-get -q -o Dpkg::Use-Pty=0 install -y --no-install-recommends "${missing[@]}"

#!/usr/bin/env bash
# install_packages.sh PACKAGE...: installs those of the Debian packages that are missing.
# Needs root or sudo only when something is missing; without them it says what to install.
set -euo pipefail

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
else
  printf 'Missing system packages. As root:\n  apt-get install --no-install-recommends %s\n' \
    "${missing[*]}" >&2
  exit 1
fi

log=$(mktemp)
trap 'rm -f "$log"' EXIT
apt() { "${as_root[@]}" DEBIAN_FRONTEND=noninteractive apt-get -qq -o Dpkg::Use-Pty=0 "$@"; }
echo "installing ${missing[*]}"
# A list that cannot be refreshed (a third-party source that is down) matters only if a package
# of ours is then not found.
apt update >"$log" 2>&1 || true
apt install -y --no-install-recommends "${missing[@]}" >>"$log" 2>&1 || {
  cat "$log" >&2
  exit 1
}

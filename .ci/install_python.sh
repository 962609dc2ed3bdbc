#!/usr/bin/env bash
# install_python.sh VENV REQUIREMENTS: installs into VENV what the file names. uv chooses and unpacks
# packages in a small part of the processor time that pip needs, which would be taken from the
# compiler beside it. Where uv does not work (no wheel for the machine, an index that it does not
# reach), pip does all.
set -euo pipefail
pip=$1/bin/pip
requirements=$2

configuration=$("$pip" config list)
# configured NAME: an option that pip's files or environment set, the environment's first.
configured() { sed -n "s/^[^=]*\.$1='\(.*\)'\$/\1/p" <<<"$configuration" | head -n 1; }
# uv_reads VARIABLE VALUE: tells uv, unless somebody has told it, or there is nothing to tell.
uv_reads() { [ -z "$2" ] || [ -n "${!1-}" ] || export "$1=$2"; }
uv_reads UV_DEFAULT_INDEX "$(configured index-url)"
uv_reads UV_INDEX "$(configured extra-index-url)"
uv_reads UV_FIND_LINKS "$(configured find-links | tr ' ' ',')"
uv_reads UV_CONSTRAINT "$(configured constraint)"
uv_reads HTTPS_PROXY "$(configured proxy)"
uv_reads SSL_CERT_FILE "$(configured cert)"
uv_reads UV_SYSTEM_CERTS true

# Python compiles what is imported: neither installer need do so.
if ! { "$pip" install --no-compile --progress-bar off --only-binary uv 'uv>=0.5' &&
  "$1/bin/uv" pip install --python "$1/bin/python" -r "$requirements"; }; then
  "$pip" install --no-compile --progress-bar off -r "$requirements"
fi

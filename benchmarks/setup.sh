#!/usr/bin/env bash
# Fetches and builds the peers that bench_simplify.py compares with. Nothing else needs them: they
# are no part of `make setup`, of the tests or of CI. MeshLib is free for non-commercial use only.
#   benchmarks/setup.sh [PYTHON]
set -euo pipefail

root=$(cd "$(dirname "$0")/.." && pwd)
python=${1:-$root/.venv/bin/python}
build=$root/build/peers
scratch=$build/crate
meshopt_version=0.7.0  # carries meshoptimizer 1.3

"$python" -m pip install --quiet 'pymeshlab>=2023.12' 'meshlib>=3.0' 'fast-simplification>=0.1.9' \
  'open3d-cpu>=0.19' 'vtk>=9.5' 'trimesh>=4.4' 'pydelatin>=0.4' 'scipy>=1.12'
"$root/.ci/install_packages.sh" libcgal-dev cmake ninja-build g++ libeigen3-dev libtbb-dev \
  liblzma-dev zlib1g-dev nlohmann-json3-dev

# The crate `meshopt` is the way to a released source of meshoptimizer that is newer than Debian's.
options=()
command -v cargo >/dev/null || "$root/.ci/install_packages.sh" cargo || true
if command -v cargo >/dev/null; then
  mkdir -p "$scratch/src"
  : >"$scratch/src/lib.rs"
  printf '[package]\nname = "scratch"\nversion = "0.0.0"\nedition = "2021"\n\n[dependencies]\nmeshopt = "=%s"\n' \
    "$meshopt_version" >"$scratch/Cargo.toml"
  cargo fetch --quiet --manifest-path "$scratch/Cargo.toml"
  source=$(find "${CARGO_HOME:-$HOME/.cargo}/registry/src" -maxdepth 2 -type d \
    -name "meshopt-$meshopt_version" -print -quit)/vendor/src
  options+=("-DMESHOPTIMIZER_SOURCE=$source")
else
  echo "cargo: not found; meshoptimizer is left out" >&2
fi

cmake -S "$root/benchmarks/cpp" -B "$build" -G Ninja -DCMAKE_BUILD_TYPE=Release "${options[@]}"
cmake --build "$build"

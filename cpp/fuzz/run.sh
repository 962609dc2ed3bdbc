#!/bin/bash
# Runs each fuzz target over its corpus, then EXECUTIONS times (for at most FUZZ_SECONDS seconds, if
# this is set); one target per core.
# usage: cpp/fuzz/run.sh EXECUTIONS [TARGET...]      TARGET: obj, mtl, ply, ...; default: all
# Kernels (metrics, simplify, cs3, phantom, ...) run a tenth of EXECUTIONS.
# Build first: cmake --preset sanitizers && cmake --build --preset sanitizers. FUZZ_BUILD names another folder.
# Exits with 1 if a target found something; its input is in the folder `findings`.
set -u
shopt -s nullglob
here=$(cd "$(dirname "$0")" && pwd)
build=${FUZZ_BUILD:-$here/../../build/sanitizers/cpp/fuzz}
executions=${1:?usage: run.sh EXECUTIONS [TARGET...]}
shift
# Kernels are slower than parsers, because each execution calls them several times. The slowest ones
# start first.
kernels=" detectors phantom relief watermark watermark_picture cs3 attacks metrics cross_modal "
kernels+="simplify grid_delaunay "
export kernels
if [ $# -eq 0 ]; then
  set -- $kernels
  for source in "$here"/fuzz_*.cpp; do
    name=$(basename "$source" .cpp)
    name=${name#fuzz_}
    [[ $kernels == *" $name "* ]] || set -- "$@" "$name"
  done
fi
findings=$build/findings
mkdir -p "$findings"

fuzz() {
  local name=$1 options program corpus log work count runs dictionary result done_runs rate artifact
  local failed=0
  # Timeout: the slowest input (the origin of a scan) takes 0.15 s in a release build, 6 s under the
  # sanitizers, and 12 s with them on a busy machine.
  options=(-max_len=65536 -malloc_limit_mb=256 -timeout=40 -seed=1 "-artifact_prefix=$findings/")
  program=$build/fuzz_$name
  corpus=$here/corpus/$name
  log=$findings/$name.log
  work=$(mktemp -d)
  mkdir -p "$corpus"
  count=$(find "$corpus" -type f | wc -l)
  runs=$executions
  [[ $kernels == *" $name "* ]] && runs=$((executions / 10))
  dictionary=()
  [ -e "$here/$name.dict" ] && dictionary=("-dict=$here/$name.dict")
  [ -z "${FUZZ_SECONDS:-}" ] || options+=("-max_total_time=$FUZZ_SECONDS")
  # libFuzzer first runs the whole corpus, which contains all past findings, without a time limit. It
  # would skip empty files and cut long ones, so that these are errors here. Then it makes new inputs,
  # which depend on addresses and threads: the same seed does not give the same inputs.
  find "$corpus" -type f \( -empty -o -size +65536c \) >"$log"
  if [ ! -s "$log" ] &&
    "$program" "${options[@]}" "${dictionary[@]}" -runs="$runs" -print_final_stats=1 "$work" "$corpus" \
      >"$log" 2>&1; then
    result=ok
  else
    result="FINDING, see $log"
    failed=1
  fi
  rm -rf "$work"
  done_runs=$(sed -n 's/^stat::number_of_executed_units: *//p' "$log")
  rate=$(sed -n 's/^stat::average_exec_per_sec: *//p' "$log")
  printf '%-14s %8s %12s %10s %s\n' "$name" "$count" "${done_runs:--}" "${rate:--}" "$result"
  # Print the input, because CI keeps only the output.
  if [ "$failed" -ne 0 ]; then
    grep -v '^#' "$log" | tail -n 30
    artifact=$(sed -n 's/.*Test unit written to //p' "$log" | tail -n 1)
    [ -z "$artifact" ] || { echo "base64 of $(basename "$artifact"):" && base64 "$artifact"; }
  fi
  return $failed
}
export -f fuzz
export here build findings executions

printf '%-14s %8s %12s %10s %s\n' target corpus executions exec/s result
printf '%s\0' "$@" | xargs -0 -n 1 -P "$(nproc)" bash -c 'fuzz "$1" || exit 1' fuzz || exit 1

#!/bin/bash
# Runs each fuzz target over its corpus, then EXECUTIONS times, FUZZ_SECONDS at most where it is set;
# one per core.
# usage: cpp/fuzz/run.sh EXECUTIONS [TARGET...]      TARGET: obj, mtl, ply, ...; default: all
# Kernels (metrics, simplify, cs3, phantom, ...) run a tenth of that.
# Build first: cmake --preset sanitizers && cmake --build --preset sanitizers. FUZZ_BUILD names another folder.
# Ends with 1 when a target found something; the input is left in the folder `findings`.
set -u
shopt -s nullglob
here=$(cd "$(dirname "$0")" && pwd)
build=${FUZZ_BUILD:-$here/../../build/sanitizers/cpp/fuzz}
executions=${1:?usage: run.sh EXECUTIONS [TARGET...]}
shift
# Kernels are no parsers: each execution runs them several times over. The longest begin.
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
  # What takes .15 s as delivered took 6 s under the sanitizers (the origin of a scan), 12 on a busy machine.
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
  # libFuzzer runs the whole corpus first, which holds every past finding, however long that takes; but
  # it would leave out what is empty and cut what is too long. Then it makes new inputs: not the same
  # ones for the same seed, since what it sees of addresses and threads differs from run to run.
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
  # Where only the output is kept, as of CI, the input can be made again from it.
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

#!/usr/bin/env bash
# aloud.sh TITLE COMMAND...: runs the command and says every EVERY (5) seconds for how long it has
# run and what it printed last. Lines that match SAY (an extended regular expression) are shown at
# once; everything is shown when the command fails.
set -uo pipefail
title=$1
shift
every=${EVERY:-5}
log=$(mktemp)
trap 'rm -f "$log"' EXIT

say() { printf '%5d s  %s\n' "$SECONDS" "${1:0:110}"; }

echo "== $title"
"$@" </dev/null 2>&1 | {
  part="" last="" said=0
  while true; do
    if IFS= read -r -t "$every" line; then
      last=$part$line part=""
      printf '%s\n' "$last" >>"$log"
      if [ -n "${SAY-}" ] && [[ $last =~ $SAY ]]; then
        say "$last"
        said=$SECONDS
      fi
    elif [ $? -gt 128 ]; then # nothing came in time; bash keeps the beginning of a line
      part+=$line
    else
      printf '%s' "$line" >>"$log"
      break
    fi
    if [ $((SECONDS - said)) -ge "$every" ]; then
      say "${part:-$last}"
      said=$SECONDS
    fi
  done
}
status=${PIPESTATUS[0]}
if [ "$status" -eq 0 ]; then
  say "done"
else
  cat "$log" >&2
  printf '%s: failed with status %d after %d s\n' "$title" "$status" "$SECONDS" >&2
fi
exit "$status"

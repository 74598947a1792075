#!/usr/bin/env bash
# Counts instructions: of primary and of shadow rays, alone and in packets, and of install a
# triangle. A count stands still where times do not. Needs valgrind.
#
#   bench/callgrind.sh FILE.trex    writes one JSON document to stdout
set -euo pipefail
file=$(realpath "${1:?usage: bench/callgrind.sh FILE.trex}")
cd "$(dirname "$0")/.."
command -v valgrind >/dev/null || { echo "valgrind is not installed" >&2; exit 1; }
cargo build --release -q -p trex-bench --example counts
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
counts=
for step in alone packets shadow-alone shadow-packets install; do
    steps=$(valgrind --tool=callgrind --toggle-collect='counts::measured*' --callgrind-out-file="$work/out" \
        target/release/examples/counts "$file" "$step" 2>"$work/log")
    all=$(sed -n 's/.*Collected : *\([0-9]*\).*/\1/p' "$work/log")
    counts="$counts${counts:+, }\"${step//-/_}\": $(awk "BEGIN { printf \"%.1f\", $all / $steps }")"
done
echo "{\"schema\": \"trex.bench-callgrind/1\", \"command\": \"bench/callgrind.sh $1\", \"scene\": \"$1\", \"instructions\": {$counts}}"

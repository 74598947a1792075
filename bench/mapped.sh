#!/usr/bin/env bash
# Pages of 469 million triangles by a mapping of the file and by ours, in a control group of a sixteenth of the file: ten minutes of a
# quiet machine, 12 GiB of disk, and the right to make memory control groups (v1) and to set the disk's read-ahead, which is 128 KiB
# meanwhile, as Linux has it: plain faults read that much each.
#
#   bench/mapped.sh WORK_FOLDER
set -euo pipefail
work=$(realpath "${1:?usage: bench/mapped.sh WORK_FOLDER}")
cd "$(dirname "$0")/.."
root=$PWD
source bench/record.sh
cargo build --release -q -p trex -p trex-bench
cd "$work"
model=isosurface-469m.trex
[ -e $model ] || "$trex" build gen:isosurface:469M -o $model --memory-limit 4GiB --no-asvo --progress none

read_ahead=/sys/class/bdi/$(stat -c %Hd:%Ld .)/read_ahead_kb
before=$(cat "$read_ahead")
trap 'echo "$before" >"$read_ahead"' EXIT
echo 128 >"$read_ahead"
by=measured capped mapped-isosurface-469m $(($(stat -c %s $model) / 16)) io $model --peer mmap --depth 32 --memory-limit-mib 81
"$root/target/release/trex-bench" --root "$root" docs

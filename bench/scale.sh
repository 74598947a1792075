#!/usr/bin/env bash
# What models of rising size cost, up to 469 million triangles: an hour of a quiet machine, 8 GiB of memory and 16 GiB of disk.
#
#   bench/scale.sh WORK_FOLDER
set -euo pipefail
work=$(realpath "${1:?usage: bench/scale.sh WORK_FOLDER}")
cd "$(dirname "$0")/.."
root=$PWD
source bench/record.sh
cargo build --release -q -p trex -p trex-bench
cd "$work"
for model in isosurface:469M pipes:366M; do
    kind=${model%:*}
    record scale-$kind bench scale gen:$kind:1M gen:$kind:10M gen:$kind:100M gen:$model -o scale-$kind
done
"$root/target/release/trex-bench" --root "$root" docs

#!/usr/bin/env bash
# What the light of the pictures before is worth while a hand flies: with it and without, in turns, on four kinds of model, each run
# a record of its own. Half an hour of a quiet machine; page files and references that are missing are made first.
#
#   bench/history.sh WORK_FOLDER [ROUNDS]
set -euo pipefail
work=$(realpath "${1:?usage: bench/history.sh WORK_FOLDER [ROUNDS]}")
rounds=${2:-10}
cd "$(dirname "$0")/.."
root=$PWD
cargo build --release -q -p trex -p trex-bench
source bench/record.sh
cd "$work"
build_kinds

for model in pipes-100m isosurface-100m scan-100m kicad-grid; do
    [ -e $model.trex ] || continue
    name=${model%-100m}
    for round in $(seq "$rounds"); do
        for way in $( ((round % 2)) && echo off on || echo on off); do
            record "history-$name-$way" stress $model.trex --scenario fly --memory-limit 256MiB --resolution 512x512 \
                --history "$way" --switches 1 --reference-spp 16 --references "fly-$name.references" || true
        done
    done
done
"$root/target/release/trex-bench" --root "$root" docs

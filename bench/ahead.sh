#!/usr/bin/env bash
# What reading ahead is worth: a hand that moves and views that jump, with it and without, in turns, on four kinds of model, each
# run a record of its own. An hour and a half of a quiet machine; page files that are missing are built first.
#
#   bench/ahead.sh WORK_FOLDER [FLIGHTS]
set -euo pipefail
work=$(realpath "${1:?usage: bench/ahead.sh WORK_FOLDER [FLIGHTS]}")
flights=${2:-20}
cd "$(dirname "$0")/.."
root=$PWD
cargo build --release -q -p trex -p trex-bench
source bench/record.sh
cd "$work"
build_kinds

# judged ROUNDS SCENARIO ARGUMENTS...: both ways in turns, on each model.
judged() {
    local rounds=$1 scenario=$2
    shift 2
    for model in pipes-100m isosurface-100m scan-100m kicad-grid; do
        [ -e $model.trex ] || continue
        local name=${model%-100m} files=()
        [[ $scenario != fly ]] || files=(--references "$scenario-$name.references")
        for round in $(seq "$rounds"); do
            for way in $( ((round % 2)) && echo off on || echo on off); do
                record "ahead-$scenario-$name-$way" stress $model.trex --scenario "$scenario" --memory-limit 256MiB \
                    --resolution 512x512 --prefetch "$way" "$@" "${files[@]}" || true
            done
        done
    done
}
judged "$flights" fly --switches 1 --reference-spp 16
judged 5 drag --switches 1
judged 1 teleport --switches 20
judged 1 flip --switches 20
"$root/target/release/trex-bench" --root "$root" docs

#!/usr/bin/env bash
# What the light of earlier pictures is worth: while a hand flies, and in views that come back. All of it, that of the picture before
# alone, and none, in turns, on four kinds of model, each run a record of its own. An hour of a quiet machine; page files and
# references that are missing are made first.
#
#   bench/history.sh WORK_FOLDER [FLIGHTS [FLIP_ROUNDS]]
set -euo pipefail
work=$(realpath "${1:?usage: bench/history.sh WORK_FOLDER [FLIGHTS [FLIP_ROUNDS]]}")
flights=${2:-10}
flips=${3:-2}
cd "$(dirname "$0")/.."
root=$PWD
cargo build --release -q -p trex -p trex-bench
source bench/record.sh
cd "$work"
build_kinds
# Inside of the plant, where the first second is measured.
cp "$root/bench/scenes/pipes-100m-inside-views.toml" .

# turned ROUND WAY...: the ways, each round from another one on.
turned() {
    local by=$(($1 % ($# - 1)))
    shift
    echo "${@:by+1}" "${@:1:by}"
}

for model in pipes-100m isosurface-100m scan-100m kicad-grid; do
    [ -e $model.trex ] || continue
    name=${model%-100m}
    views=()
    [ $name != pipes ] || views=(--views pipes-100m-inside-views.toml)
    for round in $(seq "$flips"); do
        for way in $(turned "$round" on picture off); do
            record "history-flip-$name-$way" stress $model.trex --scenario flip "${views[@]}" --memory-limit 256MiB \
                --resolution 1280x720 --history "$way" --switches 24 --hold 3200 --reference-spp 64 \
                --references "$name.references" || true
        done
    done
    for round in $(seq "$flights"); do
        for way in $(turned "$round" on picture off); do
            record "history-fly-$name-$way" stress $model.trex --scenario fly --memory-limit 256MiB --resolution 512x512 \
                --history "$way" --switches 1 --reference-spp 16 --references "fly-$name.references" || true
        done
    done
done
"$root/target/release/trex-bench" --root "$root" docs

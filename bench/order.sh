#!/usr/bin/env bash
# Which tiles should come first: by what catches the eye, or by what is likely to be wrong, in turns, on four kinds of model, each run
# a record of its own. Twenty minutes of a quiet machine; page files and references that are missing are made first.
#
#   bench/order.sh WORK_FOLDER [ROUNDS]
set -euo pipefail
work=$(realpath "${1:?usage: bench/order.sh WORK_FOLDER [ROUNDS]}")
rounds=${2:-3}
cd "$(dirname "$0")/.."
root=$PWD
cargo build --release -q -p trex -p trex-bench
source bench/record.sh
cd "$work"
build_kinds
cp "$root/bench/scenes/pipes-100m-inside-views.toml" .

for model in isosurface-100m pipes-100m kicad-grid scan-100m; do
    [ -e $model.trex ] || continue
    name=${model%-100m}
    views=()
    [ $name != pipes ] || views=(--views pipes-100m-inside-views.toml)
    for round in $(seq "$rounds"); do
        for order in $( ((round % 2)) && echo saliency error || echo error saliency); do
            record "order-$name-$order" stress $model.trex --scenario flip "${views[@]}" --tile-order $order --switches 8 --hold 3200 \
                --memory-limit 256MiB --resolution 1280x720 --reference-spp 64 --references "$name.references" || true
        done
    done
done
"$root/target/release/trex-bench" --root "$root" docs

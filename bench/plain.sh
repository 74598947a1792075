#!/usr/bin/env bash
# What a scene does not require is not paid for: bytes a triangle, the memory of a first picture and the time of a complete one, of a
# model with colours and all its light, without each, and without both, which needs no voxels in the file either. Ten minutes of a
# quiet machine; models that are missing are built first.
#
#   bench/plain.sh WORK_FOLDER
set -euo pipefail
work=$(realpath "${1:?usage: bench/plain.sh WORK_FOLDER}")
cd "$(dirname "$0")/.."
root=$PWD
cargo build --release -q -p trex -p trex-bench
source bench/record.sh
cd "$work"

cp "$root"/bench/scenes/{isosurface,pipes,scan}-20m-views.toml .

# taken KIND FORM FILE ARGUMENTS...: three records of a page file: what it is, its first picture, its views, the same of all files of a kind.
taken() {
    local kind=$1 name=$1-$2 file=$3
    shift 3
    record plain-info-$name info $file
    for _ in 1 2 3; do
        record plain-start-$name render $file -o start.png --overwrite --resolution 64x64 --spp 1 "$@"
    done
    record plain-views-$name stress $file --scenario flip --views $kind-20m-views.toml --switches 20 --memory-limit 1GiB "$@" || true
}
for kind in isosurface pipes scan; do
    for form in "full :1:colors=high" "no-colours " "no-voxels :1:colors=high --no-asvo" "plain  --no-asvo"; do
        read -r name model way <<<"$form"
        [[ $model != --* ]] || { way=$model model=; }
        [ -e plain-$kind-$name.trex ] ||
            "$trex" build gen:$kind:20M$model -o plain-$kind-$name.trex $way --memory-limit 2GiB --progress none
    done
    taken $kind full plain-$kind-full.trex
    taken $kind no-colours plain-$kind-no-colours.trex
    taken $kind direct plain-$kind-full.trex --integrator direct
    taken $kind no-voxels plain-$kind-no-voxels.trex --integrator direct
    taken $kind plain plain-$kind-plain.trex --integrator direct
done
"$root/target/release/trex-bench" --root "$root" docs

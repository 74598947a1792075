#!/usr/bin/env bash
# Rays and pages on four kinds of model, beside Embree and fio: what docs/measurements.md shows of them, kept as records.
# Half an hour of a quiet machine with Debian's libembree-dev and fio; models that are missing are built first.
#
#   bench/rays.sh WORK_FOLDER [SIZE]        SIZE: triangles of each model, 20M unless told
set -euo pipefail
work=$(realpath "${1:?usage: bench/rays.sh WORK_FOLDER [SIZE]}")
size=${2:-20M}
cd "$(dirname "$0")/.."
root=$PWD
source bench/record.sh
cargo build --release -q -p trex
cargo build --release -q -p trex-bench --features peer-embree
cd "$work"
models=$root/../shared/models

# G-rays in as many voxels as the scene has triangles.
voxels=$([ "${size%M}" -ge 20 ] && echo 1024 || echo 512)
build() {
    local name=$1
    shift
    [ -e "$name" ] || "$trex" build "$@" -o "$name" --voxels "$voxels" --memory-limit 2GiB --progress none
}
for kind in isosurface pipes scan; do
    build $kind-${size,,}.trex gen:$kind:$size
done
if [ -d "$models" ] && [ ! -e kicad-grid-${size,,}.trex ]; then
    cad_grid "${size%M}" kicad-grid.obj
    build kicad-grid-${size,,}.trex kicad-grid.obj
    rm kicad-grid.obj
fi

for model in isosurface pipes scan kicad-grid; do
    [ -e $model-${size,,}.trex ] || continue
    measured rays-$model-${size,,} rays $model-${size,,}.trex --peer embree --stats
    measured io-$model-${size,,} io $model-${size,,}.trex --peer fio --peer mmap --depth 32
done
"$root/target/release/trex-bench" --root "$root" docs

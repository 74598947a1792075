#!/usr/bin/env bash
# Rays and pages on four kinds of model, beside Embree and fio: what docs/performance.md shows of them, kept as records.
# Half an hour of a quiet machine with Debian's libembree-dev and fio; models that are missing are built first.
#
#   bench/rays.sh WORK_FOLDER
set -euo pipefail
work=$(realpath "${1:?usage: bench/rays.sh WORK_FOLDER}")
cd "$(dirname "$0")/.."
root=$PWD
source bench/record.sh
cargo build --release -q -p trex
cargo build --release -q -p trex-bench --features peer-embree
cd "$work"
models=$root/../shared/models

# G-rays in as many voxels as the scene has triangles.
build() {
    local name=$1
    shift
    [ -e "$name" ] || "$trex" build "$@" -o "$name" --memory-limit 2GiB --progress none
}
build isosurface-20m.trex gen:isosurface:20M --voxels 1024
build pipes-20m.trex gen:pipes:20M --voxels 512
build scan-20m.trex gen:scan:20M --voxels 1024
if [ -d "$models" ] && [ ! -e kicad-grid-20m.trex ]; then
    cp "$models/cad/kicad_1m.mtl" .
    awk -v copies=20 -f "$root/bench/grid.awk" "$models/cad/kicad_1m.obj" "$models/cad/kicad_1m.obj" >kicad-grid.obj
    build kicad-grid-20m.trex kicad-grid.obj --voxels 1024
    rm kicad-grid.obj
fi

# measured NAME COMMAND...: runs a verb of trex-bench, keeps the document.
measured() {
    local name=$1
    shift
    echo "== $name: trex-bench $*" >&2
    "$root/target/release/trex-bench" "$@" --json >document.json
    "$root/target/release/trex-bench" --root "$root" record --name "$name" --command "trex-bench $*" document.json
}
for model in isosurface pipes scan kicad-grid; do
    [ -e $model-20m.trex ] || continue
    measured rays-$model-20m rays $model-20m.trex --peer embree --stats
    measured io-$model-20m io $model-20m.trex --peer fio --depth 32
done
"$root/target/release/trex-bench" --root "$root" docs

#!/usr/bin/env bash
# Frames with a deadline on 100 million triangles in 128 MiB: what docs/measurements.md shows of them, kept as records.
# An hour and a half of a quiet machine that may make memory control groups (v1); models that are missing are built first.
#
#   bench/frames.sh WORK_FOLDER
set -euo pipefail
work=$(realpath "${1:?usage: bench/frames.sh WORK_FOLDER}")
cd "$(dirname "$0")/.."
root=$PWD
source bench/record.sh
cargo build --release -q -p trex -p trex-bench
cd "$work"
cp "$root/bench/scenes/pipes-100m-views.toml" "$root/bench/scenes/pipes-100m-inside-views.toml" .
models=$root/../shared/models

# built NAME WHAT...: the page file NAME, unless it is there.
built() {
    local name=$1
    shift
    [ -e "$name" ] || "$trex" build "$@" -o "$name" --memory-limit 2GiB --render-limit 128MiB --progress none
}
for size in 1M 10M 100M; do
    built isosurface-${size,,}.trex gen:isosurface:$size
    built pipes-${size,,}.trex gen:pipes:$size
done
built scan-100m.trex gen:scan:100M
if [ -d "$models" ]; then
    built sponza.trex "$models/sponza/sponza.obj"
    if [ ! -e kicad-grid.trex ]; then
        cp "$models/cad/kicad_1m.mtl" .
        awk -v copies=20 -f "$root/bench/grid.awk" "$models/cad/kicad_1m.obj" "$models/cad/kicad_1m.obj" >kicad-grid.obj
        built kicad-grid.trex kicad-grid.obj
        rm kicad-grid.obj
    fi
fi

views="--views pipes-100m-views.toml"
for scenario in flip inside teleport light-edit; do
    stress stress-isosurface-$scenario 128 isosurface-100m.trex --scenario $scenario --switches 200
    stress stress-scan-$scenario 128 scan-100m.trex --scenario $scenario --switches 200
    [ ! -e kicad-grid.trex ] ||
        stress stress-kicad-grid-$scenario 128 kicad-grid.trex --scenario $scenario --switches 200
    stress stress-pipes-$scenario 128 pipes-100m.trex --scenario $scenario $views --switches 200
done
stress stress-isosurface-flip-exact 128 isosurface-100m.trex --scenario flip --lod-error 0 --switches 200
stress stress-isosurface-inside-exact 128 isosurface-100m.trex --scenario inside --lod-error 0 --switches 200
stress stress-pipes-flip-exact 128 pipes-100m.trex --scenario flip $views --lod-error 0 --switches 200

# All that a view needs in memory: what is left is rays.
for model in isosurface-100m pipes-100m kicad-grid sponza; do
    [ -e $model.trex ] || continue
    marked=
    [ $model != pipes-100m ] || marked=$views
    stress memory-${model%-100m}-flip 4096 $model.trex --scenario flip $marked --switches 20
done

# By the size of the model, and by the limit.
for size in 1m 10m 100m; do
    stress size-isosurface-$size 128 isosurface-$size.trex --scenario inside --switches 40
    stress size-pipes-$size 128 pipes-$size.trex --scenario inside --switches 20
done
for mib in 104 128 192 256 512; do
    stress limit-isosurface-$mib $mib isosurface-100m.trex --scenario inside --switches 40
    stress limit-pipes-$mib $mib pipes-100m.trex --scenario flip $views --switches 10
done

# How wrong pictures are while they are made.
stress error-isosurface-flip 128 isosurface-100m.trex --scenario flip --switches 12 --reference-spp 256
stress error-isosurface-inside 128 isosurface-100m.trex --scenario inside --switches 12 --reference-spp 256
stress error-isosurface-light-edit 128 isosurface-100m.trex --scenario light-edit --switches 8 --reference-spp 256
stress error-pipes-flip 128 pipes-100m.trex --scenario flip $views --switches 4 --reference-spp 256

# The same at the size of a page, from jump to jump.
jump() {
    local name=$1
    shift
    resolution=1280x720 stress "jump-$name" 256 "$@" --scenario flip --switches 10 --hold 3200 --reference-spp 64 \
        --references "$name.references"
}
jump isosurface isosurface-100m.trex
jump pipes pipes-100m.trex --views pipes-100m-inside-views.toml
jump scan scan-100m.trex
[ ! -e kicad-grid.trex ] || jump kicad-grid kicad-grid.trex

"$root/target/release/trex-bench" --root "$root" docs

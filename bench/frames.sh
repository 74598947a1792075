#!/usr/bin/env bash
# Frames with a deadline on 100 million triangles: what docs/measurements.md shows of them, kept as records. Two hours of a quiet
# machine that may make memory control groups (v1); models that are missing are built first.
#
#   bench/frames.sh WORK_FOLDER [PART...]
#
#   jumps    how wrong pictures of 1280x720 are after a jump, in 256 MiB, with all in memory, and while a hand drags
#   large    the same at 1920x1080, against references of 16 samples
#   errors   the same at 512x512 in 128 MiB
#   views    200 views that jump, by scenario
#   memory   the same with all that a view needs in memory
#   size     by the size of the model
#   limit    by the limit
#   eviction what the clock reads beside LRU and the optimum, from recorded traces
#   colours  views that jump in 128 MiB, of models with colours of high frequency and without
#
# Without a part: all of them.
set -euo pipefail
work=$(realpath "${1:?usage: bench/frames.sh WORK_FOLDER [PART...]}")
shift
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
build_kinds
for size in 1M 10M; do
    built isosurface-${size,,}.trex gen:isosurface:$size
    built pipes-${size,,}.trex gen:pipes:$size
done
[ ! -d "$models" ] || built sponza.trex "$models/sponza/sponza.obj"

marked="--views pipes-100m-views.toml"
part() {
    local scenario model size mib
    case $1 in
    jumps)
        jumps isosurface isosurface-100m.trex
        jumps pipes pipes-100m.trex --views pipes-100m-inside-views.toml
        jumps scan scan-100m.trex
        [ ! -e kicad-grid.trex ] || jumps kicad-grid kicad-grid.trex
        ;;
    large)
        large isosurface isosurface-100m.trex
        large pipes pipes-100m.trex --views pipes-100m-inside-views.toml
        large scan scan-100m.trex
        [ ! -e kicad-grid.trex ] || large kicad-grid kicad-grid.trex
        ;;
    errors)
        errors isosurface flip 12
        errors isosurface inside 12
        errors isosurface light-edit 8
        errors pipes flip 4 $marked
        ;;
    views)
        for scenario in flip inside teleport light-edit; do
            stress stress-isosurface-$scenario 128 isosurface-100m.trex --scenario $scenario --switches 200
            stress stress-scan-$scenario 128 scan-100m.trex --scenario $scenario --switches 200
            [ ! -e kicad-grid.trex ] ||
                stress stress-kicad-grid-$scenario 128 kicad-grid.trex --scenario $scenario --switches 200
            stress stress-pipes-$scenario 128 pipes-100m.trex --scenario $scenario $marked --switches 200
        done
        stress stress-isosurface-flip-exact 128 isosurface-100m.trex --scenario flip --lod-error 0 --switches 200
        stress stress-isosurface-inside-exact 128 isosurface-100m.trex --scenario inside --lod-error 0 --switches 200
        stress stress-pipes-flip-exact 128 pipes-100m.trex --scenario flip $marked --lod-error 0 --switches 200
        ;;
    memory)
        for model in isosurface-100m pipes-100m kicad-grid sponza; do
            [ -e $model.trex ] || continue
            stress memory-${model%-100m}-flip 4096 $model.trex --scenario flip $([ $model != pipes-100m ] || echo "$marked") --switches 20
        done
        ;;
    size)
        for size in 1m 10m 100m; do
            stress size-isosurface-$size 128 isosurface-$size.trex --scenario inside --switches 40
            stress size-pipes-$size 128 pipes-$size.trex --scenario inside --switches 20
        done
        ;;
    limit)
        for mib in 104 128 192 256 512; do
            stress limit-isosurface-$mib $mib isosurface-100m.trex --scenario inside --switches 40
            stress limit-pipes-$mib $mib pipes-100m.trex --scenario flip $marked --switches 10
        done
        ;;
    eviction)
        for model in isosurface-100m scan-100m kicad-grid; do
            [ ! -e $model.trex ] || measured eviction-${model%-100m} eviction $model.trex --scenario teleport --switches 40
        done
        measured eviction-pipes eviction pipes-100m.trex --scenario flip $marked --switches 40
        ;;
    colours)
        for model in isosurface pipes scan; do
            built $model-100m-colours.trex gen:$model:100M:1:colors=high
            record info-$model-100m info $model-100m.trex
            record info-$model-100m-colours info $model-100m-colours.trex
            stress colours-$model-without 128 $model-100m.trex --scenario teleport --switches 100
            stress colours-$model-with 128 $model-100m-colours.trex --scenario teleport --switches 100
        done
        ;;
    *)
        echo "bench/frames.sh: no part is called $1" >&2
        return 2
        ;;
    esac
}

# jumps NAME MODEL ARGUMENTS...: from view to view, in 256 MiB and with all in memory, and a drag.
jumps() {
    local name=$1 resolution=1280x720
    shift
    local flip=("$@" --scenario flip --hold 3200 --reference-spp 64 --references "$name.references")
    stress "jump-$name" 256 "${flip[@]}" --switches 12
    stress "jump-$name-in-memory" 4096 "${flip[@]}" --switches 12
    stress "drag-$name" 256 "$@" --scenario drag --switches 1 --reference-spp 16 --references "drag-$name.references"
}

# large NAME MODEL ARGUMENTS...: from view to view, in 256 MiB.
large() {
    local name=$1 resolution=1920x1080
    shift
    stress "large-$name" 256 "$@" --scenario flip --hold 3200 --reference-spp 16 --references "large-$name.references" --switches 12
}

# errors MODEL SCENARIO SWITCHES ARGUMENTS...: in 128 MiB, against 256 samples.
errors() {
    local model=$1 scenario=$2 switches=$3
    shift 3
    stress "error-$model-$scenario" 128 $model-100m.trex --scenario $scenario "$@" --switches $switches --reference-spp 256 \
        --references "error-$model-$scenario.references"
}

[ $# -gt 0 ] || set -- jumps large errors views memory size limit eviction colours
for name; do part "$name"; done
"$root/target/release/trex-bench" --root "$root" docs

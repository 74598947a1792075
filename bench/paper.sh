#!/usr/bin/env bash
# The experiments of the T-ReX paper on our models, kept as records. Two hours of a quiet machine, most of
# it `full-gi` and the tall builds; models that are missing are built first.
#
#   bench/paper.sh WORK_FOLDER [PART...]        SCENES="NAME...": these of bench/scenes alone, where a part goes by scenes
#
#   blocks       response and rays by the size of a fetch block (figure 6)
#   orders       which tiles come first: time of the picture, and error against time (section 5.2)
#   bitmaps      pictures with the bitmaps of voxels and without (figure 5)
#   memory       a fixed view inside 100 million triangles by the limit (section 6.2)
#   views        one view again and again: response, complete picture, rays (tables 2 and 3)
#   occlusion    ambient occlusion of ten rays a point (section 6.2)
#   photons      ten million photons while lights move (section 5.1)
#   convergence  error by the samples of a pixel, beside `full-gi` (figures 1 and 7)
#   pictures     the plant from inside, three ways, in out/ (figure 7)
#   models       366 and 469 million triangles with voxels of 512/2048 and 1024/4096 (table 1): 12 GiB of disk
set -euo pipefail
work=$(realpath "${1:?usage: bench/paper.sh WORK_FOLDER [PART...]}")
shift
cd "$(dirname "$0")/.."
root=$PWD
models=$root/../shared/models
source bench/record.sh
cargo build --release -q -p trex -p trex-bench
cd "$work"

# As the paper measures: all in memory, the exact mesh, two shadow and two gather rays.
exact="--lod-error 0 --photons 1M"
in_memory="--memory-limit 4GiB $exact"
declare -A has_truth
two="--n-shadow 2 --n-gather 2"
scenes="isosurface pipes-overview pipes-interior scan"
[ ! -d "$models" ] || scenes="$scenes kicad-1m sponza"
scenes=${SCENES:-$scenes}
build_scenes $scenes

# picture NAME SCENE FILE ARGUMENTS...: a picture of 512x512 as its samples are, in out/.
picture() {
    local name=$1 scene=$2 file=$3
    shift 3
    at=$root record "$name" render "bench/scenes/$scene.toml" -o "out/$file" --overwrite --resolution 512x512 --filter off "$@"
}

# truth SCENE: what pictures of it are compared with, once a run.
truth() {
    [[ -z ${has_truth[$1]:-} ]] || return 0
    has_truth[$1]=1
    picture "paper-truth-$1" "$1" "truth-$1.exr" --integrator path --spp 256 --seed 2
}

# still NAME SCENE ARGUMENTS...: one view again and again. A verdict of no ends nothing.
still() {
    local name=$1 scene=$2
    shift 2
    at=$root record "$name" stress "bench/scenes/$scene.toml" --scenario still --switches 5 --hold 120000 "$@" || true
}

part() {
    local scene model size way rays shadow gather
    case $1 in
    blocks)
        for scene in pipes-overview pipes-interior isosurface; do
            for size in 16 32 64 128 256 512 1024 2048 4096; do
                still paper-block-$scene-$size $scene $in_memory $two --t-max 10000 --fetch-block $size
            done
        done
        ;;
    orders)
        build_kinds
        for model in isosurface-100m pipes-100m scan-100m kicad-grid; do
            [ -e $model.trex ] || continue
            for way in zcurve row random "saliency --saliency achanta" "saliency --saliency itti" error; do
                record "paper-order-${model%-100m}-${way##* }" stress $model.trex --scenario flip --switches 6 --hold 3200 \
                    --tile-order $way $in_memory $two --resolution 512x512 --reference-spp 64 \
                    --references "paper-order-${model%-100m}.references" || true
            done
        done
        ;;
    bitmaps)
        for scene in $scenes; do
            truth $scene
            for way in on off; do
                picture paper-bitmaps-$scene-$way $scene bitmaps.exr --integrator photon --near voxel --shadows voxel \
                    --occluders $way --spp 64 $exact $two
                at=$root record paper-bitmaps-error-$scene-$way image diff --flip out/bitmaps.exr out/truth-$scene.exr
            done
        done
        ;;
    memory)
        build_kinds
        cp "$root/bench/scenes/pipes-100m-inside-views.toml" .
        for size in 104 128 192 256 4096; do
            stress paper-memory-$size $size pipes-100m.trex --scenario still --switches 10 $exact $two --fetch-block 128 \
                --views pipes-100m-inside-views.toml
        done
        ;;
    views)
        for scene in $scenes; do
            still paper-views-$scene-0-0-photon $scene $in_memory --n-shadow 0 --n-gather 0
            for rays in "2 2" "4 8"; do
                read -r shadow gather <<<"$rays"
                for way in photon full-gi; do
                    still paper-views-$scene-$shadow-$gather-$way $scene $in_memory --integrator $way --n-shadow $shadow \
                        --n-gather $gather
                done
            done
        done
        ;;
    occlusion)
        for scene in $scenes; do
            still paper-occlusion-$scene $scene $in_memory --integrator ao --n-shadow 10
        done
        ;;
    photons)
        for scene in $scenes; do
            at=$root record paper-photons-$scene stress bench/scenes/$scene.toml --scenario light-edit --switches 6 \
                --hold 60000 --memory-limit 4GiB --lod-error 0 $two --photons 10M || true
        done
        ;;
    convergence)
        for scene in $scenes; do
            truth $scene
            for size in 1 4 16 64 256; do
                picture paper-samples-$scene-$size $scene samples.exr --integrator photon --near contact --shadows mesh --spp $size $two \
                    --photons 8M
                at=$root record paper-samples-error-$scene-$size image diff --flip out/samples.exr out/truth-$scene.exr
            done
            picture paper-full-gi-$scene $scene full-gi.exr --integrator full-gi --spp 24 $two --photons 2M
            at=$root record paper-full-gi-error-$scene image diff --flip out/full-gi.exr out/truth-$scene.exr
        done
        ;;
    pictures)
        for way in photon:64 full-gi:24 path:64; do
            picture paper-picture-${way%:*} pipes-interior fig7-${way%:*}.png --integrator ${way%:*} --spp ${way#*:} $two --photons 2M
        done
        ;;
    models)
        for model in pipes:366M isosurface:469M; do
            for size in 512/2048 1024/4096; do
                way=${size/\//-}
                capped paper-model-${model%:*}-$way $((2048 * MiB)) build gen:$model -o tall.trex --overwrite --voxels $size \
                    --memory-limit 2GiB
                record paper-model-info-${model%:*}-$way info tall.trex
                rm tall.trex
            done
        done
        ;;
    *)
        echo "bench/paper.sh: no part is called $1" >&2
        return 2
        ;;
    esac
}

[ $# -gt 0 ] || set -- blocks orders bitmaps memory views occlusion photons convergence pictures models
for name; do part "$name"; done
"$root/target/release/trex-bench" --root "$root" docs

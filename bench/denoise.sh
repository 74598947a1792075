#!/usr/bin/env bash
# The filter of the display beside Intel Open Image Denoise: pictures of 1, 2 and 4 samples a pixel of four kinds of model, at
# 640x360, against 64 samples of another seed; a record each. Half an hour of a quiet machine, most of it references; page files
# and pictures that are missing are made first, so a second run takes errors and times alone, in some minutes. Needs Python with
# venv, and PyPI.
#
#   bench/denoise.sh WORK_FOLDER [ROUNDS]
set -euo pipefail
work=$(realpath "${1:?usage: bench/denoise.sh WORK_FOLDER [ROUNDS]}")
rounds=${2:-5}
cd "$(dirname "$0")/.."
root=$PWD
cargo build --release -q -p trex -p trex-bench
source bench/record.sh
cd "$work"
build_kinds
if [ ! -e denoise-venv ]; then
    python3 -m venv denoise-venv
    denoise-venv/bin/pip install -q pyoidn==2.5.1.0 OpenEXR numpy
fi

# picture NAME MODEL ARGUMENTS...: NAME.exr with what a filter wants beside it, and its document, unless they are there.
picture() {
    local name=$1 model=$2
    shift 2
    [ ! -e "$name.json" ] || return 0
    echo "== $name" >&2
    "$trex" render "$model" -o "$name.exr" --overwrite --resolution 640x360 --filter off --photons 2097152 --exposure auto \
        --layers albedo,normal,depth "$@" --json --progress none >"$name.document"
    mv "$name.document" "$name.json"
}

# Cameras as near as it takes for the model to fill the picture: place and target.
declare -A cameras=(
    [isosurface-100m]="22,20,30 -4,0,-4"
    [pipes-100m]="288.8,1.68,-193.4 297,2.6,-198.9"
    [scan-100m]="0.6,3.9,2 0,3.5,0"
    [kicad-grid]="450,600,420 750,1100,0"
)
for model in isosurface-100m pipes-100m scan-100m kicad-grid; do
    [ -e $model.trex ] || continue
    name=denoise-${model%-100m}
    read -r place target <<<"${cameras[$model]}"
    view=(--camera-position "$place" --camera-target "$target")
    picture $name-reference $model.trex --spp 64 --seed 2 "${view[@]}"
    for spp in 1 2 4; do
        picture $name-$spp $model.trex --spp $spp "${view[@]}"
        denoise-venv/bin/python "$root/bench/denoise.py" $name-$spp.exr $name-$spp.json $name-reference.exr \
            "$trex" "$root/target/release/trex-bench" "$rounds" >document.json
        "$root/target/release/trex-bench" --root "$root" record --name $name-$spp --command "bench/denoise.sh WORK_FOLDER" document.json
    done
done
"$root/target/release/trex-bench" --root "$root" docs

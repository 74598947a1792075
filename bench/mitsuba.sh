#!/usr/bin/env bash
# Our pictures beside those of Mitsuba 3, by its path tracer and ours and by `normal`: the Cornell box, Sponza and an iso-surface of 20
# million triangles, diffuse, without vertex normals, whose BSDFs differ, at the resolution given. Half an hour; no machine need be quiet.
# Needs Python with venv, and PyPI; models that are missing are built first, of `../shared/models`.
#
#   bench/mitsuba.sh WORK_FOLDER [SPP]          SCENES="NAME...": these of bench/scenes alone
set -euo pipefail
work=$(realpath "${1:?usage: bench/mitsuba.sh WORK_FOLDER [SPP]}")
spp=${2:-256}
cd "$(dirname "$0")/.."
root=$PWD
cargo build --release -q -p trex -p trex-bench
source bench/record.sh
scenes="isosurface"
[ ! -d "$root/../shared/models" ] || scenes="cornell sponza $scenes"
scenes=${SCENES:-$scenes}
cd "$work"
[ -e mitsuba/bin/python ] || { python3 -m venv mitsuba && mitsuba/bin/pip install -q mitsuba==3.9.1 numpy==2.4.6; }
for scene in $scenes; do
    at=mitsuba-$scene
    mkdir -p "$at"
    [ -e "$at/model.trex" ] || "$trex" build "$(scene_input "$scene")" --normals drop -o "$at/model.trex" --progress none
    mitsuba/bin/python "$root/bench/mitsuba_picture.py" "$trex" "$root/bench/scenes/$scene.toml" "$spp" "$at" >document.json
    "$root/target/release/trex-bench" --root "$root" record --name "mitsuba-peer-$scene" --command "bench/mitsuba.sh WORK_FOLDER $spp" document.json
    for way in path:"--integrator path --spp $spp --filter off" normal:"--quality normal"; do
        at=$work/mitsuba-$scene record mitsuba-$scene-${way%%:*} render diffuse.toml -o ours.exr --overwrite ${way#*:}
        at=$work/mitsuba-$scene record mitsuba-error-$scene-${way%%:*} image diff --flip ours.exr mitsuba.exr
    done
done
"$root/target/release/trex-bench" --root "$root" docs

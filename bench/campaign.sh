#!/usr/bin/env bash
# Runs what docs/ shows and keeps each run as a record. Needs some 40 GB in the folder given, many hours of a quiet
# machine, and for the caps the right to make memory control groups (v1). Ends with the docs written anew.
#
#   bench/campaign.sh WORK_FOLDER
set -euo pipefail
work=$(realpath "${1:?usage: bench/campaign.sh WORK_FOLDER}")
cd "$(dirname "$0")/.."
root=$PWD
cargo build --release --workspace
source bench/record.sh
cd "$work"

for kind in isosurface pipes scan soup; do
    record gen-$kind-20m gen $kind --triangles 20M -o $kind.ply --overwrite
    rm $kind.ply
done
record gen-isosurface-100m gen isosurface --triangles 100M -o iso.ply --overwrite --memory-limit 256MiB
rm iso.ply

for kind in isosurface pipes scan; do
    record build-$kind-20m build gen:$kind:20M -o $kind.trex --overwrite --memory-limit 1GiB
    record info-$kind-20m info $kind.trex
done

# A record says all knobs of its picture: defaults change.
direct="--integrator direct --n-shadow 2 --spp 4"
capped cap-build-isosurface-20m $((512 * MiB)) build gen:isosurface:20M -o iso.trex --overwrite --memory-limit 512MiB
capped cap-render-isosurface-20m $((128 * MiB)) render iso.trex -o tight.png --overwrite --memory-limit 128MiB $direct
record same-isosurface-20m-tight render iso.trex -o tight.png --overwrite --memory-limit 128MiB $direct
record same-isosurface-20m-loose render iso.trex -o loose.png --overwrite --memory-limit 1GiB $direct
record same-isosurface-20m-one-thread render iso.trex -o one.png --overwrite --memory-limit 1GiB $direct --threads 1
cmp tight.png loose.png
cmp tight.png one.png

for kind in isosurface pipes scan; do
    record render-$kind-20m render $kind.trex -o $kind.png --overwrite $direct
done
record render-path-pipes-20m render pipes.trex -o path.png --overwrite --integrator path --n-shadow 2 --n-gather 2 --spp 4

capped build-isosurface-100m $((1024 * MiB)) build gen:isosurface:100M -o isosurface-100m.trex --overwrite --memory-limit 1GiB \
    --render-limit 128MiB
capped build-isosurface-100m-no-asvo $((1024 * MiB)) build gen:isosurface:100M -o bare.trex --overwrite \
    --memory-limit 1GiB --no-asvo
rm bare.trex
"$trex" gen isosurface --triangles 100M -o iso.ply --overwrite --progress none
capped build-ply-100m $((1024 * MiB)) build iso.ply -o bare.trex --overwrite --memory-limit 1GiB --render-limit 128MiB
rm bare.trex iso.ply
for model in isosurface:469M pipes:366M; do
    name=${model/:/-}
    capped build-${name/M/m} $((2048 * MiB)) build gen:$model -o huge.trex --overwrite --memory-limit 2GiB
    rm huge.trex
done
# By hand: with the 512^3 that --render-limit 128MiB chooses the responses were no shorter.
record build-pipes-100m build gen:pipes:100M -o pipes-100m.trex --overwrite --memory-limit 1GiB --voxels 256
record build-scan-100m build gen:scan:100M -o scan-100m.trex --overwrite --memory-limit 1GiB
# Views that jump on 100 million triangles in 128 MiB.
"$root/bench/frames.sh" "$work"

# The experiments of the T-ReX paper.
"$root/bench/paper.sh" "$work"

# Rays and pages, where Debian's libembree-dev and fio are installed.
if [ -e /usr/include/embree3/rtcore.h ] && command -v fio >/dev/null; then
    "$root/bench/rays.sh" "$work"
fi

# What the footprint rule costs: voxels for what is smaller than so many pixels.
for kind in isosurface scan; do
    picture="render $kind.trex --overwrite --resolution 512x512 --integrator direct --n-shadow 2 --spp 64"
    record render-lod-$kind-0 $picture -o exact.exr
    for pixels in 0.5 1 2; do
        record render-lod-$kind-${pixels/./-} $picture -o far.exr --lod-error $pixels
        record lod-$kind-${pixels/./-} image diff far.exr exact.exr
    done
done

# Light in the Cornell box against an unbiased picture of it.
models=$root/../shared/models
if [ -d "$models" ]; then
    cp "$models"/cornell/cornell.{obj,mtl} .
    record build-cornell build cornell.obj -o cornell.trex --overwrite
    box="cornell.trex --overwrite --resolution 256x256 --camera-position 278,273,-800 --camera-target 278,273,0 --fov-x 39.3077
         --n-shadow 2 --n-gather 2"
    photons="--photons 2097152"
    record render-cornell-path render $box -o path.exr --integrator path --spp 1024
    for variant in voxel:--near=voxel exact:--near=exact cubes:--occluders=off bake:--bake; do
        record render-cornell-${variant%%:*} render $box -o photon.exr --integrator photon --spp 256 $photons --filter off ${variant#*:}
        record light-cornell-${variant%%:*} image diff photon.exr path.exr
    done
    record render-cornell-full-gi render $box -o photon.exr --integrator full-gi --spp 64 $photons --filter off
    record light-cornell-full-gi image diff photon.exr path.exr
    for integrator in photon full-gi; do
        for filter in off on; do
            record render-filter-$integrator-$filter render $box -o few.exr --integrator $integrator --spp 4 $photons --filter $filter
            record light-filter-$integrator-$filter image diff few.exr path.exr
        done
    done
fi

# How often voxels answer falsely, by their resolution.
for kind in isosurface pipes; do
    for side in 256 512 1024; do
        record build-$kind-2m-voxels-$side build gen:$kind:2M -o voxels.trex --overwrite --voxels $side
        record false-$kind-2m-$side bench rays voxels.trex --rounds 1
    done
done

# Rays against the oracle, and 10^8 rays at the edges and vertices of a closed mesh: some ten minutes.
(cd "$root" && cargo test --release --test it -- --ignored campaign)
for document in "$root"/target/tmp/hits-*.json; do
    "$root/target/release/trex-bench" --root "$root" record --name "$(basename "$document" .json)" \
        --command "cargo test --release --test it -- --ignored campaign" "$document"
done

"$root/target/release/trex-bench" --root "$root" docs

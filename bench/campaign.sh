#!/usr/bin/env bash
# Runs what docs/ shows and keeps each run as a record: generators, builds and hits here, the rest by the scripts beside it, each of
# which runs by itself, too. Some 60 GB in the folder given, a day of a quiet machine, and the right to make memory control groups (v1).
# Not among them: view.sh, gpu.sh and trust.sh. Ends with the docs written anew.
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

capped cap-build-isosurface-20m $((512 * MiB)) build gen:isosurface:20M -o iso.trex --overwrite --memory-limit 512MiB
capped cap-render-isosurface-20m $((128 * MiB)) render iso.trex -o tight.png --overwrite --memory-limit 128MiB
rm iso.trex

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

# Rays against the oracle, and 10^8 rays at the edges and vertices of a closed mesh: some ten minutes.
(cd "$root" && cargo test --release --test it -- --ignored campaign)
for document in "$root"/target/tmp/hits-*.json; do
    "$root/target/release/trex-bench" --root "$root" record --name "$(basename "$document" .json)" \
        --command "cargo test --release --test it -- --ignored campaign" "$document"
done

# Each says at its head what it needs.
for part in rays frames paper tradeoff scale units ahead history order denoise plain attributes estimates glb shards http mapped \
    mitsuba peers; do
    "$root/bench/$part.sh" "$work"
done

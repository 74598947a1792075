#!/usr/bin/env bash
# GLB beside binary PLY: builds of 24 million triangles, copies of the CAD board of `../shared/models`, in a control group of exactly
# 256 MiB, in turns: PLY, GLB, GLB whose nodes share one board, and the same quantized and compressed with meshopt. Ten minutes of
# a quiet machine that may make memory control groups (v1), with Python, and Node for gltfpack, which npm installs into the folder.
#
#   bench/glb.sh WORK_FOLDER [ROUNDS]
set -euo pipefail
work=$(realpath "${1:?usage: bench/glb.sh WORK_FOLDER [ROUNDS]}")
rounds=${2:-3}
cd "$(dirname "$0")/.."
root=$PWD
source bench/record.sh
cargo build --release -q -p trex -p trex-bench
cd "$work"

if [ ! -d "$root/../shared/models" ]; then
    printf 'NOT MEASURED: %s is not there\n' "$root/../shared/models" >&2
    exit 1
fi
cp "$root"/../shared/models/cad/kicad_1m.{obj,mtl} .
quiet="--overwrite --progress none"
"$trex" build kicad_1m.obj -o board.trex --no-asvo $quiet
"$trex" export board.trex -o board.glb $quiet
[ -e node_modules/.bin/gltfpack ] || npm install --silent --no-save gltfpack
node_modules/.bin/gltfpack -i board.glb -o board-packed.glb -c -kn -km -vp 16
python3 "$root/bench/instances.py" board.glb instances.glb 24 300
python3 "$root/bench/instances.py" board-packed.glb packed.glb 24 300
"$trex" build instances.glb -o grid.trex --no-asvo $quiet
for ending in ply glb; do "$trex" export grid.trex -o grid.$ending $quiet; done
rm grid.trex

inputs=(ply:grid.ply plain:grid.glb instances:instances.glb packed:packed.glb)
for round in $(seq "$rounds"); do
    for input in "${inputs[@]:round % 4}" "${inputs[@]:0:round % 4}"; do
        capped "glb-${input%:*}" $((256 * MiB)) build "${input#*:}" -o out.trex --overwrite --memory-limit 256MiB --no-asvo
    done
done
rm out.trex
"$root/target/release/trex-bench" --root "$root" docs

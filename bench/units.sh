#!/usr/bin/env bash
# Lower octrees on and off: views that jump on four kinds of model in 128 MiB, by default files and by files with units
# down to 2048^3. Keeps records `units-*`. Fifteen minutes of a quiet machine that may make memory control groups (v1).
#
#   bench/units.sh WORK_FOLDER
set -euo pipefail
work=$(realpath "${1:?usage: bench/units.sh WORK_FOLDER}")
cd "$(dirname "$0")/.."
root=$PWD
source bench/record.sh
cargo build --release -q -p trex -p trex-bench
cd "$work"
cp "$root/bench/scenes/pipes-20m-views.toml" .

# jumps NAME INPUT ARGUMENTS...: twenty views of both files of a model; they are built unless they are there.
jumps() {
    local name=$1 input=$2
    shift 2
    for kind in default finer; do
        local voxels=
        [ $kind = default ] || voxels="--voxels 512/2048"
        [ -e "$name-$kind.trex" ] ||
            "$trex" build "$input" -o "$name-$kind.trex" $voxels --memory-limit 2GiB --progress none
        stress "units-$name-$kind" 128 "$name-$kind.trex" --scenario flip --switches 20 --reference-spp 64 "$@"
    done
}
jumps pipes-20m gen:pipes:20M --views pipes-20m-views.toml
jumps isosurface-20m gen:isosurface:20M
models=$root/../shared/models
if [ -d "$models" ]; then
    jumps kicad-1m "$models/cad/kicad_1m.obj"
    jumps dragon "$models/scans/dragon_vrip_res2.ply"
fi

"$root/target/release/trex-bench" --root "$root" docs

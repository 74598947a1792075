#!/usr/bin/env bash
# What a mesh, its vertex colours and normals cost: bytes a triangle beside meshoptimizer's and Draco's codecs, pages, and the speed of builds and rays, of
# colours and normals of low and of high frequency on five kinds of model; a record each. Ten minutes; sizes need no quiet machine,
# speeds do. Needs Python with venv, and PyPI.
#
#   bench/attributes.sh WORK_FOLDER [TRIANGLES [ROUNDS]]
set -euo pipefail
work=$(realpath "${1:?usage: bench/attributes.sh WORK_FOLDER [TRIANGLES [ROUNDS]]}")
size=${2:-1M}
rounds=${3:-5}
cd "$(dirname "$0")/.."
root=$PWD
models=$root/../shared/models
cargo build --release -q -p trex -p trex-bench
source bench/record.sh
cd "$work"
if [ ! -e attributes-venv ]; then
    python3 -m venv attributes-venv
    attributes-venv/bin/pip install -q numpy==2.4.6 meshoptimizer==0.2.30a0 DracoPy==2.2.0 zstandard==0.25.0
fi

# told NAME SCRIPT ARGUMENTS...: a record of what a script of bench/ tells.
told() {
    local name=$1 script=$2
    shift 2
    echo "== $name" >&2
    attributes-venv/bin/python "$root/bench/$script" "$@" >document.json
    "$root/target/release/trex-bench" --root "$root" record --name "$name" --command "bench/attributes.sh WORK_FOLDER" document.json
}

for model in isosurface pipes scan kicad-1m dragon; do
    case $model in
    kicad-1m) input=$models/cad/kicad_1m.obj ;;
    dragon) input=$models/scans/dragon_vrip_res2.ply ;;
    *) input=gen:$model:$size ;;
    esac
    if [[ $input != gen:* && ! -e $input ]]; then
        printf 'NOT MEASURED: %s is not there\n' "$input" >&2
        continue
    fi
    # On its lattice, and positions alone.
    "$trex" build "$input" -o attributes.trex --overwrite --colors drop --normals drop --progress none -q
    "$trex" export attributes.trex -o "attributes-$model.ply" --overwrite --progress none -q
    told "codecs-$model" geometry.py "attributes-$model.ply" . "$trex"
    for frequency in low high; do
        told "attributes-$model-$frequency" attributes.py "attributes-$model.ply" $frequency . "$trex" "$rounds"
    done
    rm "attributes-$model.ply" attributes.trex
done
"$root/target/release/trex-bench" --root "$root" docs

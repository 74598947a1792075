#!/usr/bin/env bash
# Viewers beside `trex`: from the start of the command to a picture of 512x512 in a file, of binary PLY of 1, 10, 24 and 100 million
# triangles, in control groups of 4 GiB and of 512 MiB. f3d as Debian has it, and the library of PyPI; ours from the PLY, build
# included, and from the page file. Half an hour of a quiet machine that may make memory control groups (v1), with Debian's
# f3d and xvfb, Python with venv, and PyPI.
#
#   bench/peers.sh WORK_FOLDER [ROUNDS]
set -euo pipefail
work=$(realpath "${1:?usage: bench/peers.sh WORK_FOLDER [ROUNDS]}")
rounds=${2:-3}
cd "$(dirname "$0")/.."
root=$PWD
cargo build --release -q -p trex -p trex-bench
source bench/record.sh
cd "$work"
[ -e f3d/bin/python ] || { python3 -m venv f3d && f3d/bin/pip install -q f3d==4.0.0; }
versions="f3d $(f3d --version | sed -n '1s/^f3d //p') of Debian, $(f3d/bin/pip show f3d | sed -n 's/^Version: //p') of PyPI"

for size in 1M 10M 100M; do
    [ -e isosurface-${size,,}.ply ] || "$trex" gen isosurface --triangles $size -o isosurface-${size,,}.ply --progress none
done
if [ -d "$root/../shared/models" ] && [ ! -e kicad-grid-24m.ply ]; then
    cad_grid 24 kicad-grid.obj
    "$trex" build kicad-grid.obj -o grid.trex --overwrite --no-asvo --progress none
    "$trex" export grid.trex -o kicad-grid-24m.ply --progress none
    rm kicad-grid.obj grid.trex
fi

# beside PROGRAM MODEL MIB COMMAND...: a record of what it took.
beside() {
    local program=$1 model=$2 mib=$3
    shift 3
    echo "== $program, $model, $mib MiB" >&2
    "$root/bench/peers.py" "$mib" "$@" >document.json
    python3 - "$program" "$model" "$versions" >labelled.json <<'END'
import json, sys
document = json.load(open("document.json"))
document.update(command="bench/peers.sh: " + sys.argv[1], scene=sys.argv[2] + ".ply", peers=sys.argv[3])
print(json.dumps(document))
END
    "$root/target/release/trex-bench" --root "$root" record --name "peers-$model-$mib-$program" labelled.json
}

# The same views for all would say nothing of load and memory: each frames the model as it does.
for model in isosurface-1m isosurface-10m kicad-grid-24m isosurface-100m; do
    [ -e $model.ply ] || continue
    for mib in 4096 512; do
        for _ in $(seq "$rounds"); do
            limit="--memory-limit $((mib * 3 / 4))MiB --progress none"
            beside f3d $model $mib xvfb-run -a f3d $model.ply --output f3d.png --resolution 512,512
            beside f3d-library $model $mib f3d/bin/python "$root/bench/f3d_picture.py" $model.ply f3d.png
            # Nothing of a build that was killed, and no file of another model.
            "$trex" build --clean -o peer.trex -q && rm -f peer.trex
            beside trex-mesh $model $mib bash -c "'$trex' build $model.ply -o peer.trex --no-resume $limit &&
                '$trex' render peer.trex -o ours.png --overwrite --quality draft --resolution 512x512 $limit"
            [ -e peer.trex ] || continue
            beside trex $model $mib "$trex" render peer.trex -o ours.png --overwrite --quality draft --resolution 512x512 $limit
        done
    done
done
rm -f peer.trex
"$root/target/release/trex-bench" --root "$root" docs

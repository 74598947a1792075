#!/usr/bin/env bash
# Error against time and memory, every knob, on five models: the Cornell box, as it is and with a mirror and a glossy wall, Sponza, the
# plant from inside, the iso-surface, and a CAD board, which is built in all ways, too. Three hours of a quiet machine; models that
# are missing are built first, the box, Sponza and the board of `../shared/models`. What is stopped goes on where it was.
#
#   bench/tradeoff.sh WORK_FOLDER [ROUNDS [FRONT...]]        ROUNDS: runs of each point, 3 unless told
set -euo pipefail
work=$(realpath "${1:?usage: bench/tradeoff.sh WORK_FOLDER [ROUNDS [FRONT...]]}")
rounds=${2:-3}
shift $(($# < 2 ? $# : 2))
cd "$(dirname "$0")/.."
root=$PWD
source bench/record.sh
cargo build --release -q -p trex -p trex-bench
models=$root/../shared/models
# front NAME INPUT: a campaign of all knobs.
front() {
    at=$root record "tradeoff-$1" bench tradeoff "$2" -o "$work/tradeoff-$1" --resolution 256x256 --reference-spp 256 --rounds "$rounds"
}

[ $# -gt 0 ] || set -- cornell cornell-mirror sponza kicad-1m isosurface-20m pipes-interior-20m
for name; do
    case $name in
    cornell | cornell-mirror | sponza)
        [ -d "$models" ] || continue
        build_scenes "$name"
        front "$name" "bench/scenes/$name.toml"
        ;;
    kicad-1m) [ ! -d "$models" ] || front "$name" "$models/cad/kicad_1m.obj" ;;
    isosurface-20m)
        build_scenes isosurface
        front "$name" bench/scenes/isosurface.toml
        ;;
    pipes-interior-20m)
        build_scenes pipes-interior
        front "$name" bench/scenes/pipes-interior.toml
        ;;
    *)
        echo "bench/tradeoff.sh: no front is called $name" >&2
        exit 2
        ;;
    esac
done
"$root/target/release/trex-bench" --root "$root" docs

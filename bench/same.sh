#!/usr/bin/env bash
# Whether two builds of the command do the same: page files and pictures byte for byte, the keys of their JSON, and the
# time they take, alternating. Exits 1 where bytes or keys differ.
#
#   bench/same.sh OLD_TREX NEW_TREX WORK_FOLDER [ROUNDS]
set -euo pipefail
declare -A trex=([old]=$(realpath "${1:?usage: bench/same.sh OLD_TREX NEW_TREX WORK_FOLDER [ROUNDS]}") [new]=$(realpath "$2"))
rounds=${4:-1}
mkdir -p "$3"
cd "$3"
different=0

# same NAME OUTPUT_ENDING ARGUMENTS...: runs both; `OUT` among the arguments is the output.
same() {
    local name=$1 ending=$2 round side began
    shift 2
    declare -A took=([old]='' [new]='')
    for ((round = 0; round < rounds; round++)); do
        for side in old new; do
            began=${EPOCHREALTIME/./}
            "${trex[$side]}" "${@//OUT/$name-$side.$ending}" --overwrite --progress none --json \
                >"$name-$side.json" 2>"$name-$side.err" || { echo "$name: $side failed: $(tail -n 3 "$name-$side.err")"; different=1; }
            took[$side]+="$((${EPOCHREALTIME/./} - began))"$'\n'
        done
    done
    cmp -s "$name-old.$ending" "$name-new.$ending" || { echo "$name: other bytes"; different=1; }
    for side in old new; do
        grep -o '"[a-z_0-9]*":' "$name-$side.json" | sort -u >"$name-$side.keys"
    done
    cmp -s "$name-old.keys" "$name-new.keys" ||
        { echo "$name: other keys: $(diff "$name-old.keys" "$name-new.keys" | tr '\n' ' ')"; different=1; }
    median() { sort -n <<<"${took[$1]%$'\n'}" | sed -n "$((rounds / 2 + 1))p"; }
    awk -v name="$name" -v a="$(median old)" -v b="$(median new)" \
        'BEGIN { printf "%-28s %8.0f ms %8.0f ms %6.3f\n", name, a / 1e3, b / 1e3, b / a }'
}

for kind in isosurface pipes scan soup; do
    same build-$kind trex build gen:$kind:200K -o OUT --memory-limit 256MiB
done
same build-plain trex build gen:isosurface:200K:7 -o OUT --no-asvo --threads 1
same build-units trex build gen:pipes:300K:3 -o OUT --voxels 64/256
same build-one-thread trex build gen:pipes:300K:3 -o OUT --voxels 64/256 --threads 1
"${trex[old]}" gen isosurface --triangles 100K -o in.ply --overwrite --progress none
"${trex[old]}" gen pipes --triangles 100K -o in.obj --overwrite --progress none
same build-ply trex build in.ply -o OUT
same build-obj trex build in.obj -o OUT

plain=(--resolution 160x120 --spp 3 --photons 200000)
# What the filter keeps for itself may be packed otherwise: it is compared where it is named alone.
small=("${plain[@]}" --filter off)
for model in isosurface pipes units; do
    file=build-$model-old.trex
    for integrator in direct path ao photon full-gi debug-upper debug-lower debug-occluders debug-pages; do
        same $model-$integrator exr render $file -o OUT --integrator $integrator "${small[@]}" --layers depth,normal,albedo,id
    done
    same $model-tight exr render $file -o OUT --integrator photon "${small[@]}" --memory-limit 64MiB --threads 1
    same $model-one exr render $file -o OUT --integrator photon "${small[@]}" --threads 1 --seed 5 --n-shadow 3 --n-gather 5
    same $model-near exr render $file -o OUT --integrator photon "${small[@]}" --near exact --occluders off
    same $model-bake png render $file -o OUT --integrator photon "${plain[@]}" --bake --filter on
    same $model-lod exr render $file -o OUT --integrator photon "${small[@]}" --lod-error 4 --layers id
    same $model-filter exr render $file -o OUT --integrator full-gi "${plain[@]}" --filter on
    same $model-frames exr render $file -o OUT --integrator photon "${small[@]}" --t-max 20 --tile-order saliency --saliency itti
    same $model-frames-lod exr render $file -o OUT --integrator photon "${plain[@]}" --t-max 20 --lod-error 2 --filter on --layers depth
    same $model-frames-ao png render $file -o OUT --integrator ao "${small[@]}" --t-max 20 --tile-order row
done

cat >scene.toml <<'SCENE'
model = "build-isosurface-old.trex"
[[light]]
type = "rect"
corner = [-45.0, 45.0, -25.0]
edge_u = [20.0, 0.0, 0.0]
edge_v = [0.0, 0.0, 20.0]
radiance = [22.0, 19.0, 15.0]
[[light]]
type = "point"
position = [1.0, 30.0, 9.0]
intensity = [300.0, 200.0, 100.0]
[[light]]
type = "directional"
direction = [1.0, -2.0, 0.3]
irradiance = [0.5, 0.4, 0.3]
[[light]]
type = "sky"
radiance = [0.1, 0.1, 0.2]
[material.'0']
SCENE
sed -i '/^\[material/d' scene.toml
for integrator in direct path photon full-gi; do
    same lights-$integrator exr render scene.toml -o OUT --integrator $integrator "${small[@]}"
done
exit $different

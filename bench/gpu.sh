#!/usr/bin/env bash
# A GPU checked and measured in one go, within ten minutes, on a machine that has a GPU and no Rust, no network and no
# Python: pictures and rays beside the processor's, rays per second by kind, complete times of views that change, shares
# of kernels. Models are generated there. Documents go to OUT, a line a figure to stdout; status 1 where a check failed.
#
#   strip -o trex target/release/trex               # what is carried there, some 20 MB, with this script
#   bench/gpu.sh TREX OUT [SIZE] [VOXELS]           # 20M triangles, 1024 voxels along a side, unless told
#
# DEVICE is what answers (gpu: in hardware, if there is one); SECONDS_MAX when no further step begins; THREADS the few
# threads that views change with, beside all. Tried on a device in software: bench/gpu.sh TREX OUT 200k 256
set -euo pipefail
usage='usage: bench/gpu.sh TREX OUT [SIZE] [VOXELS]'
trex=$(realpath "${1:?$usage}") out=${2:?$usage} size=${3:-20M} voxels=${4:-1024}
device=${DEVICE:-gpu} seconds_max=${SECONDS_MAX:-540} few=${THREADS:-6}
mkdir -p "$out"
cd "$out"
failed=0

# A step is left out once the time is up; which ones were is told.
is_time() {
    ((SECONDS < seconds_max)) && return
    echo "left out, $SECONDS s have passed: $1"
    return 1
}

# asked NAME COMMAND...: runs a verb, keeps its document; a verdict of no ends nothing.
asked() {
    local name=$1 status=0
    shift
    "$trex" "$@" --json --progress none >"$name.json" 2>"$name.log" || status=$?
    ((status <= 1)) && return
    echo "failed: $name: status $status: $(tail -n 3 "$name.log")"
    failed=1
    return 1
}

# value NAME KEY [NTH]: a number, or a text, of a document, by its key: the first with that key, or the nth.
value() {
    tr ',{}[]' '\n\n\n\n\n' <"$1.json" | awk -v key="\"$2\"" -v nth="${3:-1}" '
        index($0, key ":") || index($0, key " :") {
            if (++seen == nth) { sub(/^[^:]*: */, ""); gsub(/"/, ""); gsub(/ +$/, ""); print; exit }
        }'
}

# check WHAT LEFT RIGHT: LEFT is to be RIGHT at most.
check() {
    if awk -v a="$2" -v b="$3" 'BEGIN { exit !(a != "" && a + 0 <= b + 0) }'; then
        echo "ok: $1: ${2:-nothing} of at most $3"
    else
        echo "FAILED: $1: ${2:-nothing} of at most $3"
        failed=1
    fi
}

asked doctor doctor . || true
cat doctor.json
# What `trex-bench record --machine` takes, where the documents become records.
printf '{"cpu":"%s","core_count":%d,"memory_bytes":%d,"kernel":"Linux %s"}\n' \
    "$(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1)" "$(nproc)" \
    "$(($(awk '/^MemTotal:/ { print $2 }' /proc/meminfo) * 1024))" "$(uname -r)" >machine.json

# Two kinds of model; the second set of files has finer voxels below the upper ones.
build() {
    [ -e "$1.trex" ] && return
    is_time "build of $1" && asked "build-$1" build "$2" -o "$1.trex" --voxels "$3" --memory-limit 4GiB
}
build isosurface "gen:isosurface:$size" "$voxels" || true
build plant "gen:pipes:$size" "$voxels" || true
build finer "gen:isosurface:${FINER_SIZE:-1M}" "${FINER_VOXELS:-256/1024}" || true

# Rays of points that a picture sees, by kind and mixed; each of them beside the processor's answer.
for model in isosurface plant finer; do
    is_time "rays of $model" || continue
    [ -e $model.trex ] || continue
    for side in ${RESOLUTIONS:-512 1024}; do
        name=rays-$model-$side
        asked $name bench rays $model.trex --resolution ${side}x$side --rounds 3 --device "$device" \
            --memory-limit 16GiB || continue
        # The device's part: sets of the processor alone come before it, and have some of the same keys.
        tr -d '\n' <$name.json | sed 's/.*"device": *{/{/' >$name-device.json
        name=$name-device
        sets=$(tr ',' '\n' <$name.json | grep -c '"other_count"' || true)
        for set in $(seq 1 "$sets"); do
            other=$(value $name other_count "$set") lanes=$(value $name lanes_per_s "$set")
            scalar=$(value $name scalar_per_s "$set") kernel=$(value $name kernel_per_s "$set")
            steps=$(value $name steps_per_ray "$set") own=$(value $name scalar_steps_per_ray "$set")
            rate=$(value $name per_s "$set")
            echo "$name set $set: $rate rays/s, in kernels $kernel; lanes $lanes, scalar $scalar; steps $steps, scalar $own"
            check "$name set $set, rays that meet another leaf" "$other" $((side * side / 10000 + 1))
        done
        echo "$name: kernels $(value $name shadow_ns) ns shadow, $(value $name surface_ns) ns others;" \
            "$(value $name uploaded_bytes) bytes there, $(value $name read_back_bytes) back"
    done
done

# Pictures by both.
for model in isosurface plant finer; do
    is_time "pictures of $model" || continue
    [ -e $model.trex ] || continue
    line="$model.trex --resolution ${PICTURE:-512x512} --spp 4 --photons 200k --integrator photon --overwrite"
    asked picture-$model-cpu render $line -o $model-cpu.exr --device cpu || continue
    asked picture-$model-gpu render $line -o $model-gpu.exr --device "$device" || continue
    asked diff-$model image diff $model-gpu.exr $model-cpu.exr --metric relmse --threshold 1e-3 || continue
    check "relMSE of $model by both" "$(value diff-$model value)" 1e-3
    cpu=$(value picture-$model-cpu time_ms) gpu=$(value picture-$model-gpu time_ms)
    echo "picture of $model: $cpu ms by the processor, $gpu ms with the device"
done

# Views that change: until each pixel has an exact sample.
for mix in "2 2" "4 8" "8 16"; do
    read -r n_shadow n_gather <<<"$mix"
    for threads in "$few" "$(nproc)"; do
        for by in cpu "$device"; do
            name=stress-$n_shadow-$n_gather-$threads-${by// /-}
            is_time "$name" || continue
            [ -e isosurface.trex ] || continue
            asked "$name" stress isosurface.trex --scenario flip --switches 4 --hold "${HOLD:-6000}" \
                --resolution "${PICTURE:-512x512}" --n-shadow "$n_shadow" --n-gather "$n_gather" --threads "$threads" \
                --memory-limit 8GiB --require frame.max=600000 --device "$by" || continue
            # The first p50 behind the key of the time.
            complete=$(tr -d '\n ' <"$name.json" | sed 's/.*"complete_ms":{//' | grep -o '"p50":[0-9.]*' | head -n 1)
            # Kernels are counted from the first photon on, before the views change.
            spent=$(value "$name" shadow_ns)
            [ -z "$spent" ] || spent="; kernels $spent ns shadow, $(value "$name" surface_ns) ns others"
            echo "$name: complete ${complete#*:} ms; $(value "$name" time_ms) ms of views$spent"
            check "$name, holes" "$(value "$name" holes)" 0
        done
    done
done
echo "$SECONDS s"
exit $failed

# What campaigns share, to be sourced: `work` is the folder of the models, `root` the checkout, both absolute.
trex=$root/target/release/trex
MiB=$((1 << 20))

# record NAME COMMAND...: runs a verb of trex with --json in the folder `at` or the work folder, keeps the document.
record() {
    local name=$1
    shift
    echo "== $name: trex $*" >&2
    (cd "${at:-$work}" && "$trex" "$@" --json --progress none >"$work/document.json")
    "$root/target/release/trex-bench" --root "$root" record --name "$name" --command "trex $*" "$work/document.json"
}

# measured NAME COMMAND...: the same of a verb of trex-bench, in the work folder.
measured() {
    local name=$1
    shift
    echo "== $name: trex-bench $*" >&2
    (cd "$work" && "$root/target/release/trex-bench" "$@" --json >document.json)
    "$root/target/release/trex-bench" --root "$root" record --name "$name" --command "trex-bench $*" "$work/document.json"
}

# capped NAME BYTES COMMAND...: either of them, as `by` says, `record` unless it is set, inside a control group of exactly so many bytes.
capped() {
    local name=$1 bytes=$2
    shift 2
    local group=/sys/fs/cgroup/memory/trex-campaign-$$
    mkdir "$group"
    echo "$bytes" >"$group/memory.limit_in_bytes"
    (
        echo "$BASHPID" >"$group/cgroup.procs"
        "${by:-record}" "$name" "$@"
    )
    grep -H 'oom_kill ' "$group/memory.oom_control" >&2
    echo "   kernel's count at most $(cat "$group/memory.max_usage_in_bytes") of $bytes bytes" >&2
    rmdir "$group"
}

# stress NAME MIB ARGUMENTS...: views that jump, in a group of so many MiB, at `resolution`, 512x512 unless it is set. A verdict of
# no ends nothing.
stress() {
    local name=$1 mib=$2
    shift 2
    capped "$name" $((mib * MiB)) stress "$@" --memory-limit "${mib}MiB" --resolution "${resolution:-512x512}" || true
}

# cad_grid COPIES FILE: so many copies of the CAD board of a million triangles, side by side, in the folder at hand.
cad_grid() {
    local cad=$root/../shared/models/cad
    cp "$cad/kicad_1m.mtl" .
    awk -v copies="$1" -f "$root/bench/grid.awk" "$cad/kicad_1m.obj" "$cad/kicad_1m.obj" >"$2"
}

# build_kinds: the page files of four kinds of model in the folder at hand, those that are missing.
build_kinds() {
    local kind models=$root/../shared/models

    for kind in isosurface pipes scan; do
        [ -e $kind-100m.trex ] || "$trex" build gen:$kind:100M -o $kind-100m.trex --memory-limit 2GiB --render-limit 128MiB --progress none
    done
    if [ -d "$models" ] && [ ! -e kicad-grid.trex ]; then
        cad_grid 20 kicad-grid.obj
        "$trex" build kicad-grid.obj -o kicad-grid.trex --memory-limit 2GiB --render-limit 128MiB --progress none
        rm kicad-grid.obj
    fi
}

# scene_input NAME: what the page file of bench/scenes/NAME.toml is built of, as the first line of the scene says; an input that is no
# generator is of `../shared/models`.
scene_input() {
    local input _
    read -r _ _ _ input _ <"$root/bench/scenes/$1.toml"
    [[ $input == gen:* ]] || input=$(echo "$root"/../shared/models/*/"$input")
    echo "$input"
}

# build_scenes NAME...: the page files of bench/scenes/NAME.toml in out/ of the checkout, those that are missing.
build_scenes() {
    local scene output _
    mkdir -p "$root/out"
    for scene; do
        read -r _ _ _ _ _ output <"$root/bench/scenes/$scene.toml"
        [ -e "$root/$output" ] || "$trex" build "$(scene_input "$scene")" -o "$root/$output" --progress none
    done
}

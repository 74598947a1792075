#!/usr/bin/env bash
# The figures of `trex view` on an idle machine: one line of JSON each, with the model and the figure's name.
# Pages without a browser come from bench/view; a real one, where there is chromium, from
# tests/it/browser/drag.rs. SMALL and LARGE are page files; FAR one that is far larger than its limit.
#
#   bench/view.sh SMALL.trex LARGE.trex FAR.trex [SOAK_MINUTES]
#
# The soak takes ten minutes unless told; 0: none. With RECORD=1 each is a record, too: view-FIGURE-MODEL.
set -euo pipefail
usage='usage: bench/view.sh SMALL.trex LARGE.trex FAR.trex [SOAK_MINUTES]'
small=$(realpath "${1:?$usage}") large=$(realpath "${2:?$usage}") far=$(realpath "${3:?$usage}") minutes=${4:-10}
cd "$(dirname "$0")/.."
target=${CARGO_TARGET_DIR:-target}
cargo build --release -q -p trex
cargo build --release -q -p trex-bench-view
[[ ${RECORD:-} != 1 ]] || cargo build --release -q -p trex-bench
said=$(mktemp)
viewer=
stop() {
    [[ -z $viewer ]] || { kill -INT "$viewer" && wait "$viewer" || true; }
    viewer=
}
trap 'stop; rm -f "$said"' EXIT

# start MODEL LIMIT: a viewer; its address is then in `address`, when it was started in `since`.
start() {
    stop
    : >"$said"
    since=$(date +%s%N)
    "$target/release/trex" view "$1" --no-open --memory-limit "$2" >/dev/null 2>"$said" &
    viewer=$!
    until grep -q '^http://.*#token=' "$said"; do
        kill -0 "$viewer" || { cat "$said" >&2 && exit 1; }
        sleep 0.005
    done
    address=$(grep -m1 '^http://' "$said")
}

# tell MODEL LIMIT NAME LINE: a line, {"figure":...,"value":...}, with where it comes from; a record, too, if asked for.
tell() {
    local file=${1##*/} name=${3//[,.]/-}
    local model=${file%.trex}
    printf '{"model":"%s","limit":"%s",%s\n' "$model" "$2" "${4#\{}"
    [[ ${RECORD:-} == 1 ]] || return 0
    printf '{"command":"bench/view.sh: %s, trex view %s --memory-limit %s","scene":"%s",%s\n' \
        "$name" "$file" "$2" "$file" "${4#\{}" |
        "$target/release/trex-bench" record --name "view-$name-$model" >&2
}

# figure MODEL LIMIT NAME...: a figure of the viewer that runs.
figure() {
    local line name=$3
    line=$("$target/release/trex-bench-view" "$address" "${@:3}")
    # A number chooses among figures of a name; a process does not.
    [[ $name != drag ]] || name=drag-$4
    tell "$1" "$2" "$name" "$line"
}

# pictures MODEL LIMIT: relMSE of what a drag shows, beside the same views once settled; the median, and each.
pictures() {
    local folder each=() shown
    folder=$(mktemp -d)
    "$target/release/trex-bench-view" "$address" pictures "$folder" >/dev/null
    for shown in "$folder"/shown-*.png; do
        each+=("$("$target/release/trex" image diff --json "$shown" "${shown/shown/settled}" |
            grep -o '"relmse": *[0-9.e+-]*' | head -n 1 | grep -o '[0-9.e+-]*$')")
    done
    mapfile -t each < <(printf '%s\n' "${each[@]}" | sort -g)
    tell "$1" "$2" drag-relmse "$(printf '{"figure":"drag-relmse","value":{"median":%s,"each":[%s]}}' \
        "${each[${#each[@]} / 2]}" "$(IFS=, && echo "${each[*]}")")"
    rm -r "$folder"
}

# browser MODEL LIMIT [LINE]: a drag in a real browser, over a slow line of "ms there and back,Mbit/s" if one is given.
browser() {
    local line name=browser${3:+-over-$3}
    line=$(TREX_VIEW_ADDRESS=$address ${3:+env TREX_VIEW_LINE="$3"} \
        cargo test -q -p trex --test it -- --ignored --nocapture a_drag_is_measured 2>&1 | grep -o '{".*}') ||
        { printf 'NOT MEASURED: %s on %s\n' "$name" "$1" >&2 && return; }
    tell "$1" "$2" "$name" "{\"figure\":\"$name\",\"value\":$line}"
}

for model in "$small" "$large"; do
    limit=256MiB
    start "$model" $limit
    figure "$model" $limit first "$since"
    figure "$model" $limit drag 4
    figure "$model" $limit drag 0
    pictures "$model" $limit
    figure "$model" $limit converge "$viewer"
    figure "$model" $limit edits
    # Its lights are others now.
    start "$model" $limit
    if command -v chromium >/dev/null; then
        browser "$model" $limit
        browser "$model" $limit 60,2.5
    else
        printf 'NOT MEASURED: there is no chromium\n' >&2
    fi
done
for run in 1 2 3; do
    start "$far" 128MiB
    figure "$far" 128MiB first "$since"
done
if [ "$minutes" != 0 ]; then
    start "$small" 256MiB
    figure "$small" 256MiB soak "$viewer" "$minutes"
fi

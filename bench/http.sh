#!/usr/bin/env bash
# A page file of 100 million triangles behind a web server, over wires of several lengths and 200 MiB/s: views that jump in 256 MiB,
# a record each, and a second look at what is kept on disk. Ten minutes of a quiet machine; a page file that is missing is built
# first.
#
#   bench/http.sh WORK_FOLDER
set -euo pipefail
work=$(realpath "${1:?usage: bench/http.sh WORK_FOLDER}")
cd "$(dirname "$0")/.."
root=$PWD
cargo build --release -q -p trex -p trex-bench --bins --example serve
source bench/record.sh
cd "$work"
build_kinds

# over NAME ROUND_TRIP_MS HOLD_MS SWITCHES ARGUMENTS...: a server, what opening takes, and views that jump.
over() {
    local name=$1 round_trip_ms=$2 hold=$3 switches=$4 url opened viewed begin opened_ms
    shift 4
    coproc SERVE { exec "$root/target/release/examples/serve" isosurface-100m.trex "$round_trip_ms" $((200 * MiB)); }
    local pid=$SERVE_PID from=${SERVE[0]} to=${SERVE[1]}
    read -r url <&"$from"
    begin=$(date +%s%N)
    "$trex" info "$url" >info.txt
    opened_ms=$((($(date +%s%N) - begin) / 1000000))
    echo >&"$to"
    read -r opened <&"$from"
    "$trex" stress "$url" --scenario flip --switches "$switches" --hold "$hold" --memory-limit 256MiB --resolution 1280x720 "$@" \
        --json --progress none >document.json || true
    echo >&"$to"
    read -r viewed <&"$from"
    kill "$pid"
    wait "$pid" 2>/dev/null || true
    python3 - "$round_trip_ms" "$opened_ms" "$switches" "$opened" "$viewed" <<'PYTHON'
import json, re, sys

round_trip_ms, opened_ms, views = map(float, sys.argv[1:4])
(open_requests, open_bytes), (requests, sent) = ([int(n) for n in re.findall(r"\d+", told)] for told in sys.argv[4:6])
with open("document.json") as file:
    document = json.load(file)
document["http"] = {
    "round_trip_ms": round_trip_ms,
    "opened_ms": opened_ms,
    "open_requests": open_requests,
    "requests_per_view": requests / views,
    "bytes_per_view": sent / views,
    # Twice what the wire alone takes, were 64 requests under way all the time.
    "bound_ms": 2 * (round_trip_ms * requests / views / 64 + sent / views / (200 << 20) * 1e3),
}
with open("document.json", "w") as file:
    json.dump(document, file)
PYTHON
    "$root/target/release/trex-bench" --root "$root" record --name "$name" --command "bench/http.sh WORK_FOLDER" document.json
}

over http-isosurface-0 0 12000 4
over http-isosurface-20 20 25000 3
over http-isosurface-50 50 25000 3
over http-isosurface-100 100 45000 2
# What is kept: read once over the wire, then looked at again.
rm -rf kept
over http-isosurface-50-first 50 25000 2 --cache-dir kept
over http-isosurface-50-kept 50 12000 4 --cache-dir kept
rm -rf kept
"$root/target/release/trex-bench" --root "$root" docs

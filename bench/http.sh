#!/usr/bin/env bash
# Page files of 100 million triangles, or of the CAD grid, behind a web server, over wires of several lengths and 200 MiB/s: views
# that jump in 256 MiB, a record each; a second look at what is kept on disk; and one view in a limit that holds all pages, each of
# which comes once: what a view needs. Four minutes of a quiet machine; page files that are missing are built first.
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

# serve FILE ROUND_TRIP_MS: a server, and what opening takes.
serve() {
    round_trip_ms=$2
    local begin
    coproc SERVE { exec "$root/target/release/examples/serve" "$1" "$round_trip_ms" $((200 * MiB)); }
    server=$SERVE_PID from=${SERVE[0]} to=${SERVE[1]}
    read -r url <&"$from"
    begin=$(date +%s%N)
    "$trex" info "$url" >info.txt
    opened_ms=$((($(date +%s%N) - begin) / 1000000))
    echo >&"$to"
    read -r opened <&"$from"
}

# look NAME SWITCHES ARGUMENTS...: views that jump, until each is complete.
look() {
    local name=$1 switches=$2 viewed
    shift 2
    "$trex" stress "$url" --scenario flip --switches "$switches" --hold 45000 --memory-limit "${limit:-256MiB}" --resolution 1280x720 "$@" \
        --json --progress none >document.json || true
    echo >&"$to"
    read -r viewed <&"$from"
    python3 - "$round_trip_ms" "$opened_ms" "$switches" "$opened" "$viewed" <<'PYTHON'
import json, re, sys

round_trip_ms, opened_ms, views = map(float, sys.argv[1:4])
(open_requests, _), (requests, sent) = ([int(n) for n in re.findall(r"\d+", told)] for told in sys.argv[4:6])
with open("document.json") as file:
    document = json.load(file)
document["http"] = {
    "round_trip_ms": round_trip_ms,
    "opened_ms": opened_ms,
    "open_requests": open_requests,
    "view_requests": round(requests / views),
    "view_bytes": round(sent / views),
    # Twice what the wire alone takes, were 64 requests under way all the time.
    "bound_ms": 2 * (round_trip_ms * requests / views / 64 + sent / views / (200 << 20) * 1e3),
}
with open("document.json", "w") as file:
    json.dump(document, file)
PYTHON
    "$root/target/release/trex-bench" --root "$root" record --name "http-$name" --command "bench/http.sh WORK_FOLDER" \
        document.json
}

leave() {
    kill "$server"
    wait "$server" 2>/dev/null || true
}

serve isosurface-100m.trex 0
limit=2GiB look isosurface-000-room 1
leave
for ms in 0 20 50 100; do
    serve isosurface-100m.trex "$ms"
    look "isosurface-$(printf %03d "$ms")" 4
    leave
done
# What is kept: read once over the wire, then looked at again.
rm -rf kept
serve isosurface-100m.trex 50
look isosurface-050-first 4 --cache-dir kept
look isosurface-050-kept 4 --cache-dir kept
leave
rm -rf kept
for file in pipes-100m.trex scan-100m.trex kicad-grid.trex; do
    [ -e "$file" ] || continue
    serve "$file" 50
    name=${file%.trex}
    look "${name%-100m}-050" 4
    leave
done
"$root/target/release/trex-bench" --root "$root" docs

#!/usr/bin/env bash
# Builds in shards beside one build, of four kinds of mesh in files: what two workers take that share the two cores, what two
# machines would take, and a model of what N would, which is held to those two; workers once more by a plan that holds the
# triangles (`kept`). Half an hour of a quiet machine; inputs that are missing are written first.
#
#   bench/shards.sh WORK_FOLDER [SIZE]        SIZE: triangles of each model, 10M unless told
set -euo pipefail
work=$(realpath "${1:?usage: bench/shards.sh WORK_FOLDER [SIZE]}")
size=${2:-10M}
cd "$(dirname "$0")/.."
root=$PWD
cargo build --release -q -p trex -p trex-bench --bins
source bench/record.sh
cd "$work"
models=$root/../shared/models

for kind in isosurface pipes scan; do
    [ -e $kind-${size,,}.ply ] || "$trex" gen $kind --triangles "$size" -o $kind-${size,,}.ply --progress none
done
if [ -d "$models" ] && [ ! -e kicad-grid-${size,,}.obj ]; then
    cad_grid "${size%M}" kicad-grid-${size,,}.obj
fi

for input in isosurface-${size,,}.ply pipes-${size,,}.ply scan-${size,,}.ply kicad-grid-${size,,}.obj; do
    [ -e "$input" ] || continue
    echo "== $input" >&2
    python3 - "$trex" "$input" >document.json <<'PYTHON'
import json, os, statistics, subprocess, sys, time

trex, mesh = sys.argv[1:]


def start(line):
    return subprocess.Popen([trex, *line.split(), "--json", "--progress", "none"], stdout=subprocess.PIPE)


def run(*lines):
    """Runs commands side by side: the seconds until the last has ended, and their documents."""
    begin = time.perf_counter()
    processes = [start(line) for line in lines]
    documents = [json.loads(process.communicate()[0]) for process in processes]
    took = time.perf_counter() - begin
    assert all(process.returncode == 0 for process in processes), lines
    return took, documents


def shard(number, count, threads, inputs=mesh):
    return f"build {inputs} --plan plan --shard {number}/{count} -o {number}of{count} --overwrite --threads {threads}"


def clear():
    for name in ["1of1", "4of8", "1of2", "2of2", "9of16"]:
        if os.path.exists(name):
            os.remove(name)


said = {}
for _ in range(5):
    took = {}
    took["one_s"], (one,) = run(f"build {mesh} -o one.trex --overwrite --threads 2")
    took["scan_s"], _ = run(f"scan {mesh} -o plan --overwrite --threads 2")
    clear()
    # Each as on a machine of its own.
    took["whole_shard_s"], _ = run(shard(1, 1, 2))
    eighth_s, (eighth,) = run(shard(4, 8, 2))
    halves = [run(shard(number, 2, 2)) for number in [1, 2]]
    took["half_shard_s"] = max(half for half, _ in halves)
    took["merge_s"], (merged,) = run("merge 1of2 2of2 -o merged.trex --overwrite")
    assert merged["result_hash"] == one["result_hash"], mesh
    clear()
    # As two workers of one machine.
    side_by_side_s, _ = run(shard(1, 2, 1), shard(2, 2, 1))
    took["workers_s"] = took["scan_s"] + side_by_side_s + took["merge_s"]
    # The same of a plan that holds the triangles, and a sixteenth on a machine of its own.
    clear()
    took["kept_scan_s"], (kept,) = run(f"scan {mesh} -o plan --overwrite --threads 2 --keep-triangles")
    side_by_side_s, _ = run(shard(1, 2, 1, ""), shard(2, 2, 1, ""))
    kept_merge_s, (merged,) = run("merge 1of2 2of2 -o merged.trex --overwrite")
    assert merged["result_hash"] == one["result_hash"], mesh
    took["kept_workers_s"] = took["kept_scan_s"] + side_by_side_s + kept_merge_s
    took["kept_workers_ratio"] = took["kept_workers_s"] / took["one_s"]
    sixteenth_s, _ = run(shard(9, 16, 2, ""))
    took["kept_sixteen_s"] = took["kept_scan_s"] + sixteenth_s + kept_merge_s
    took["kept_bytes"] = kept["plan_bytes"] / kept["triangle_count"]
    # The model: a shard takes what reading takes, and its share of the rest. Two shards lead to it, the halves are held to it.
    share = lambda document: document["triangle_count"] / document["model_triangle_count"]
    rest = (took["whole_shard_s"] - eighth_s) / (1 - share(eighth))
    took["read_s"] = took["whole_shard_s"] - rest
    modelled = lambda part: took["scan_s"] + took["read_s"] + rest * part + took["merge_s"]
    took["two_machines_s"] = took["scan_s"] + took["half_shard_s"] + took["merge_s"]
    took["two_modelled_s"] = modelled(max(share(half) for _, (half,) in halves))
    took["sixteen_modelled_s"] = modelled(1 / 16)
    took["workers_ratio"] = took["workers_s"] / took["one_s"]
    took["modelled_ratio"] = took["two_modelled_s"] / took["two_machines_s"]
    for key, value in took.items():
        said.setdefault(key, []).append(value)
    print({key: round(value, 2) for key, value in took.items()}, file=sys.stderr)
clear()
figures = {key: statistics.median(values) for key, values in said.items()}
print(json.dumps({"schema": "trex.shards/1", "scene": mesh, "triangle_count": one["triangle_count"], **figures}))
PYTHON
    rm -f plan one.trex merged.trex
    "$root/target/release/trex-bench" --root "$root" record --name "shards-${input%-*}-${size,,}" \
        --command "bench/shards.sh WORK_FOLDER $size" document.json
done
"$root/target/release/trex-bench" --root "$root" docs

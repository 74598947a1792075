#!/usr/bin/env bash
# The criterion benches: what a ray costs by part, what a page costs to take in and to unpack, kept as records. Ten minutes of a
# quiet machine, compiling included; one core.
#
#   bench/estimates.sh
set -euo pipefail
cd "$(dirname "$0")/.."
cargo build --release -q -p trex-bench
cargo bench -q -p trex-benches >&2
for model in iso plant scan; do
    target/release/trex-bench estimates $model |
        target/release/trex-bench record --name estimates-$model --command "bench/estimates.sh"
done
target/release/trex-bench docs

#!/usr/bin/env bash
# The long counts of docs/reliability.md, which no normal run has time for; each keeps a record `trust-*`. A part that is
# stopped resumes after the cases that have passed, but for `flips` and `fuzz`, which begin again. Needs strace, and the
# right to make memory control groups.
#
#   bench/trust.sh WORK_FOLDER [PART...]
#
#   kills         200 builds killed at work, with other threads and limits whenever they resume
#   calls K/N     every errno at every call of scripted sessions: part K of N, counted from 0
#   flips         1,000 bits turned in scratch
#   crash         every folder that a loss of power can leave at any moment of a build
#   walls         every verb in control groups of 64, 80, 96, 128 and 256 MiB, on honest, odd and hostile files
#   fuzz TARGET   changes of a target's seeds for 20 minutes, or for FUZZ_SECONDS
#   asan          unit tests of builds under AddressSanitizer, on the nightly toolchain
#
# Without a part: all of them one after another, which takes ten hours of one core.
set -euo pipefail
work=$(realpath "${1:?usage: bench/trust.sh WORK_FOLDER [PART...]}")
shift
cd "$(dirname "$0")/.."
root=$PWD
mkdir -p "$work"
targets=(page cluster octree tables superblock gltf ply page_file tree units colours normals journal scratch shards obj stl glb
    draco nrrd mhd raw mtl scene views)

# keep NAME COMMAND CASES FAILURES SECONDS: appends a record.
keep() {
    printf '{"schema":"trex.trust/1","case_count":%d,"failure_count":%d,"took_s":%d}' "$3" "$4" "$5" >"$work/$1.json"
    cargo run -q -p trex-bench -- --root "$root" record --name "trust-$1" "--command=$2" "$work/$1.json"
}

# count NAME COMMAND PATTERN ENVIRONMENT... -- PROGRAM...: runs a program, adds up the numbers before PATTERN in what it says. A
# program that fails keeps no record: what it says is the report.
count() {
    local name=$1 command=$2 pattern=$3 begin=$SECONDS cases
    shift 3
    echo "== $name: $*" >&2
    env "$@" >"$work/$name.log" 2>&1 || { tail -n 20 "$work/$name.log" >&2; return 1; }
    cases=$(grep -oP "[0-9]+(?= $pattern)" "$work/$name.log" | awk '{ sum += $1 } END { print sum + 0 }')
    keep "$name" "$command" "$cases" 0 $((SECONDS - begin))
}

part() {
    local it=(cargo test -q --locked --test it --) store=(cargo test -q --locked -p trex-store --lib --)
    case $1 in
    kills)
        count kills "TREX_KILLS=200 killed_builds" "builds killed" TREX_KILLS=200 "${it[@]}" --nocapture killed_builds_go_on
        ;;
    calls)
        local name=calls-${2/\//-of-}
        count "$name" "TREX_FAULTS=full TREX_PART=$2 calls::" "runs with a call" TREX_FAULTS=full TREX_PART="$2" \
            TREX_CASES="$work/$name.cases" "${it[@]}" --nocapture calls::
        ;;
    flips)
        count flips "TREX_FLIPS=1000 a_bit_that_turns" "bits turned" TREX_FLIPS=1000 "${store[@]}" --nocapture a_bit_that_turns
        ;;
    crash)
        count crash "TREX_FAULTS=full crash::" "losses of power" TREX_FAULTS=full "${it[@]}" --nocapture crash::
        ;;
    walls)
        count walls "TREX_FAULTS=full walls::" "runs in control groups" TREX_FAULTS=full TREX_CASES="$work/walls.cases" \
            "${it[@]}" --nocapture walls::
        ;;
    fuzz)
        local seconds=${FUZZ_SECONDS:-1200} test
        # Tests are called by the plural, or otherwise.
        test=$(grep -B 2 -E "check(_some)?\(\"$2\"" tests/it/fuzzing.rs | grep -oP '(?<=fn )\w+')
        count "fuzz-${2/_/-}" "TREX_FUZZ_SECONDS=$seconds fuzzing::$test" "changes of" TREX_FUZZ_SECONDS="$seconds" \
            TREX_FUZZ_CHANGES=1000000000 TREX_FUZZ_SEED=1 "${it[@]}" --nocapture --exact "fuzzing::$test"
        ;;
    asan)
        # Objects that are never freed are no fault of memory: the process ends.
        count asan "-Zsanitizer=address build::" "passed" RUSTFLAGS=-Zsanitizer=address ASAN_OPTIONS=detect_leaks=0 \
            cargo +nightly test -q --locked -p trex-store --lib --target x86_64-unknown-linux-gnu --target-dir "$work/asan" \
            -- build::
        ;;
    *)
        echo "bench/trust.sh: no part is called $1" >&2
        return 2
        ;;
    esac
}

if [ $# -gt 0 ]; then
    part "$@"
    exit
fi
failed=()
for name in kills "calls 0/1" flips crash walls asan "${targets[@]/#/fuzz }"; do
    read -ra words <<<"$name"
    part "${words[@]}" || failed+=("$name")
done
[ ${#failed[@]} -eq 0 ] || { printf 'failed: %s\n' "${failed[*]}" >&2; exit 1; }

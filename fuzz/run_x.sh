#!/bin/sh
# Builds the targets, makes the first corpus, runs each target for a while, and prints what came of it.
#
#   fuzz/run.sh [SECONDS] [TARGET...]      60 s and all of them by default, side by side
#
# FUZZ_JOBS (as many as there are targets) says how many run at a time, FUZZ_CORPUS (fuzz/corpus) where the corpora grow: a run goes on
# from what the last one found. FUZZ_TIMEOUT (30 s) is the longest that an input may take, by the clock: give more where the machine is busy.
# Logs are in fuzz/logs, findings in fuzz/artifacts. The code is 1 where there is a finding.
set -eu
cd "$(dirname "$0")"
seconds=${1:-60}
[ $# -eq 0 ] || shift
targets=${*:-photograph response_file plans radiance gain_map line}
corpus=${FUZZ_CORPUS:-$PWD/corpus}
jobs=${FUZZ_JOBS:-6}
triple=$(rustc -vV | sed -n 's/^host: //p')

true
./seed.sh "$corpus"

# The longest input of a target, in bytes: the larger the slower, and what is large is read as what is small.
longest() {
    case $1 in
        photograph) echo 8192 ;;
        radiance) echo 8192 ;;
        response_file) echo 32768 ;;
        plans) echo 4096 ;;
        gain_map) echo 2048 ;;
        line) echo 512 ;;
    esac
}

run() {
    target=$1
    mkdir -p "$corpus/$target" "artifacts/$target" logs
    # Files of the process lie in memory where that is possible.
    scratch=$(mktemp -d "$( [ -w /dev/shm ] && echo /dev/shm || echo "${TMPDIR:-/tmp}")/hdralign-fuzz.XXXXXX")
    dictionary=
    [ ! -f "dictionaries/$target.dict" ] || dictionary="-dict=dictionaries/$target.dict"
    # Leaks are none of a garbage collector's absence: thread pools live as long as the process.
    TMPDIR=$scratch ASAN_OPTIONS=detect_leaks=0 nice -n 19 "target/$triple/release/$target" "$corpus/$target" \
        -artifact_prefix="artifacts/$target/" $dictionary -max_len="$(longest "$target")" -timeout="${FUZZ_TIMEOUT:-30}" -rss_limit_mb=2048 \
        -malloc_limit_mb=1024 -detect_leaks=0 -print_final_stats=1 -max_total_time="$seconds" >"logs/$target.log" 2>&1 \
        || echo "$target: a finding; see fuzz/logs/$target.log and fuzz/artifacts/$target" >&2
    rm -rf "$scratch"
}

before=$(find artifacts -type f 2>/dev/null | wc -l)
running=0
for target in $targets; do
    run "$target" &
    running=$((running + 1))
    if [ "$running" -ge "$jobs" ]; then
        wait
        running=0
    fi
done
wait

./table.sh $targets
[ "$(find artifacts -type f | wc -l)" -eq "$before" ]

#!/usr/bin/env bash
# Runs a plan of `hdralign batch --plan` by GNU parallel, on all cores of this machine or of several machines with ssh and shared folders.
#
#     hdralign batch --plan /shared/night -d /shared/out > /shared/plan.jsonl
#     workflow/parallel.sh /shared/plan.jsonl [options of parallel: --jobs 8, --sshlogin 8/alice,8/bob, --progress, ...]
#
# To continue after an interruption, give the same command again: jobs that are done are skipped. parallel's own option --resume is not
# used, because it counts lines of a log file and would skip the wrong jobs after the plan has changed.
# Exit code 0: all jobs are done; 1: none; 3: some, and batch.json has the errors. See docs/guides/parallel.md.
set -uo pipefail
(($#)) || { echo "usage: parallel.sh PLAN.jsonl [options of parallel]" >&2; exit 2; }
[[ -r $1 ]] || { echo "$1: the plan cannot be read; write one with: hdralign batch FOLDER -d OUT --plan > $1" >&2; exit 2; }
plan=$(realpath "$1") hdralign=${HDRALIGN:-hdralign}
most_mb=$(sed 's/.*"memory_mb":\([0-9]*\).*/\1/' "$plan" | sort -n | tail -n 1)

# First the response curves of the cameras are recovered, then the brackets are merged, which need them. parallel starts no more jobs at a
# time than fit into the free memory, and runs a failed job up to three times. The exit code is that of the summary.
ids() { grep -F "\"kind\":\"$1\"" "$plan" | sed 's/.*"id":"\([^"]*\)".*/\1/'; }
for kind in response merge; do ids $kind | parallel --no-run-if-empty --retries 3 --memfree "${most_mb}M" --joblog "$plan.$kind.log" "${@:2}" "$hdralign" batch --run "$plan" --id {} -q; done
"$hdralign" batch --summarize "$plan"

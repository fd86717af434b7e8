#!/usr/bin/env bash
# A plan of `hdralign batch --plan` under GNU parallel: all cores of this machine, or of all machines that share a folder and have ssh.
#
#     hdralign batch --plan /shared/night -d /shared/out > /shared/plan.jsonl
#     workflow/parallel.sh /shared/plan.jsonl [options of parallel: --jobs 8, --sshlogin 8/alice,8/bob, --progress, ...]
#
# To go on after whatever stopped it, give the same command again: a step that is done exits at once. That holds by content, where
# parallel's own --resume counts lines of a joblog and would pass over the wrong steps once the plan has changed.
# Exit code 0: all done; 1: nothing; 3: something was not, and batch.json says what. See docs/guides/parallel.md.
set -uo pipefail
(($#)) || { echo "usage: parallel.sh PLAN.jsonl [options of parallel]" >&2; exit 2; }
[[ -r $1 ]] || { echo "$1: the plan cannot be read; write one with: hdralign batch --plan FOLDER -d OUT > $1" >&2; exit 2; }
plan=$(realpath "$1") hdralign=${HDRALIGN:-hdralign}
most_mb=$(sed 's/.*"memory_mb":\([0-9]*\).*/\1/' "$plan" | sort -n | tail -n 1)

# The three lines: the cameras' responses before the merges that need them (their ids, then a step each, with no more at a time than the
# free memory allows, three attempts), and the summary, whose exit code is ours.
ids() { grep -F "\"kind\":\"$1\"" "$plan" | sed 's/.*"id":"\([^"]*\)".*/\1/'; }
for kind in response merge; do ids $kind | parallel --no-run-if-empty --retries 3 --memfree "${most_mb}M" --joblog "$plan.$kind.log" "${@:2}" "$hdralign" batch --run "$plan" --id {} -q; done
"$hdralign" batch --summarize "$plan"

#!/usr/bin/env bash
# Tests hdralign with Snakemake on Slurm and with GNU parallel, on this machine. It starts its own Slurm (munged, slurmctld, slurmd) on
# loopback in a temporary folder and runs 42 brackets, one of them damaged. One process is killed with kill -9 and one job with scancel.
# Checked: all other brackets are done, the killed ones are run again and done, the damaged one is reported, and every byte is that of a
# local run of `hdralign batch`.
#
#     workflow/test_slurm.sh [--engine slurm|parallel|both] [--brackets N] [--width PX] [--log FILE] [--keep]
#
# It needs no root, container or network. All its files are in one temporary folder, which is deleted afterwards; the log is kept.
#     apt-get install slurm-wlm munge parallel
#     pip install snakemake snakemake-executor-plugin-slurm
# HDRALIGN and CARD_DUMP name the programs if they are already built (otherwise cargo builds them); SNAKEMAKE names Snakemake.
# Exit code 0: all checks passed; 1: a check failed; 77: a required program is missing.
set -euo pipefail

here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
engine=both brackets=42 width=960 log=hdralign-engines.log keep=
while (($#)); do
    case $1 in
        --engine) engine=$2; shift ;;
        --brackets) brackets=$2; shift ;;
        --width) width=$2; shift ;;
        --log) log=$2; shift ;;
        --keep) keep=yes ;;
        *) sed -n '2,/^set/{s/^# \{0,1\}//;/^set/!p}' "$0" >&2; exit 2 ;;
    esac
    shift
done
broken=17
((brackets > broken)) || { echo "--brackets: must be more than $broken, because bracket $broken is damaged" >&2; exit 2; }

snakemake=${SNAKEMAKE:-snakemake}
missing=()
need() { command -v "$1" >/dev/null || missing+=("$1 ($2)"); }
need python3 "apt-get install python3"
case $engine in slurm | both)
    for tool in munged slurmctld slurmd sbatch srun squeue scancel scontrol; do need $tool "apt-get install slurm-wlm munge"; done
    need "$snakemake" "pip install snakemake snakemake-executor-plugin-slurm"
    if command -v "$snakemake" >/dev/null && ! "$snakemake" --help | grep -q -- --slurm-status-command; then
        missing+=("Snakemake's executor for Slurm (pip install snakemake-executor-plugin-slurm)")
    fi ;;
esac
case $engine in parallel | both) need parallel "apt-get install parallel" ;; esac
if ((${#missing[@]})); then
    printf 'this test needs %s\n' "${missing[@]}" >&2
    exit 77
fi

# Output goes to the log and to the screen.
: >"$log"
log=$(cd "$(dirname "$log")" && pwd)/$(basename "$log")
exec > >(tee -a -- "$log") 2>&1
# Channel 3: messages of this test while the output of a command is redirected.
exec 3>&1

root=$(mktemp -d "${TMPDIR:-/tmp}/hdralign-engines.XXXXXX")
daemons=() workers=()
clean_up() {
    local code=$? pid
    set +e
    for pid in "${workers[@]}"; do kill -INT "$pid" 2>/dev/null && wait "$pid"; done
    if [[ -n ${SLURM_CONF:-} ]] && scontrol ping >/dev/null 2>&1; then
        squeue --noheader --format=%i | xargs --no-run-if-empty scancel --quiet
        for _ in {1..50}; do [[ -z $(squeue --noheader --states=R,CG,PD) ]] && break; sleep 0.2; done
    fi
    # In reverse order: the controller still needs munge while it stops.
    for ((i = ${#daemons[@]} - 1; i >= 0; i--)); do kill "${daemons[i]}" 2>/dev/null && wait "${daemons[i]}" 2>/dev/null; done
    # Without cgroups Slurm can miss a process of a killed job. A process whose arguments contain this test's folder belongs to it.
    for pid in /proc/[0-9]*; do
        [[ ${pid#/proc/} != "$$" ]] && grep -qsF -- "$root/" "$pid/cmdline" && kill -KILL "${pid#/proc/}"
    done
    if [[ -n $keep ]]; then echo "kept: $root"; else rm -rf "$root"; fi
    printf '\n%s after %d s, exit code %d; log: %s\n' "$([[ $code == 0 ]] && echo "all checks passed" || echo FAILED)" $SECONDS $code "$log"
    exit $code
}
trap clean_up EXIT
trap 'exit 130' INT TERM

say() { printf '\n== %s\n' "$*"; }
fail() { printf 'FAILED: %s\n' "$*" >&3; exit 1; }
# expect CODE COMMAND...: runs the command, prints its exit code and time, and fails unless the code is CODE.
expect() {
    local wanted=$1 code=0 began=$EPOCHREALTIME
    shift
    printf '$ %s\n' "$*" >&3
    "$@" 3>&- || code=$?
    printf -- '-- exit code %d (%d expected), %s s\n' $code "$wanted" "$(since "$began")" >&3
    ((code == wanted)) || fail "exit code $code, not $wanted: $*"
}
since() { python3 -c 'import sys; print(f"{float(sys.argv[2]) - float(sys.argv[1]):.1f}")' "$1" "$EPOCHREALTIME"; }
per_hour() { python3 -c 'import sys; print(f"{int(sys.argv[1]) * 3600 / float(sys.argv[2]):.0f}")' "$1" "$2"; }

# value FIELD [ID]: prints a field of all jobs of the plan, or of one. In Python, because jq may be missing.
value() {
    python3 - "$plan" "$@" <<'PY'
import json, sys
plan, field, *ids = sys.argv[1:]
for step in map(json.loads, open(plan)):
    if not ids or step["id"] in ids:
        print(*(step[field] if isinstance(step[field], list) else [step[field]]), sep="\n")
PY
}

# Checks that every result of the plan exists and has the bytes of the local run.
compare_with_local() {
    local output same=0 lost=0
    while read -r output; do
        if cmp -- "$output" "$root/local/${output#"$out/"}"; then same=$((same + 1)); else lost=$((lost + 1)); fi
    done < <(value outputs)
    echo "$same results are identical to the local run, $lost differ or are missing"
    ((lost == 0 && same == $(value outputs | wc -l))) || fail "results differ from the local run's"
}

# Checks the counts in batch.json and the error of the damaged bracket. $1: expected failures.
check_summary() {
    python3 - "$out" "$brackets" "$1" "$broken_name" <<'PY'
import csv, json, os, sys
out, brackets, failed, name = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4]
text = open(os.path.join(out, "batch.json")).read()
summary = json.loads(text)
rows = list(csv.DictReader(open(os.path.join(out, "batch.csv"))))
counts, bad = summary["counts"], [step for step in summary["steps"] if step["status"] == "failed"]
print("batch.json:", counts, "; batch.csv:", len(rows), "rows")
for step in bad:
    print("reported:", step["id"] + ":", step["error"])
assert counts["steps"] == len(summary["steps"]) == len(rows) == brackets, (counts, len(rows), brackets)
assert counts["failed"] == len(bad) == failed and counts["not_done"] == 0, counts
assert counts["done"] + counts["unchanged"] == brackets - failed, counts
assert all(name in step["error"] for step in bad), "the error does not name " + name
PY
}

# Prints the process id and the plan's job id of a running job. The arguments are compared one by one, so that neither a shell with the
# whole command as one argument nor parallel itself, which has {} as the id, is found.
running_step() {
    local pid arguments
    for pid in /proc/[0-9]*; do
        mapfile -d '' -t arguments <"$pid/cmdline" || continue
        for i in "${!arguments[@]}"; do
            if [[ ${arguments[i]} == --run && ${arguments[i + 1]:-} == "$plan" && ${arguments[i + 2]:-} == --id ]] &&
                [[ ${arguments[i + 3]:-} =~ ^[A-Za-z0-9._-]+$ ]]; then
                echo "${pid#/proc/} ${arguments[i + 3]}"
                return 0
            fi
        done
    done 2>/dev/null
    return 1
}

# Pauses a running job of the plan that has not written any result yet, so that it can be killed without a race. Sets `pid`, `id` and
# `job` (the job of Slurm). Never the damaged bracket, nor a bracket in the Slurm job $1.
stop_a_step() {
    local but_not_job=${1:-none} results broken_step
    broken_step=$(grep -F "/$broken_name\"" "$plan" | sed 's/.*"id":"\([^"]*\)".*/\1/')
    for _ in {1..6000}; do
        sleep 0.02
        kill -0 "$night" 2>/dev/null || break
        read -r pid id < <(running_step) || continue
        job=$(tr '\0' '\n' 2>/dev/null <"/proc/$pid/environ" | sed -n 's/^SLURM_JOB_ID=//p') || continue
        [[ $id != "$broken_step" && $job != "$but_not_job" ]] || continue
        kill -STOP "$pid" 2>/dev/null || continue
        mapfile -t results < <(value outputs "$id")
        [[ $(ps -o stat= -p "$pid") == T* ]] && ! ls "${results[@]}" >/dev/null 2>&1 && return 0
        kill -CONT "$pid" 2>/dev/null || true
    done
    tail -n 40 "$root"/*-1.log
    fail "no running job was found"
}

say "programs"
if [[ -z ${HDRALIGN:-} || -z ${CARD_DUMP:-} ]]; then
    (cd "$here/.." && cargo build --release --locked --bin hdralign --example card_dump)
fi
target=$here/../target/release
hdralign=${HDRALIGN:-$target/hdralign} card_dump=${CARD_DUMP:-$target/examples/card_dump}
"$hdralign" --version

say "a card: $brackets brackets of three photographs, $width px wide; the last photograph of bracket $broken is cut off"
card=$root/night
expect 0 "$card_dump" "$card" --brackets "$brackets" --width "$width"
broken_name=$(printf 'IMG_%04d.JPG' $((3 * broken)))
cp "$card/$broken_name" "$root/whole.jpg"
break_photograph() { head -c "$(($(stat --format=%s "$root/whole.jpg") * 3 / 4))" "$root/whole.jpg" >"$card/$broken_name"; }
break_photograph

say "local run"
began=$EPOCHREALTIME
expect 3 "$hdralign" batch "$card" -d "$root/local" -q >/dev/null
local_s=$(since "$began")
out=$root/local
check_summary 1

### Snakemake on Slurm

start_slurm() {
    local host ports memory_mb
    host=$(hostname -s)
    read -r -a ports < <(python3 -c '
import socket
sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(2)]
print(*(s.getsockname()[1] for s in sockets))')
    memory_mb=$(awk '/^MemTotal/ {print int($2 / 1024 * 0.9)}' /proc/meminfo)
    mkdir -p "$root/slurm/state" "$root/slurm/spool" "$root/munge" "$root/bin"
    # munge requires folders that only it can write to, and a socket that all can reach.
    chmod 711 "$root" "$root/munge"
    (umask 077; head -c 1024 /dev/urandom >"$root/munge/key")
    munged --foreground --force --socket "$root/munge/socket" --key-file "$root/munge/key" --pid-file "$root/munge/pid" \
        --seed-file "$root/munge/seed" >"$root/munge/log" 2>&1 &
    daemons+=($!)
    export SLURM_CONF=$root/slurm/slurm.conf
    cat >"$SLURM_CONF" <<CONF
ClusterName=hdralign
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=${ports[0]}
SlurmdPort=${ports[1]}
SlurmUser=$(id -un)
SlurmdUser=$(id -un)
AuthType=auth/munge
AuthInfo=socket=$root/munge/socket
CredType=cred/munge
StateSaveLocation=$root/slurm/state
SlurmdSpoolDir=$root/slurm/spool
SlurmctldPidFile=$root/slurm/slurmctld.pid
SlurmdPidFile=$root/slurm/slurmd.pid
SlurmctldLogFile=$root/slurm/slurmctld.log
SlurmdLogFile=$root/slurm/slurmd.log
# No cgroups and no systemd: processes are found by their parents.
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
SwitchType=switch/none
MpiDefault=none
# No database: how jobs ended is known from squeue only, so ended jobs are kept for an hour.
AccountingStorageType=accounting_storage/none
MinJobAge=3600
# Jobs request processors and memory.
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU_Memory
SchedulerParameters=batch_sched_delay=0,sched_interval=2,bf_interval=2
ReturnToService=2
KillWait=2
NodeName=$host NodeAddr=127.0.0.1 CPUs=$(nproc) RealMemory=$memory_mb State=UNKNOWN
PartitionName=night Nodes=$host Default=YES MaxTime=60 State=UP
CONF
    # Snakemake in a job calls srun without the variables SLURM_*, so SLURM_CONF is set here. Clusters have slurm.conf in /etc.
    printf '#!/bin/sh\nSLURM_CONF=%q exec %q "$@"\n' "$SLURM_CONF" "$(command -v srun)" >"$root/bin/srun"
    chmod +x "$root/bin/srun"
    export PATH=$root/bin:$PATH
    for _ in {1..50}; do [[ -S $root/munge/socket ]] && break; sleep 0.1; done
    slurmctld -D -f "$SLURM_CONF" >"$root/slurm/slurmctld.out" 2>&1 &
    daemons+=($!)
    slurmd -D -f "$SLURM_CONF" >"$root/slurm/slurmd.out" 2>&1 &
    daemons+=($!)
    for _ in {1..100}; do
        [[ $(sinfo --noheader --format=%T 2>/dev/null) == idle ]] && break
        sleep 0.2
    done
    sinfo --Node --long || true
    if [[ $(sinfo --noheader --format=%T) != idle ]]; then
        tail -n 20 "$root"/slurm/*.log "$root"/slurm/*.out "$root"/munge/log
        fail "Slurm did not start"
    fi
}

snakemake_run() {
    "$snakemake" --snakefile "$here/Snakefile" --profile "$here/slurm" --directory "$root/work" --nocolor \
        --slurm-status-command squeue --slurm-no-account --slurm-init-seconds-before-status-checks 3 --latency-wait 10 \
        --config "plan=$plan" "hdralign=$hdralign" job_steps=5
}

overhead() {
    # Overhead of a job: Snakemake's last job with one bracket, a plain Slurm job with that bracket, and the bracket alone.
    local one=$root/one.jsonl id began step_s last
    last=$(squeue --noheader --states=all --format=%i | sort -n | tail -n 1)
    grep -E "Started JobId=$last |Allocate JobId=$last |JobId=$last done" "$root/slurm/slurmctld.log" || true
    id=$(value id | sed -n 1p)
    head -n 1 "$plan" >"$one"
    began=$EPOCHREALTIME
    "$hdralign" batch --run "$one" --id "$id" --force -q >/dev/null
    step_s=$(since "$began")
    began=$EPOCHREALTIME
    sbatch --parsable --wait --output=/dev/null --wrap="$hdralign batch --run $one --id $id --force -q" >/dev/null
    echo "one bracket: $step_s s; as a plain Slurm job, from sbatch to its end: $(since "$began") s"
}

on_slurm() {
    say "Slurm on loopback"
    slurmctld -V
    start_slurm
    srun --ntasks=1 hostname >/dev/null

    plan=$root/plan.jsonl out=$root/slurm-out
    say "the plan"
    expect 0 "$hdralign" batch --plan "$card" -d "$out" >"$plan"
    echo "$(wc -l <"$plan") jobs"
    (($(wc -l <"$plan") == brackets)) || fail "the plan does not have $brackets jobs"

    say "Snakemake on Slurm; a process and a job are killed"
    local began=$EPOCHREALTIME code=0 pid id job night night_s killed killed_job
    snakemake_run >"$root/snakemake-1.log" 2>&1 &
    night=$!
    workers+=("$night")
    stop_a_step
    kill -KILL "$pid"
    echo "killed with kill -9: process $pid of job $job, in the middle of $id"
    killed=$id
    stop_a_step "$job"
    scancel --signal=KILL --full "$job"
    echo "killed with scancel: job $job, in the middle of $id"
    killed_job=$job
    wait "$night" || code=$?
    workers=()
    night_s=$(since "$began")
    cat "$root/snakemake-1.log"
    echo "-- snakemake: exit code $code (1 expected: one bracket is damaged), $night_s s"
    ((code == 1)) || fail "snakemake: exit code $code"
    squeue --states=all --format='%.6i %.10T %.12M' || true
    expect 3 "$hdralign" batch --summarize "$plan" >/dev/null
    check_summary 1
    [[ $(squeue --noheader --states=all --jobs="$killed_job" --format=%T) =~ CANCELLED|FAILED ]] || fail "job $killed_job did not fail"
    # One attempt for each kill and two for the damaged bracket, which may be in a killed job.
    (($(grep -c "^Trying to restart" "$root/snakemake-1.log") >= 3)) || fail "the killed jobs were not run again"
    [[ -e $(value report "$killed") && -e $(value report "$id") ]] || fail "$killed or $id was killed and is not done"
    echo "$killed and $id, which were killed, are done"

    say "the damaged photograph is replaced; the same command again"
    cp "$root/whole.jpg" "$card/$broken_name"
    # Complete results are not written again: their inodes stay the same.
    while read -r output; do [[ ! -e $output ]] || stat --format='%n %i %Y' "$output"; done < <(value outputs) >"$root/before"
    expect 0 snakemake_run
    while read -r output; do stat --format='%n %i %Y' "$output"; done < <(value outputs) >"$root/after"
    echo "$(wc -l <"$root/before") results before, $(wc -l <"$root/after") after; written again: $(comm -23 <(sort "$root/before") <(sort "$root/after") | wc -l)"
    [[ -z $(comm -23 <(sort "$root/before") <(sort "$root/after")) ]] || fail "complete results were written again"
    expect 0 "$hdralign" batch --summarize "$plan" >/dev/null
    check_summary 0
    expect 0 "$hdralign" batch "$card" -d "$root/local" -q >/dev/null
    compare_with_local

    say "the same command again, with nothing to do"
    expect 0 snakemake_run
    expect 0 "$hdralign" batch --run "$plan" --id "$killed"

    say "a result is deleted: its job is run, and only its bracket is merged"
    rm "$(value outputs "$killed" | sed -n 1p)"
    expect 0 snakemake_run
    compare_with_local
    overhead
    figures+=("Snakemake on Slurm: $brackets brackets in $night_s s with 2 kills and $broken_name damaged, $(per_hour "$brackets" "$night_s") an hour (jobs of 5 brackets)")
}

### GNU parallel

on_parallel() {
    plan=$root/parallel.jsonl out=$root/parallel-out
    say "GNU parallel"
    parallel --version | head -n 1
    break_photograph
    expect 0 "$hdralign" batch --plan "$card" -d "$out" >"$plan"
    local began=$EPOCHREALTIME code=0 pid id job night night_s
    HDRALIGN=$hdralign "$here/parallel.sh" "$plan" >/dev/null 2>"$root/parallel-1.log" &
    night=$!
    workers+=("$night")
    stop_a_step
    kill -KILL "$pid"
    echo "killed with kill -9: process $pid, in the middle of $id"
    wait "$night" || code=$?
    workers=()
    night_s=$(since "$began")
    cat "$root/parallel-1.log"
    echo "-- parallel.sh: exit code $code (3 expected: one bracket is damaged), $night_s s"
    ((code == 3)) || fail "parallel.sh: exit code $code"
    check_summary 1
    [[ -e $(value report "$id") ]] || fail "$id was killed and is not done"
    # The log of parallel has only the last attempt.
    echo "$id, which was killed, is done: $(grep -F -- "--id $id " "$plan.merge.log" | cut -f 4,7,8 | tr '\t' ' ') (time, exit code, signal)"

    say "the damaged photograph is replaced; the same command again"
    cp "$root/whole.jpg" "$card/$broken_name"
    export HDRALIGN=$hdralign
    expect 0 "$here/parallel.sh" "$plan" >/dev/null
    check_summary 0
    expect 0 "$hdralign" batch "$card" -d "$root/local" -q >/dev/null
    compare_with_local
    figures+=("GNU parallel: $brackets brackets in $night_s s with a kill and $broken_name damaged, $(per_hour "$brackets" "$night_s") an hour")
}

figures=("local run: $brackets brackets in $local_s s, $(per_hour "$brackets" "$local_s") an hour")
case $engine in slurm | both) on_slurm ;; esac
case $engine in parallel | both) on_parallel ;; esac

say "figures"
printf '%s\n' "${figures[@]}"

#!/bin/sh
# Prints what the last run of each target came to, from its log: executions, edges and features covered, the corpus, findings.
#
#   fuzz/table.sh [TARGET...]
set -eu
cd "$(dirname "$0")"
printf '%-14s %12s %8s %8s %9s %8s %9s %9s\n' target executions edges features 'per s' corpus time_s findings
for target in ${*:-photograph response_file plans radiance gain_map line}; do
    log=logs/$target.log
    [ -f "$log" ] || continue
    # Lines as `#4711 NEW cov: 1 ft: 2 corp: 3/4b lim: 5 exec/s: 6 rss: 7Mb`; the last one counts.
    last=$(grep -a '^#[0-9].* cov: ' "$log" | tail -n 1)
    field() { printf '%s\n' "$last" | sed -n "s|.* $1: *\([0-9]*\).*|\1|p"; }
    count=$(printf '%s\n' "$last" | sed -n 's|^#\([0-9]*\).*|\1|p')
    done=$(grep -a '^stat::number_of_executed_units' "$log" | tail -n 1 | sed 's|.*: *||')
    time=$(grep -a '^Done ' "$log" | tail -n 1 | sed -n 's|.* in \([0-9]*\) second.*|\1|p')
    findings=$(find "artifacts/$target" -type f 2>/dev/null | wc -l)
    printf '%-14s %12s %8s %8s %9s %8s %9s %9s\n' "$target" "${done:-$count}" "$(field cov)" "$(field ft)" "$(field exec/s)" \
        "$(field corp)" "${time:--}" "$findings"
done
grep -a -h '^PANIC' logs/*.log 2>/dev/null | sort | uniq -c | sed 's/^/caught: /' || true

#!/usr/bin/env bash
# Reproduces the paper's figures: builds Goalward, trains the runs of their plans (deploy/experiments), and writes a
# report. Finished runs are never trained again, so the script can be stopped and called again.
#
#   deploy/reproduce.sh --quick             # every figure at reduced size
#   deploy/reproduce.sh 3 4                 # Figures 3 and 4 at full size
#   deploy/reproduce.sh paper               # the paper's tables as they are written, a run for each task
set -euo pipefail

root=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/.." && pwd)

refuse() {
    printf 'reproduce: %s\n' "$*" >&2
    exit 2
}

usage() {
    cat <<'USAGE'
Reproduces figures of the paper: trains every run of their plans and writes a report.

Usage: deploy/reproduce.sh [--quick] [--dry-run] [--out DIR] [--jobs N] [FIGURE | PLAN]...

FIGURE is 3, 4, 5, 6, 7, 8, 9, 11 or 12; without one all of them. Figure 4d and Figure 10 are in the
report of any. The other plans of deploy/experiments are trained only when they are named:

  paper            each task with the values of the paper's tables, beside the default
  next-state       GAIfO-s with the goal among the expert's states
  no-online        the penalty for uncertainty without online training
  no-termination   episodes that do not end at the goal

  --quick      reduced size: fewer steps and panels, one seed
  --dry-run    trains nothing: says what is done and how many core-hours the rest takes
  --out DIR    folder of the runs and of the report (default: experiments)
  --jobs N     runs trained at once (default: half of the cores); never changes a result
USAGE
}

out=experiments
quick=() dry_run=() jobs=() plans=()
while [ $# -gt 0 ]; do
    case $1 in
        -h | --help) usage; exit 0 ;;
        --quick) quick=(--quick) ;;
        --dry-run) dry_run=(--dry-run) ;;
        --out | --jobs)
            [ $# -gt 1 ] || refuse "$1: expected a value, found none"
            if [ "$1" = --out ]; then out=$2; else jobs=(--jobs "$2"); fi
            shift
            ;;
        *)
            name=figure$1
            [[ $1 == [0-9]* ]] || name=$1
            plan=$root/deploy/experiments/$name.toml
            [ -f "$plan" ] || refuse "expected a figure or a plan of deploy/experiments, found $1"
            plans+=("$plan")
            ;;
    esac
    shift
done
if [ ${#plans[@]} -eq 0 ]; then
    for figure in 3 4 5 6 7 8 9 11 12; do
        plans+=("$root/deploy/experiments/figure$figure.toml")
    done
fi

goalward=$("$root/deploy/run_local.sh" --only-build)
status=0
"$goalward" experiment "${plans[@]}" "${quick[@]}" "${jobs[@]}" "${dry_run[@]}" --out "$out" || status=$?
[ ${#dry_run[@]} -eq 0 ] || exit "$status"
# The report lacks failed runs but has all others; after Ctrl-C there is no report.
[ "$status" -le 1 ] || exit "$status"
"$goalward" report "${plans[@]}" "${quick[@]}" --experiments "$out" --out "$out/report" --force
exit "$status"

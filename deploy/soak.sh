#!/usr/bin/env bash
# Runs short trainings of all tasks, with lag 0 and 1, under random schedules of faults, for as long as you like: kills,
# suspended processes, a slow service, a full disk, damaged checkpoints, repairs, changes of scale, Ctrl-C, power cuts.
# Names every schedule whose run ends with other weights than the undisturbed run, or leaves something behind.
#
#   deploy/soak.sh [--minutes N] [--seed FIRST] [--jobs N]   # 10 minutes, schedules from 100 on, one at a time
#   deploy/soak.sh --minutes 0 --seed 117                    # schedule 117 alone
#   deploy/soak.sh --hosts N [--seed FIRST]   # N schedules of a run on several machines: hosts, gateways, links fail
set -euo pipefail

root=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/.." && pwd)
cd "$root"

refuse() {
    printf 'soak: %s\n' "$*" >&2
    exit 2
}

while [ $# -gt 0 ]; do
    [[ ${2:-} =~ ^[0-9]+$ ]] || refuse "$1: expected a number, found ${2:-none}"
    case $1 in
        --minutes) export GOALWARD_SOAK_MINUTES=$2 ;;
        --seed) export GOALWARD_SOAK_SEED=$2 ;;
        --jobs) export GOALWARD_SOAK_JOBS=$2 ;;
        --hosts) export GOALWARD_SOAK_HOSTS=$2 ;;
        *) refuse "expected --minutes N, --seed N, --jobs N or --hosts N, found $1" ;;
    esac
    shift 2
done
test=faults
[ -z "${GOALWARD_SOAK_HOSTS:-}" ] || test=hosts
exec cargo test --locked --workspace --test "$test" -- --ignored --exact --nocapture soak

#!/usr/bin/env bash
# Runs short trainings of all tasks, with lag 0 and 1, under random schedules of faults, for as long as you like: kills,
# suspended processes, a slow service, a full disk, damaged checkpoints, repairs, changes of scale, Ctrl-C, power cuts.
# Names every schedule whose run ends with other weights than the undisturbed run, or leaves something behind.
#
#   deploy/soak.sh                           # 10 minutes
#   deploy/soak.sh --minutes 0 --seed 117    # schedule 117 alone
set -euo pipefail

root=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/.." && pwd)
cd "$root"

refuse() {
    printf 'soak: %s\n' "$*" >&2
    exit 2
}

usage() {
    cat <<'USAGE'
Runs short trainings under random schedules of faults, and names every schedule that changed a result.

Usage: deploy/soak.sh [--minutes N] [--seed FIRST] [--jobs N]
       deploy/soak.sh --hosts N [--seed FIRST]

  --minutes N    begins schedules for N minutes (default: 10); with 0 it plays one
  --seed FIRST   the first schedule (default: 100)
  --jobs N       schedules at once (default: 1)
  --hosts N      plays N schedules of a run on several machines: hosts, gateways and links fail
USAGE
}

while [ $# -gt 0 ]; do
    case $1 in
        -h | --help) usage; exit 0 ;;
        --minutes) setting=GOALWARD_SOAK_MINUTES ;;
        --seed) setting=GOALWARD_SOAK_SEED ;;
        --jobs) setting=GOALWARD_SOAK_JOBS ;;
        --hosts) setting=GOALWARD_SOAK_HOSTS ;;
        *) refuse "expected --minutes N, --seed N, --jobs N or --hosts N, found $1" ;;
    esac
    [[ ${2:-} =~ ^[0-9]+$ ]] || refuse "$1: expected a number, found ${2:-none}"
    export "$setting=$2"
    shift 2
done
test=faults
if [ "${GOALWARD_SOAK_HOSTS:-}" ]; then
    test=hosts
    [ -z "${GOALWARD_SOAK_MINUTES:-}${GOALWARD_SOAK_JOBS:-}" ] ||
        refuse "--hosts: expected no other flag than --seed, found --minutes or --jobs"
fi
exec cargo test --locked --workspace --test "$test" -- --ignored --exact --nocapture soak

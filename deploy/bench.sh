#!/usr/bin/env bash
# How fast a whole training run is, and where its time goes. About a minute and a half.
#
#   deploy/bench.sh [TASK] [flags of `goalward train`]    # such as: deploy/bench.sh --preset authors
#   deploy/bench.sh --methods [TASK] [flags]              # steps per second of every method; some minutes
#
# Runs are thrown away afterwards. Costs of single parts: cargo bench -p environments|networks|bus|mcap-log
set -euo pipefail

root=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/.." && pwd)
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT

# BC is not among them: it takes no environment steps.
methods="goal-proximity environment-reward gaifo-s gaifo-s-uncertainty gaifo gail ranking proximity-with-actions bco sqil"

# Offline training is left out of the runs, it is the same for every length of them.
steps_per_second() {
    sed -n 's/^ *"steps_per_s": \([0-9]*\).*/\1/p' "$1/summary.json"
}

if [ "${1:-}" = --methods ]; then
    shift
    for method in $methods; do
        run=$folder/$method
        "$root/deploy/run_local.sh" "$@" --method "$method" --steps 40000 --run "$run" \
            --set reward.pretraining_epochs=0 --set evaluation.episodes=1 >"$folder/progress.txt"
        printf '%-24s %8s steps/s\n' "$method" "$(steps_per_second "$run")"
    done
    exit
fi
"$root/deploy/run_local.sh" "$@" --steps 200000 --run "$folder/run" >"$folder/progress.txt"
sed -n '/^  run /,/^  where actors/p' "$folder/progress.txt"

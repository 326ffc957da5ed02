#!/usr/bin/env bash
# Measures how fast a whole training run is, and where its time goes.
#
#   deploy/bench.sh --preset authors    # --help lists what else it measures
set -euo pipefail

root=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/.." && pwd)

usage() {
    cat <<'USAGE'
Measures how fast a whole training run is, and where its time goes. Takes about a minute and a half.

Usage: deploy/bench.sh [TASK] [flags of `goalward train`]
       deploy/bench.sh --methods [TASK] [flags]
       deploy/bench.sh --to RATE [TASK] [flags]
       deploy/bench.sh --memory [TASK] [flags]
       deploy/bench.sh --costs TASK

  --methods      steps per second of all methods but BC, temporal-distance and the ablations; takes some minutes
  --to RATE      time to a success rate (0.5, 0.9, 0.95 or 0.98), for seeds 101 to 105;
                 SEEDS="1 2 3" in the environment selects other seeds
  --memory       peak memory of all processes of a run together
  --costs TASK   core-seconds of its runs, in the form of deploy/costs.toml

Runs are deleted afterwards. Costs of single parts: cargo bench -p environments|networks|bus|mcap-log
USAGE
}

for argument in "$@"; do
    case $argument in
        -h | --help) usage; exit 0 ;;
    esac
done

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT

# BC takes no environment steps, and temporal-distance learns offline only.
methods="goal-proximity soft-push-back environment-reward gaifo-s gaifo-s-uncertainty gaifo-next-state gaifo gail ranking
    proximity-with-actions proximity-discriminator nearest-state segment-matching bco sqil"

# Steps per second of a run. The runs of --methods have no offline training, which takes the same time for every length.
steps_per_second() {
    sed -n 's/^ *"steps_per_s": \([0-9]*\).*/\1/p' "$1/summary.json"
}

# Environment steps, wall and processor seconds until a run reached the success rate for good; nothing if it did not.
time_to() {
    awk -v level="\"success_rate\": $2," '
        /"time_to_success": \[/ { inside = 1 }
        inside && index($0, level) { taken = 3; next }
        taken > 0 { gsub(/[^0-9.]/, ""); printf "%s ", $0; taken-- }
        /^  \]/ { inside = 0 }' "$1/summary.json"
}

# The median of numbers, one per line; missing ones count as the longest.
median() {
    sort -g | awk '{ number[NR] = $1 } END { print number[int((NR + 1) / 2)] }'
}

# Trains a run of a task, a method and a number of steps in $folder/run, and prints its processor time.
core_seconds() {
    rm -rf "$folder/run"
    "$goalward" train "$1" --no-page --method "$2" --steps "$3" --run "$folder/run" >"$folder/progress.txt"
    sed -n 's/^  "processor_s": \([0-9.]*\).*/\1/p' "$folder/run/summary.json"
}

# The memory of every process of the run and their sum, in MiB; each shared page is divided between its users.
memory() {
    local process
    for process in $(pgrep -f "$folder/run"); do
        awk -v name="$(cat "/proc/$process/comm")" '/^Pss:/ { print name, $2 / 1024 }' "/proc/$process/smaps_rollup" ||
            true # it has just ended
    done 2>/dev/null | awk '/^goalward/ { printf "%s %.0f  ", $1, $2; sum += $2 } END { printf "%.0f\n", sum }'
}

if [ "${1:-}" = --costs ]; then
    task=${2:?expected a task}
    goalward=$("$root/deploy/run_local.sh" --only-build)
    for method in goal-proximity environment-reward gaifo-s ranking bco sqil bc; do
        steps=(100000 300000)
        [ "$method" = sqil ] && steps=(20000 60000) # a step of it costs up to thirty times as much
        short=$(core_seconds "$task" "$method" "${steps[0]}")
        long=$short
        # BC takes no steps.
        [ "$method" = bc ] || long=$(core_seconds "$task" "$method" "${steps[1]}")
        name=$(sed -n 's/^learner = "\(.*\)"/\1/p; s/^model = "\(.*\)"/\1/p' "$folder/run/config.toml" | paste -sd.)
        awk -v name="$task.$name" -v short="$short" -v long="$long" -v fewer="${steps[0]}" -v more="${steps[1]}" 'BEGIN {
            slope = (long - short) / (more - fewer) * 1e6
            printf "%s = { beside = %.1f, million_steps = %.0f }\n", name, short - fewer / 1e6 * slope, slope }'
    done
    exit
fi
if [ "${1:-}" = --to ]; then
    level=${2:-}
    case $level in
        0.5 | 0.9 | 0.95 | 0.98) shift 2 ;;
        *) echo "bench: expected --to 0.5, 0.9, 0.95 or 0.98, found ${level:-nothing}" >&2; exit 2 ;;
    esac
    goalward=$("$root/deploy/run_local.sh" --only-build)
    row='%-7s %12s %10s %14s %12s %12s\n'
    printf "$row" seed steps wall_s processors_s evaluation whole_s
    for seed in ${SEEDS:-101 102 103 104 105}; do
        run=$folder/$seed
        begun=$(date +%s%N)
        "$goalward" train "$@" --no-page --seed "$seed" --run "$run" >"$folder/progress.txt"
        whole=$((($(date +%s%N) - begun) / 1000000000))
        read -r steps wall processors _ <<<"$(time_to "$run" "$level") inf inf inf"
        evaluation=$(sed -n 's/^    "success_rate": \([0-9.]*\).*/\1/p' "$run/summary.json" | head -1)
        printf "$row" "$seed" "$steps" "${wall%.*}" "${processors%.*}" "$evaluation" "$whole"
        printf '%s\n' "$wall" >>"$folder/walls"
        rm -rf "$run"
    done
    printf 'median time to %s: %.1f s\n' "$level" "$(median <"$folder/walls")"
    exit
fi
if [ "${1:-}" = --memory ]; then
    shift
    goalward=$("$root/deploy/run_local.sh" --only-build)
    "$goalward" train "$@" --no-page --steps 100000 --run "$folder/run" >"$folder/progress.txt" &
    while kill -0 $! 2>/dev/null; do
        memory >>"$folder/memory"
        sleep 0.3
    done
    wait $!
    sed 's/^\(.*\)  \([0-9]*\)$/\2 MiB: \1/' "$folder/memory" | sort -g | tail -1
    exit
fi
if [ "${1:-}" = --methods ]; then
    shift
    goalward=$("$root/deploy/run_local.sh" --only-build)
    for method in $methods; do
        run=$folder/$method
        offline=()
        case $method in
            goal-proximity | soft-push-back | ranking | proximity-*)
                offline=(--set reward.pretraining_epochs=0) ;;
        esac
        "$goalward" train "$@" --no-page -q --method "$method" --steps 40000 --run "$run" \
            "${offline[@]}" --set evaluation.episodes=1 >"$folder/progress.txt"
        printf '%-24s %8s steps/s\n' "$method" "$(steps_per_second "$run")"
    done
    exit
fi
"$root/deploy/run_local.sh" "$@" --no-page --steps 200000 --run "$folder/run" >"$folder/progress.txt"
sed -n '/^  run /,/^  where its actors/p' "$folder/progress.txt"

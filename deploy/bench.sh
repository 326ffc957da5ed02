#!/usr/bin/env bash
# How fast a whole training run is, and where its time goes. About a minute and a half.
#
#   deploy/bench.sh [TASK] [flags of `goalward train`]    # such as: deploy/bench.sh --preset authors
#
# The run is thrown away afterwards. Costs of single parts: cargo bench -p environments|networks|protocol
set -euo pipefail

root=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/.." && pwd)
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"$root/deploy/run_local.sh" "$@" --steps 200000 --run "$folder/run" >"$folder/progress.txt"
sed -n '/^  run /,/^  where actors/p' "$folder/progress.txt"

#!/usr/bin/env bash
# Builds Goalward and trains: one command from a fresh clone to a policy.
#
#   deploy/run_local.sh [TASK] [flags of `goalward train`]
#
# Can be called from any folder; the run is put into runs/ of that folder.
set -euo pipefail

root=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/.." && pwd)

say() { printf 'run_local: %s\n' "$*" >&2; }
refuse() { say "$*"; exit 2; }

usage() {
    cat <<'USAGE'
Builds Goalward (release) and trains on this machine.

Usage: deploy/run_local.sh [TASK] [flags]

TASK is navigation (the default), fetch-pick, fetch-push or ant-reach. Without flags: 1,500,000
steps of navigation at 50 % coverage, or another task as its file in deploy/tasks says.
Everything is passed on to `goalward train`; its most used flags:

  --preset goalward|paper|authors   values to begin with
  --steps N                         environment steps to train for
  --coverage X                      part of starts and goals in the demonstrations
  --noise X                         how far the agent's starts and goals spread (not navigation)
  --seed N                          seed of every random stream
  --actors N                        actor processes; never changes the result
  --run DIR                         folder of the run (default: next free runs/TASK-NUMBER)
  --resume --run DIR                continue a run
  --no-page                         serve no page of the run, whose address the first line has
  --set KEY=VALUE                   change any key of deploy/tasks/TASK.toml

All of them: deploy/run_local.sh --all-flags
With --only-build it builds, prints where the program is, and trains nothing.
USAGE
}

check_machine() {
    command -v cargo >/dev/null || refuse \
        "expected cargo, found none: install Rust from https://rustup.rs" \
        "(curl --proto '=https' --tlsv1.2 -sSf https://sh.rustup.rs | sh) and open a new shell"
    command -v cc >/dev/null || refuse \
        "expected a C compiler, found no cc: install one (Debian and Ubuntu: apt install build-essential)"
    [ "$(uname -s)" = Linux ] || refuse "expected Linux, found $(uname -s)"
    if [ "$(uname -m)" = x86_64 ] && ! grep -qm1 '^flags.*\bavx2\b' /proc/cpuinfo; then
        refuse "expected a processor with AVX2 and FMA (x86-64-v3, since 2013), found none:" \
            "remove target-cpu from .cargo/config.toml to build without"
    fi
}

build() {
    if [ -x "$1/release/goalward" ]; then
        say "bringing the build up to date (release)"
    else
        say "building Goalward (release); this takes a few minutes the first time"
    fi
    local quiet=()
    [ -t 2 ] || quiet=(--quiet)
    cargo build "${quiet[@]}" --release --locked \
        --bin goalward --bin goalward-actor --bin goalward-learner --bin goalward-proximity-service
}

for argument in "$@"; do
    case $argument in
        -h | --help) usage; exit 0 ;;
    esac
done

check_machine
target=$("$root/deploy/target_folder.sh")
# Cargo reads its settings (.cargo/config.toml) from the folder it is called from.
(cd "$root" && build "$target") || { say "the build failed"; exit 1; }
[ "${1:-}" != --all-flags ] || exec "$target/release/goalward" train --help
if [ "${1:-}" = --only-build ]; then
    printf '%s\n' "$target/release/goalward"
    exit 0
fi
exec "$target/release/goalward" train "$@"

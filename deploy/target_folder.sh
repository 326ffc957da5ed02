#!/usr/bin/env bash
# Prints the folder that cargo builds into, which users can change; for the other scripts.
set -euo pipefail

# Cargo reads its settings (.cargo/config.toml) from the folder it is called from.
cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/.."
cargo metadata --format-version 1 --no-deps --locked | sed -n 's/.*"target_directory":"\([^"]*\)".*/\1/p'

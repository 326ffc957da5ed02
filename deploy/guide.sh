#!/usr/bin/env bash
# Builds the guide of docs/guide into target/guide, from any folder.
set -euo pipefail

root=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/.." && pwd)
command -v mdbook >/dev/null || {
    printf 'guide: expected mdbook, found none: cargo install mdbook --locked\n' >&2
    exit 1
}
mdbook build --dest-dir "$root/target/guide" "$root/docs/guide"
printf '%s\n' "$root/target/guide/index.html"

#!/usr/bin/env bash
# Checks what must hold before a change is handed in, as CI does: formatting, lints, tests, documentation.
#
#   deploy/check.sh        # from any folder; ends at the first step that fails
set -euo pipefail

root=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/.." && pwd)
# A relative path is one in the folder that this script was started in.
case ${GOALWARD_PYTHON:-} in /*) ;; */*) export GOALWARD_PYTHON=$PWD/$GOALWARD_PYTHON ;; esac
cd "$root"

step() {
    local title=$1 started=$SECONDS
    shift
    printf '\ncheck: %s\n' "$title" >&2
    "$@" || {
        printf 'check: FAILED: %s (%s)\n' "$title" "$*" >&2
        exit 1
    }
    printf 'check: %s: all well after %d s\n' "$title" $((SECONDS - started)) >&2
}

documentation() {
    RUSTDOCFLAGS="-D warnings" cargo doc --workspace --locked --no-deps --document-private-items
}

# Runs with the packages that `deploy/test.sh` has installed.
python_lints() {
    local python=${GOALWARD_PYTHON:-$root/target/python/bin/python}
    "$python" -m ruff check && "$python" -m ruff format --check && (cd python && "$python" -m mypy)
}

step "the form of the source (rustfmt)" cargo fmt --all --check
step "lints (clippy)" cargo clippy --workspace --all-targets --locked -- -D warnings
step "tests" deploy/test.sh
if [ "${GOALWARD_PYTHON:-}" != none ]; then
    step "lints of Python (ruff, mypy)" python_lints
fi
step "documentation (rustdoc)" documentation
if command -v cargo-deny >/dev/null; then
    step "licenses and sources of dependencies (cargo-deny)" cargo deny check licenses sources bans
else
    printf '\ncheck: cargo-deny is not installed: licenses of dependencies are not checked\n' >&2
fi
printf '\ncheck: everything is well (%d s)\n' "$SECONDS" >&2

#!/usr/bin/env bash
# Runs every test of Goalward: one command, from any folder.
#
#   deploy/test.sh [arguments of `cargo test`]      # such as: deploy/test.sh --workspace --test ledger
#
# Some tests read a log with the public Python packages for MCAP, or act in Gymnasium environments; without arguments,
# the tests of the Python package follow. The packages that they need are installed into a virtual environment of their
# own in target/python; your own Python is not touched. GOALWARD_PYTHON names another interpreter that has them;
# GOALWARD_PYTHON=none leaves those tests out.
set -euo pipefail

root=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/.." && pwd)
# A relative path is one in the folder that this script was started in.
case ${GOALWARD_PYTHON:-} in /*) ;; */*) export GOALWARD_PYTHON=$PWD/$GOALWARD_PYTHON ;; esac
cd "$root"

say() { printf 'test: %s\n' "$*" >&2; }

python_environment() {
    local folder=$root/target/python wanted=$root/tests/requirements.txt
    # An interpreter that was upgraded or removed leaves a folder that works no more.
    if ! cmp -s "$wanted" "$folder/installed.txt" || ! "$folder/bin/python" -c 'import numpy' 2>/dev/null; then
        say "installing the Python packages of tests/requirements.txt into target/python"
        # A failed command does not end a function whose caller tests its status.
        python3 -m venv --clear "$folder" &&
            "$folder/bin/python" -m pip install --quiet --disable-pip-version-check \
                --requirement "$wanted" &&
            cp "$wanted" "$folder/installed.txt" || return 1
    fi
    export GOALWARD_PYTHON=$folder/bin/python
}

if [ -z "${GOALWARD_PYTHON:-}" ]; then
    python_environment || {
        say "expected python3 with venv and pip, and a package index;" \
            "GOALWARD_PYTHON=none leaves the tests that need them out"
        exit 1
    }
fi

# Runs the tests of the Python package, which use the actor that was just built.
python_tests() {
    local target
    target=$("$root/deploy/target_folder.sh")
    say "pytest python"
    GOALWARD_ACTOR=$target/debug/actor-under-test "$GOALWARD_PYTHON" -m pytest -c python/pyproject.toml python
}

output=$root/target/test-output.txt
mkdir -p "$root/target"
everything=
[ $# -gt 0 ] || { everything=yes; set -- --workspace; }
say "cargo test --locked --no-fail-fast $*"
say "the first time everything is built, which takes minutes; the tests take about fifteen"
status=0
# Under nohup SIGHUP is ignored, and what the tests start would ignore it, too.
env --default-signal=HUP cargo test --locked --no-fail-fast "$@" 2>&1 | tee "$output" || status=$?

awk '/^test result:/ { passed += $4; failed += $6; ignored += $8; targets++ }
    END { printf "test: %d passed, %d failed, %d ignored in %d test programs\n",
        passed, failed, ignored, targets }' "$output" >&2
if [ "$status" -ne 0 ]; then
    sed -n 's/^test \(.*\) \.\.\. FAILED$/test: FAILED \1/p' "$output" >&2
    say "the whole output is in target/test-output.txt"
fi
if [ "$everything" ] && [ "$GOALWARD_PYTHON" != none ]; then
    python_tests || status=$?
fi
exit "$status"

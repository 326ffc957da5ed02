"""Evaluates finished runs with sampled actions and with the most probable ones, 500 episodes each.

python docs/results/modes.py GOALWARD OUT.csv RUN...
"""

import csv
import re
import subprocess
import sys
from pathlib import Path

EPISODES = 500
SUCCESS = re.compile(r"success +([0-9.]+) %")


def success_rate(goalward: str, run: Path, actions: str) -> float:
    """Of the run's newest policy, in per cent."""
    command = [goalward, "evaluate", run, "--episodes", str(EPISODES), "--actions", actions, "--force"]
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    found = SUCCESS.search(said)
    if not found:
        raise SystemExit(f"{run}: expected a success rate, found {said!r}")
    return float(found[1])


def main(goalward: str, out: str, *runs: str) -> None:
    """The command."""
    with Path(out).open("w", newline="") as file:
        lines = csv.writer(file, lineterminator="\n")
        lines.writerow(["run", "sampled", "most probable"])
        for run in map(Path, runs):
            rates = [success_rate(goalward, run, actions) for actions in ["sample", "mode"]]
            lines.writerow([run.name, *rates])


if __name__ == "__main__":
    main(*sys.argv[1:])

"""Evaluates finished runs with sampled and with most probable actions, and replays them, into `replays.csv`.

    pip install -r docs/results/requirements.txt
    python docs/results/replays.py GOALWARD RUN...                        # 500 episodes each way
    python docs/results/replays.py GOALWARD --verify --retrain RUN...     # and replays

It exits at the first run whose replay differs. Values that a run already has in the table are not measured
again.
"""

import argparse
import json
import subprocess
from pathlib import Path

from data import REPLAYS, Row, read, write

COLUMNS = ["run", "policy_sha256", "verified", "retrained", "sampled", "most_probable"]
EVALUATION = ["--episodes", "500", "--force"]


def said(*command: str | Path) -> dict:
    """Returns the JSON output of a goalward command; exits if it fails, after the command has said why."""
    output = subprocess.run([*command, "--json", "--quiet"], stdout=subprocess.PIPE, text=True)
    if output.returncode:
        raise SystemExit(f"{' '.join(map(str, command))}: expected exit status 0, found {output.returncode}")
    return json.loads(output.stdout)


def policy_of(run: Path) -> str:
    """Returns the hash of a run's final policy; exits if there is no finished run."""
    summary = run / "summary.json"
    if not summary.is_file():
        raise SystemExit(f"{run}: expected the folder of a finished run, found no summary.json there")
    return json.loads(summary.read_text())["policy_sha256"]


def fill(row: Row, run: Path, options: argparse.Namespace) -> None:
    """Measures what a run's row lacks: verified episodes, retrained updates, success rates."""
    goalward = options.goalward
    if options.verify and not row["verified"]:
        row["verified"] = said(goalward, "replay", run, "--verify")["equal"]
    if options.retrain and not row["retrained"]:
        row["retrained"] = said(goalward, "replay", run, "--retrain")["updates"]
    for column, actions in (("sampled", "sample"), ("most_probable", "mode")):
        if not row[column]:
            evaluated = said(goalward, "evaluate", run, *EVALUATION, "--actions", actions)
            row[column] = f"{evaluated['success_rate']:.4f}"


def main() -> None:
    """Measures all runs and writes the table after each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("goalward")
    parser.add_argument("--verify", action="store_true", help="act every episode again")
    parser.add_argument("--retrain", action="store_true", help="train again from the log alone")
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN")
    options = parser.parse_args()
    policies = {run: policy_of(run) for run in options.runs}
    rows = {row["run"]: row for row in read(REPLAYS)}
    for run, policy in policies.items():
        known = rows.get(run.name, {})
        # Values of other weights under the same name do not apply to these.
        kept = known if known.get("policy_sha256") == policy else {}
        row = dict.fromkeys(COLUMNS, "") | {"run": run.name, "policy_sha256": policy} | kept
        rows[run.name] = row
        fill(row, run, options)
        write(REPLAYS, sorted(rows.values(), key=lambda row: row["run"]))


if __name__ == "__main__":
    main()
